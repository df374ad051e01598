"""Rehearsals of robots that see each other: every rule holds, also while sensors and processes fail."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from formation.deploy.rehearsal.faults import parse
from formation.deploy.rehearsal.rehearsal import Plan, run
from formation.mission.file import load
from tests.support.examples import slow
from tests.support.seeing import HEXAGON, TRIANGLE, hexagon

MISSION = hexagon(simulated="drift = 0.0")


@pytest.mark.parametrize("robots", [TRIANGLE, *slow(list(HEXAGON))], ids=len)
def test_robots_that_see_each_other_settle(robots: Sequence[str]) -> None:
    verdict = run(Plan(hexagon(robots=robots, simulated="drift = 0.0")), 0, ())
    assert verdict.violations == ()
    assert verdict.settled_at is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [
        "kill@12+3", "reset@12+1", "freeze@12+3", "mute@12+4", "second@12+3", "clock=3@12+5", "loss=0.3@8+12",
        "blocked@12+3", "frozen@12+4", "carried@12+2", "scan_frozen@12+4", "scan_late@12+4",
    ],
)  # fmt: skip
def test_rules_hold_while_one_robot_fails(fault: str) -> None:
    verdict = run(Plan(MISSION), 0, (parse(f"robot4:{fault}", MISSION),))
    assert verdict.violations == ()
    assert verdict.settled_at is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "faults", "signed"),
    [
        (30000, "", False),  # one neighbour in sight told robot2's heading wrong by 4 degrees
        (30025, "", True),
        (30023, "robot4:tremble=0.000237@9.5+2.7", False),  # robot4 turned by 37 degrees without odometry
    ],
)
def test_shipped_convoy_holds_every_rule(seed: int, faults: str, *, signed: bool) -> None:
    convoy = load("convoy")
    verdict = run(Plan(convoy, signed=signed), seed, tuple(parse(one, convoy) for one in faults.split()))
    assert verdict.violations == ()
    assert verdict.settled_at is not None
