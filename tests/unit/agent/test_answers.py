"""Answers distinguish late messages from wrong clocks: they name a position that a neighbour received."""

from __future__ import annotations

import numpy as np
import pytest

from formation.agent.following.attachment import MAX_ANSWER_DELAYS, Answers
from formation.agent.following.neighbour import Neighbour, answers
from formation.control.tracker import MAX_DELAY
from formation.protocol.attachment import ReceivedPosition
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from formation.ros2.messages import Pose
from formation.wire import Now
from tests.campaigns.safety.crossing import elsewhere
from tests.support.examples import slow
from tests.support.fleet import Fleet
from tests.support.missions import with_robots
from tests.unit.agent.test_clocks import set_clock
from tests.unit.agent.test_scanning import least_gap

SIX = with_robots("six_robots", avoid="all")
BOUND = MAX_ANSWER_DELAYS * MAX_DELAY
"""A message that answers comes at most so long after the position that it names [s]."""


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
@pytest.mark.parametrize("late", [0.8, *slow(1.2, 2.0, 3.0)])
def test_robots_with_late_neighbours_hold_without_touching(late: float, seed: int) -> None:
    fleet = Fleet(elsewhere(SIX, np.random.default_rng(seed)), seed=seed, delay=(late, late + 0.001))
    assert least_gap(fleet, max(12.0, 6.0 + 4.0 * late)) > 0.0  # the leader first waits for a robot
    for agent in fleet.agents.values():
        assert agent.decision.state is AgentState.HOLD
        assert agent.decision.reason.code is Code.UNANSWERED


def test_neighbour_with_wrong_clock_is_followed_once_it_answers() -> None:
    fleet = Fleet(SIX)
    set_clock(fleet, "robot3", -3600.0)
    fleet.run(1.5)
    assert fleet.states == {AgentState.RUN}


def test_robots_hold_when_neighbour_with_wrong_clock_receives_nothing() -> None:
    fleet = Fleet(SIX)
    set_clock(fleet, "robot3", -3600.0)
    fleet.cuts |= {(name, "robot3") for name in SIX.followers}
    fleet.run(5.0)
    for name in set(SIX.followers) - {"robot3"}:
        decision = fleet.agents[name].decision
        assert decision.state is AgentState.HOLD
        assert "robot3 by +3600.0 s" in str(decision.reason)


def neighbours(*names: str) -> list[Neighbour]:
    return [Neighbour(SIX, name, 20.0, answers=True) for name in names]


def take(other: Neighbour, stamp: float, mono: float, *, answered: bool = False) -> object:
    """Return how late `other` may be after a position received at `mono` [s]; None if it answers."""
    now = Now(mono, 99.0 + mono)
    other.take_position(Pose(stamp, 0j, 1 + 0j), mono, now, answered=answered)
    return other.unanswered(now)


@pytest.mark.parametrize(
    ("answerer", "age", "robot", "stamp", "young"),
    [
        ("robot3", 0.1, "robot2", 100.0, True),
        ("robot3", BOUND - 0.01, "robot2", 100.0, True),
        ("robot3", BOUND + 0.01, "robot2", 100.0, False),
        ("robot3", 0.1, "robot4", 100.0, False),
        ("robot3", 0.1, "robot2", 99.9, False),
        ("robot6", 0.1, "robot2", 100.0, False),
    ],
)
def test_answer_must_name_recent_own_position(
    answerer: str, age: float, robot: str, stamp: float, young: bool
) -> None:
    mine = Answers(SIX, "robot2", neighbours("robot3"))
    mine.record_sent(100.0, 5.0)
    assert mine.answered(answerer, ReceivedPosition(robot=robot, stamp=stamp), 5.0 + age) is young


def test_next_named_cycles_through_received_neighbours() -> None:
    each = neighbours("robot3", "robot4", "robot5")
    mine = Answers(SIX, "robot2", each)
    assert mine.next_named() is None
    for one in each[:2]:
        take(one, 100.0, 1.0)
    received = {ReceivedPosition(robot=name, stamp=100.0) for name in ("robot3", "robot4")}
    assert {mine.next_named() for _ in range(4)} == received


def test_answer_counts_until_messages_pause() -> None:
    (other,) = neighbours("robot3")
    assert take(other, 10.0, 1.0, answered=True) is None
    assert take(other, 10.05, 1.05) is None
    assert take(other, 20.0, 11.0) == pytest.approx((90.0, MAX_DELAY))
    assert take(other, 20.05, 11.05, answered=True) is None


@pytest.mark.parametrize("ahead", [-0.4, -0.001, 0.0, 0.001, 0.4])
def test_small_clock_difference_needs_no_answer(ahead: float) -> None:
    (other,) = neighbours("robot3")
    assert take(other, 100.0 + ahead, 1.0) is None


def test_record_of_sent_positions_is_bounded() -> None:
    mine = Answers(SIX, "robot2", neighbours("robot3"))
    for k in range(10_000):
        mine.record_sent(float(k), 0.05 * k)
    assert len(mine.state.sent) <= 20.0 * BOUND + 2


def test_robot_with_local_measurement_answers_no_neighbour() -> None:
    local = with_robots("six_robots", measurement="local")
    followed = [(name, other) for name in local.followers for other in local.robots[name].neighbours]
    assert followed
    assert not any(answers(local, name, other) for name, other in followed)
