"""Cohesion: the leader slows and waits while edge errors are large, if its mission has `[cohesion]`."""

from __future__ import annotations

from itertools import pairwise

import pytest

from formation.leader.cohesion import Cohesion as Patience
from formation.mission.file import load
from formation.mission.model import Cohesion, Mission
from formation.ros2.messages import Pose
from formation.slots.shape import PlacedShape
from tests.support.fleet import Fleet

SIX = load("six_robots")
FIRST = PlacedShape.first(SIX)
BOUND = 0.6


def bound(patience: float | None = None) -> Mission:
    return SIX.model_copy(update={"cohesion": Cohesion(error=BOUND, patience=patience)})


def receive(patience: Patience, mono: float, off: dict[str, complex], leader: complex = 0j) -> None:
    """Give the positions of all followers; those in `off` are that far from their slots."""
    for name in SIX.followers:
        point = leader + FIRST.slot(SIX, name) + off.get(name, 0j)
        offset = SIX.robots[name].control_point_offset
        patience.receive(name, Pose(1.7e9, point - offset, 1.0 + 0j), mono)


def paces(patience: Patience, start: float, seconds: float, off: dict[str, complex]) -> list[float]:
    result = []
    for k in range(round(seconds / 0.05)):
        mono = start + 0.05 * k
        receive(patience, mono, off)
        result.append(patience.step(mono, 0.05, 0j, 0j, FIRST))
    return result


def test_cohesion_is_off_without_mission_table() -> None:
    patience = Patience(SIX)
    assert set(paces(patience, 0.0, 3.0, {"robot4": 9.0 + 0j})) == {1.0}
    assert patience.waits_for == ()


@pytest.mark.parametrize(("off", "pace"), [(0.2, 1.0), (0.3, 1.0), (0.45, 0.5), (0.6, 0.0), (3.0, 0.0)])
def test_pace_falls_to_zero_from_half_the_bound(off: float, pace: float) -> None:
    patience = Patience(bound())
    assert paces(patience, 0.0, 4.0, {"robot2": complex(off)})[-1] == pytest.approx(pace, abs=1e-9)
    assert patience.error == pytest.approx(off)
    assert ("robot2" in patience.waits_for) == (pace < 1.0)


def test_pace_changes_at_limited_rates() -> None:
    patience = Patience(bound())
    result = [*paces(patience, 0.0, 2.0, {"robot2": 3.0 + 0j}), *paces(patience, 2.0, 4.0, {})]
    assert all(-0.101 < after - before < 0.026 for before, after in pairwise(result))
    assert (min(result), result[-1]) == (0.0, 1.0)


def test_leader_waits_for_one_robot_only_within_patience() -> None:
    patience = Patience(bound(patience=5.0))
    assert paces(patience, 0.0, 4.9, {"robot4": 3.0 + 0j})[-1] == 0.0
    assert paces(patience, 4.9, 4.0, {"robot4": 3.0 + 0j})[-1] == 1.0
    both = {"robot4": 3.0 + 0j, "robot2": 0.0 - 3.0j}
    assert paces(patience, 8.9, 2.0, both)[-1] == 0.0  # each robot has its own wait
    assert "robot4" not in patience.waits_for
    assert paces(patience, 10.9, 3.0, {})[-1] == 1.0
    assert paces(patience, 13.9, 2.0, {"robot4": 3.0 + 0j})[-1] == 0.0


def test_leader_does_not_wait_for_silent_robots() -> None:
    patience = Patience(bound())
    assert paces(patience, 0.0, 2.0, {"robot5": 3.0 + 0j})[-1] == 0.0
    assert patience.step(3.5, 1.5, 0j, 0j, FIRST) == pytest.approx(0.75)
    assert patience.waits_for == ()


@pytest.mark.parametrize("patience", [None, 2.0])
def test_driven_leader_waits_for_silent_robot_within_patience(patience: float | None) -> None:
    cohesion = Patience(bound(patience))
    receive(cohesion, 0.0, {})
    del cohesion._received["robot4"]  # never received
    result = {}
    for k in range(100):
        mono = 0.05 * k
        for name in cohesion._received.keys() - {"robot5"}:
            point = FIRST.slot(SIX, name) - SIX.robots[name].control_point_offset
            cohesion.receive(name, Pose(1.7e9, point, 1.0 + 0j), mono)
        result[k] = cohesion.step(mono, 0.05, 0j, 0j, FIRST, driven=True)
        if k == 40:
            assert cohesion.waits_for == ("robot5",)
    assert (result[20], result[40]) == (1.0, 0.0)
    assert result[99] == (0.0 if patience is None else pytest.approx(0.95, abs=0.05))


@pytest.mark.slow
def test_leader_waits_for_stopped_robot_until_it_runs() -> None:
    fleet = Fleet(bound(), seed=3)
    fleet.run(15.0)
    assert fleet.ask("robot5", "stop").ok
    fleet.run(12.0)
    waited = fleet.leader.where(fleet.now)
    fleet.run(5.0)
    assert abs(fleet.leader.where(fleet.now) - waited) < 0.02
    assert "robot5" in fleet.leader.plan.cohesion.waits_for
    assert fleet.leader.mode == "run"
    assert max(abs(z) for z in edges(fleet)) < BOUND + 0.1
    assert fleet.set_going("robot5").ok
    fleet.run(15.0)
    assert abs(fleet.leader.where(fleet.now) - waited) > 1.5
    assert fleet.error() < SIX.settled


def edges(fleet: Fleet) -> list[complex]:
    """Error of every edge, from the true positions [m]."""
    points, slots = fleet.points(), fleet.leader.plan.shape_transition.placed_shape.slots(SIX)
    return [
        points[j] - points[i] - (slots[j] - slots[i])
        for i, measured in enumerate(SIX.graph.neighbours)
        for j in measured
    ]
