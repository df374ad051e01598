"""Collision avoidance between robots: production cores, a fake clock, a network in memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from formation.agent.core import Agent
from formation.control.unicycle import AT_REST
from formation.mission.file import load
from formation.mission.model import Mission
from formation.mission.route import Straight
from formation.protocol.status import CollisionMode
from formation.topics import POSITION
from tests.support.examples import slow
from tests.support.fleet import Fleet
from tests.support.missions import team
from tests.unit.agent.test_scanning import least_gap
from tests.unit.formation import scenarios

SIX = load("six_robots")
CROSSING = scenarios.exchanged(SIX)
"""Each robot has to pass another one, and avoids all."""
FILE = scenarios.build(np.array([0, -1, -2, -3 + 0j]), ((), (0,), (1,), (2,)), robot={"ramp": 0.25})
"""Robots one behind the other."""
PATROL = load("patrol").model_copy(update={"cohesion": None})


def changed(mission: Mission, **robot: Any) -> Mission:
    robots = {name: one.model_copy(update=robot) for name, one in mission.robots.items()}
    return mission.model_copy(update={"robots": robots})


WITHOUT_AVOID = changed(SIX, avoid=())
"""Robots that avoid only those that they measure."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "air", [{}, {"loss": 0.2, "seed": 1}, {"delay": (0.05, 0.15), "seed": 2}], ids=["good", "lossy", "late"]
)
def test_robots_starting_in_exchanged_slots_form_without_contact(air: dict[str, Any]) -> None:
    fleet = Fleet(CROSSING, **air)
    assert least_gap(fleet, 30.0) > 0.0
    assert fleet.error() < SIX.settled


@pytest.mark.slow
def test_robots_with_slow_ramp_pass_without_contact() -> None:
    assert least_gap(Fleet(changed(CROSSING, ramp=1.0)), 10.0) > 0.0


@pytest.mark.slow
def test_robots_touch_without_collision_filter() -> None:
    assert least_gap(Fleet(scenarios.exchanged(SIX, mode="off")), 10.0) < 0.0


def test_warn_mode_reports_avoiding_without_changing_commands() -> None:
    warns, off = (Fleet(scenarios.exchanged(FILE, avoid=(), mode=mode)) for mode in ("warn", "off"))
    avoiding = set()
    for _ in zip(warns.every(0.25, 5.0), off.every(0.25, 5.0), strict=True):
        statuses = [warns.status(name) for name in FILE.followers]
        assert {one.collisions for one in statuses} == {CollisionMode.WARN, None}
        avoiding |= {one.avoiding for one in statuses}
    assert warns.commands == off.commands
    assert avoiding == {False, True}
    assert off.status("robot3").collisions is None


def test_avoid_adds_only_position_subscriptions() -> None:
    alone, avoiding = (set(Agent(one, "robot2").subscriptions) for one in (WITHOUT_AVOID, CROSSING))
    others = {POSITION.key(name) for name in SIX.followers if name != "robot2"}
    assert avoiding - alone == others
    assert set(Agent(CROSSING, "robot2", "paper").subscriptions) == alone


def test_status_lists_avoided_and_never_received_robots() -> None:
    fleet = Fleet(scenarios.exchanged(FILE))
    fleet.kill("robot4")
    fleet.run(8.0)
    result = fleet.status("robot3")
    assert result.avoids == ("robot2", "robot4")
    assert result.avoids_never_received == ("robot4",)
    assert result.avoided > 0
    assert result.deadlocks >= 0
    assert result.collisions is CollisionMode.ON


def test_robot_measuring_only_leader_reports_no_collision_mode() -> None:
    assert Fleet(WITHOUT_AVOID).after(2.0).status("robot2").collisions is None


@pytest.mark.slow
def test_robot_drives_round_dead_robot_ahead() -> None:
    fleet = Fleet(PATROL).after(9.0)
    fleet.kill("robot1")
    fleet.world._hosted["robot1"].plant.obey(AT_REST)
    assert least_gap(fleet, 13.0) > 0.0
    leader, *points = fleet.points()
    slot = fleet.leader.plan.shape_transition.placed_shape.slots(fleet.mission)[2]
    assert abs(points[1] - leader - slot) < 0.02


@pytest.mark.parametrize("measurement", ["network", "local"])
@pytest.mark.parametrize(
    ("speed", "top", "rate", "coasts"),
    [(0.6, 0.8, 20.0, 0.15), (0.28, 0.3, 5.0, 0.0), *slow((0.2, 0.8, 20.0, 0.0), (0.6, 0.8, 20.0, 0.0))],
)
def test_dead_robot_ahead_is_never_hit(
    speed: float, top: float, rate: float, coasts: float, measurement: str
) -> None:
    both = {"robot1": ("leader",), "robot2": ("leader",)}
    mission = team(both, avoid="all", max_speed=top, rate=rate, measurement=measurement)
    row = {"robot1": (-0.8, 0.0), "robot2": (-1.5, 0.0)}
    route = (Straight(speed=speed, heading_deg=0.0),)
    fleet = Fleet(mission.model_copy(update={"shapes": {"row": row}, "route": route})).after(8.0)
    fleet.kill("robot1")
    fleet.run(coasts)
    fleet.plant("robot1").obey(AT_REST)
    assert least_gap(fleet, 8.0) > 0.0
