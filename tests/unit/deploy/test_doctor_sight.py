"""Findings of the doctor about range scanners and the sight of neighbours."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from formation.deploy.doctor.cli import EXAMINATIONS
from formation.deploy.doctor.facts import Facts, ScanMessage, Stream, examine
from formation.deploy.doctor.gather import _scans, _sees
from formation.deploy.doctor.sight import SCANNER, SIGHT
from formation.mission.model import Mission
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import AgentState, AgentStatus, Sight
from formation.ros2.messages import encode
from formation.wire import Sample
from tests.support.drivers import DRIVERS
from tests.support.seeing import TRIANGLE, hexagon
from tests.unit.deploy.examined import DESK, HEALTHY, paused, status_of, stream

SEEING = hexagon(robots=TRIANGLE, scan='model = "lds_01"')
SEARCHING = Reason.of(Code.SIGHT_SEARCHING, robots=("robot2", "robot3"), count=0.0, limit=5.0)
CONTRADICTED = Reason.of(Code.SIGHT_CONTRADICTED, robots=("robot2",))


def message(hits: int = 330, sweep: float = 0.2, turn: float = 359 / 360) -> ScanMessage:
    return ScanMessage(360, hits, sweep, turn)


def sees(**values: Any) -> AgentStatus:
    ages, deviations = {"robot2": 0.12, "robot3": 0.31}, {"robot2": 0.0071, "robot3": 0.009}
    usual = status_of(robot="robot7", sight=Sight.LOCKED, sight_age=ages, sight_deviation=deviations)
    return replace(usual, **values)


def blind(**values: Any) -> AgentStatus:
    usual = sees(
        state=AgentState.HOLD, reason=SEARCHING, sight=Sight.SEARCHING, sight_age={}, sight_deviation={},
        sight_lost=("robot2", "robot3"),
    )  # fmt: skip
    return replace(usual, **values)


WELL = replace(
    HEALTHY, mission=SEEING, robot="robot7", newest_status=sees(), scan=stream(5.0), scans=(message(),) * 15
)
AT_DESK = replace(DESK, mission=SEEING, robot="robot7", newest_status=sees(age={"scan": 0.14}))


def findings(facts: Facts) -> dict[str, tuple[str, str]]:
    """Sentence and remedy of each finding about scanner and sight, by name."""
    return {
        finding.name: (finding.sentence, finding.remedy)
        for checked in examine((SCANNER, SIGHT), facts)
        for finding in checked.findings
    }


def seen(facts: Facts) -> dict[str, str]:
    return {checked.title: checked.seen for checked in examine(EXAMINATIONS, facts)}


def with_scan_keys(facts: Facts, **scan: Any) -> Facts:
    """The same facts with other keys in `scan` of robot7."""
    spec = facts.mission.robots["robot7"]
    changed = spec.model_copy(update={"scan": spec.scan.model_copy(update=scan)})
    return replace(facts, mission=facts.mission.changed(robots={**facts.mission.robots, "robot7": changed}))


def test_scanner_and_sight_are_reported_on_robot() -> None:
    assert findings(WELL) == {}
    assert seen(WELL)["scanner"] == (
        "5 Hz, 360 beams, 8 % without a range, states a sweep of 0.2 s, its agent takes -0.2 s"
    )
    assert seen(WELL)["sight"] == "locked: robot2 to 0.7 cm, 0.1 s ago; robot3 to 0.9 cm, 0.3 s ago"


def test_desk_reports_sight_from_agent_status() -> None:
    facts = replace(AT_DESK, seen_by=("robot4",))
    assert findings(facts) == {}
    assert seen(facts)["scanner"] == "newest range scan 0.1 s old"
    assert seen(facts)["sight"].endswith("robot3 to 0.9 cm, 0.3 s ago; seen by robot4")


def test_single_unseen_neighbour_is_reported_without_finding() -> None:
    status = sees(
        sight_age={"robot2": 0.12, "robot3": 7.2}, sight_deviation={"robot2": 0.0071}, sight_lost=("robot3",)
    )
    facts = replace(WELL, newest_status=status)
    assert findings(facts) == {}
    assert seen(facts)["sight"] == "locked: robot2 to 0.7 cm, 0.1 s ago; robot3 not seen for 7.2 s"


def test_robot_without_landmarks_needs_no_sight() -> None:
    assert not {"scanner", "sight"} & seen(HEALTHY).keys()
    anchor = replace(WELL, robot="robot2", newest_status=sees(robot="robot2", sight=None))
    assert seen(anchor)["sight"] == "uses odometry: no neighbour corrects it"


PROBLEMS: dict[str, tuple[Mapping[str, Any], str, str, str]] = {
    "no neighbour seen yet": ({"newest_status": blind()}, "sight-none",
        "its scanner has seen none of robot2, robot3, and it stands", "on its start pose, to 5 cm and 3°"),
    "neighbours elsewhere": ({"newest_status": blind(reason=CONTRADICTED)}, "sight-none",
        "its scanner has seen none of robot2, robot3, and it stands", "put it and its neighbours on"),
    "reckoning": (
        {"newest_status": blind(sight=Sight.RECKONING, sight_age={"robot2": 14.0, "robot3": 9.1})},
        "sight-none", "none of robot2, robot3 for 9 s, and it uses odometry", "at one height",
    ),
    "not locked yet": (
        {"newest_status": blind(sight_age={"robot2": 0.1}, sight_deviation={"robot2": 0.02},
         sight_lost=("robot3",))},
        "sight-searching", "robot2 to 2.0 cm, 0.1 s ago; robot3 not seen", "within 2 m",
    ),
    "silent scanner": ({"scan": Stream(), "scans": ()}, "scan-silent", "no range scan in 3 s", "bring-up"),
    "slow scanner": ({"scan": stream(3.0)}, "scan-slow", "the range scan comes at 3 Hz instead of 5 Hz", ""),
    "two drivers": ({"scan": stream(10.0)}, "scan-fast", "comes at 10 Hz instead of 5 Hz", ""),
    "irregular scanner": ({"scan": paused(0.2, 0.3)}, "scan-irregular", "paused 2 times in 3 s", ""),
    "covered scanner": ({"scans": (message(0),) * 15}, "scan-empty", "no beam of 15 range scans came back",
        "does its head turn"),
    "refused scans": (
        {"newest_status": sees(scan_fault=Reason.of(Code.SCAN_BLIND, value=0.16, limit=0.123))},
        "scan-refused", "range_min 0.16 m: this robot needs at most 0.123 m", "range-scanners.md",
    ),
}  # fmt: skip


@pytest.mark.parametrize("problem", PROBLEMS)
def test_each_problem_gives_only_its_finding_with_remedy(problem: str) -> None:
    changes, name, sentence, remedy = PROBLEMS[problem]
    facts = replace(WELL, **changes)
    if problem == "irregular scanner":
        facts = replace(with_scan_keys(facts, model=None, rate=20.0), scans=())
    assert list(findings(facts)) == [name]
    assert sentence in findings(facts)[name][0]
    assert remedy in findings(facts)[name][1]


def test_sweep_is_compared_with_the_time_between_scans() -> None:
    old_driver = replace(WELL, scans=(message(sweep=0.01),) * 15)
    assert findings(old_driver) == {}  # the model's sweep counts
    unnamed = with_scan_keys(old_driver, model=None, sweep=None)
    assert findings(unnamed)["scan-sweep"][0] == (
        "its range scans state a sweep of 0.01 s, and come every 0.2 s"
    )
    assert "`model` or `sweep`" in findings(unnamed)["scan-sweep"][1]
    wrong = with_scan_keys(WELL, sweep=-0.1)
    assert findings(wrong)["scan-sweep"][0] == (
        "the mission says that a sweep takes 0.1 s, but range scans come every 0.2 s"
    )
    assert findings(with_scan_keys(WELL, model=None, sweep=None)) == {}
    half_turn = replace(WELL, scans=(message(sweep=0.1, turn=0.5),) * 15)
    assert findings(with_scan_keys(half_turn, model=None, sweep=None)) == {}
    silent = replace(WELL, scans=(message(sweep=0.0),) * 15)
    assert findings(with_scan_keys(silent, model=None, sweep=None)) == {}


def test_lds_02_at_10_hz_has_no_finding() -> None:
    mission = hexagon(robots=TRIANGLE, scan='model = "lds_02"')
    fast = replace(WELL, mission=mission, scan=stream(10.0), scans=(message(sweep=0.1),) * 30)
    assert findings(fast) == {}
    assert list(findings(replace(fast, scan=stream(20.0)))) == ["scan-fast"]


@pytest.mark.parametrize("model", DRIVERS)
def test_scans_of_every_driver_are_read(model: str) -> None:
    mission: Mission = hexagon(robots=TRIANGLE, scan=f'model = "{model}"')
    samples = [2.0 if number % 10 else math.inf for number in range(360)]
    payload = encode(DRIVERS[model](samples, 100.0, 0.2, 0.5))
    received = [
        (Sample("robot7/scan", payload, None, 100.2), 100.2),
        (Sample("robot7/scan", b"", None, 101.0), 101.0),
    ]
    messages, scans = _scans(mission.robots["robot7"].scan, received)
    assert (len(messages.received), len(messages.bad)) == (1, 1)
    (one,) = scans
    assert 0.7 * one.beams < one.hits < one.beams
    assert one.turn == pytest.approx(1.0, abs=0.005)
    assert one.sweep == pytest.approx(360 / 2300 if model == "lds_02" else 0.2, rel=0.02)


def test_sees_counts_only_landmarks_in_sight() -> None:
    status = sees(sight_lost=("robot3",))
    assert _sees(SEEING, status, "robot7", "robot2")
    assert not _sees(SEEING, status, "robot7", "robot3")
    assert not _sees(SEEING, sees(sight=None), "robot2", "robot7")
