"""Sensors of neighbours that repeat what they measured, or are late: the robot holds, and goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest

from formation.agent.following.relative_check import OwnMotion, RelativeCheck
from formation.agent.simulated.faults import Fault
from formation.control.observer import Travel
from formation.control.plane import rotation
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from formation.topics import RELATIVE
from formation.wire import Sample
from tests.support.fleet import Fleet
from tests.support.missions import with_robots
from tests.support.sensing import faulty

LOCAL = with_robots("six_robots", measurement="local")
PERIOD, ROBOT = 0.05, "robot3"
AHEAD = Travel(0.01, 0.0, 0.01 + 0j)


Seen = Callable[[int], Any]
"""A displacement of each period, or None."""


class Watched:
    """A check of one neighbour, and the robot's motion."""

    def __init__(self, *, by_odometry: bool = True) -> None:
        self.check = RelativeCheck("robot2", 0.0, by_odometry=by_odometry)
        self.own, self.time = OwnMotion(), 0.0

    def move(
        self,
        travel: Travel | None,
        periods: int,
        seen: Seen,
        reported: Seen = lambda _: None,
    ) -> bool:
        """Move on for so many `periods`; return whether the sensor is doubted then."""
        for number in range(periods):
            self.time += PERIOD
            self.own.add(self.time, travel)
            self.check.saw(seen(number), self.own, reported(number))
        return self.check.state.doubt is not None


def still(_: int) -> complex:
    return 1.0 + 0j


@pytest.mark.parametrize("travel", [AHEAD, Travel(0.0, 0.02, 0j)])
def test_repeated_displacement_is_doubted_while_robot_moves(travel: Travel) -> None:
    watched = Watched()
    assert not watched.move(travel, 8, still)
    assert watched.move(travel, 40, still)
    assert watched.check.state.doubt is not None
    assert watched.check.state.doubt.code is Code.RELATIVE_FROZEN
    assert "the sensor's robot2 frozen or this robot blocked" in str(watched.check.state.doubt)


def test_trembling_displacement_is_doubted_beside_standing_neighbour() -> None:
    watched = Watched()
    assert watched.move(AHEAD, 20, lambda n: 1.0 + 0.001 * (n % 3), lambda _: 1.0 + 0j)


@pytest.mark.parametrize(
    ("by_odometry", "travel", "periods", "seen", "reported"),
    [
        (True, Travel(0.0, 0.0, 0j), 400, still, lambda n: 0.01j * n),
        (True, AHEAD, 200, lambda n: 3.0 - 0.01 * n, lambda _: 3.0 + 0j),
        (True, None, 400, still, lambda _: None),
        (False, Travel(0.0, 0.02, 0j), 400, still, lambda _: None),
    ],
    ids=["at rest", "it follows the motion", "unknown motion", "a commanded turn"],
)
def test_displacement_without_evidence_against_it_is_believed(
    by_odometry: bool, travel: Travel | None, periods: int, seen: Seen, reported: Seen
) -> None:
    assert not Watched(by_odometry=by_odometry).move(travel, periods, seen, reported)


@pytest.mark.parametrize("angle", [0.0, 0.6, 3.0])
def test_formation_at_speed_is_no_fault_in_any_frame(angle: float) -> None:
    def reported(number: int) -> complex:
        return rotation(angle) * 0.0095 * number

    assert not Watched().move(AHEAD, 2000, lambda n: 1.0 + 1e-6 * (n % 2), reported)


def test_doubt_ends_with_the_first_other_displacement() -> None:
    watched, rest = Watched(), Travel(0.0, 0.0, 0j)
    assert watched.move(AHEAD, 80, still)
    assert watched.move(rest, 100, still)
    assert not watched.move(rest, 1, lambda _: 0.2 + 0j)


def test_order_ends_a_doubt_but_not_at_once() -> None:
    watched = Watched()
    assert watched.move(AHEAD, 80, still)
    watched.check.trust(watched.check.state.since + 0.5)
    assert watched.check.state.doubt is not None
    watched.check.trust(watched.check.state.since + 1.01)
    assert watched.check.state.doubt is None


@pytest.mark.slow
def test_robot_holds_while_its_displacements_are_frozen() -> None:
    fleet = faulty(LOCAL, Fault(ROBOT, "relative_frozen", 0.0, 6.0, 10.0))
    fleet.run(9.5)
    assert fleet.driven(ROBOT, 6.0) < 0.05
    assert fleet.agents[ROBOT].decision.reason.code is Code.RELATIVE_FROZEN
    fleet.run(1.5)
    assert fleet.agents[ROBOT].decision.state is AgentState.RUN
    fleet.run(30.0)
    assert fleet.error() < LOCAL.settled


def late(seconds: float) -> Callable[[Sample], Iterable[Sample]]:
    keys = {RELATIVE.key(ROBOT, other) for other in LOCAL.robots[ROBOT].measurable}
    return lambda one: (one._replace(arrived=one.arrived + seconds),) if one.key in keys else (one,)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.3, 1.0])
def test_robot_holds_while_its_displacements_are_late(seconds: float) -> None:
    fleet = Fleet(LOCAL)
    fleet.meddle = late(seconds)
    fleet.run(6.0)
    assert fleet.plant(ROBOT).path < 0.02
    reason = fleet.agents[ROBOT].decision.reason
    assert reason.code is Code.RELATIVE_LATE
    assert f"{seconds:.2f} s old when it came; limit 0.20 s" in str(reason)
    fleet.meddle = lambda one: (one,)
    fleet.run(2.0)
    assert fleet.agents[ROBOT].decision.state is AgentState.RUN
