"""Positions of a robot are accepted from one publisher at a time, and no position twice."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.following.publisher import AcceptedPublisher
from formation.mission.file import load
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.ros2.messages import Pose, decode, encode
from formation.topics import POSITION
from formation.wire import BadMessage, Sample
from tests.support.fleet import Fleet
from tests.support.meddling import Meddle, on

SIX, PAIR = load("six_robots"), load("turtlebot3_pair")
KEY = POSITION.key("robot2")
PERIOD = 0.05
LIMIT = 3 * PERIOD
Commands = dict[str, list[tuple[float, float, float]]]


def decoded(sample: Sample, **changes: object) -> Sample:
    result = json_message.decode(PositionAttachment, sample.attachment or b"").model_copy(update=changes)
    return sample._replace(attachment=json_message.encode(result))


def moved(sample: Sample, by: complex) -> Sample:
    pose = decode(Pose, sample.payload)
    return sample._replace(payload=encode(Pose(pose.stamp, pose.position + by, pose.heading)))


def second_agent(sample: Sample) -> tuple[Sample, ...]:
    """Add a second publisher for robot2, over 1 m away, which relays a stop at twice the rate."""
    result = json_message.decode(PositionAttachment, sample.attachment or b"")
    stop = result.order and result.order.model_copy(update={"mode": "stop", "beat": result.order.beat + 1})
    false = moved(decoded(sample, publisher_id="second", order=stop), 1.0 + 1.0j)
    return (sample, false, decoded(false, count=result.count + 1))


def replaying(seconds: float, *, speed: int) -> Meddle:
    """Replay robot2's messages of `seconds` ago, `speed` of them with each new message."""
    kept: list[Sample] = []

    def meddle(sample: Sample) -> tuple[Sample, ...]:
        kept.append(sample)
        now = len(kept) - 2 * round(seconds / PERIOD)  # each of two neighbours gets its own copy
        old = kept[max(0, now) : max(0, now) + speed]
        return (*(one._replace(arrived=sample.arrived) for one in old if now > 0), sample)

    return meddle


def commands(meddle: Meddle, seconds: float = 15.0) -> tuple[Fleet, Commands]:
    fleet = Fleet(SIX)
    fleet.meddle = on(KEY, meddle)
    fleet.run(seconds)
    return fleet, fleet.commands


@pytest.fixture(scope="module")
def undisturbed() -> Commands:
    return commands(lambda sample: (sample,))[1]


@pytest.mark.slow
def test_second_agent_changes_no_command_and_is_reported(undisturbed: Commands) -> None:
    fleet, disturbed = commands(second_agent)
    assert disturbed == undisturbed
    for name in ("robot3", "robot4"):
        agent = fleet.agents[name]
        assert agent.dropped[KEY] == pytest.approx(2 * 15.0 / PERIOD, abs=10)
        status = fleet.status(name)
        assert "robot2 has a second publisher" in status.dropped_last[KEY]
        assert status.contested == ("robot2",)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.05, 0.1, 1.0, 5.0])
@pytest.mark.parametrize("speed", [1, 3])
def test_replayed_messages_change_no_command_and_are_counted(
    undisturbed: Commands, seconds: float, speed: int
) -> None:
    fleet, disturbed = commands(replaying(seconds, speed=speed))
    assert disturbed == undisturbed
    for name in ("robot3", "robot4"):
        assert fleet.agents[name].dropped[KEY] >= (15.0 - seconds) / PERIOD - 10
        assert "repeated" in fleet.status(name).dropped_last[KEY]


def test_replayed_messages_of_dead_neighbour_are_not_followed() -> None:
    fleet, kept = Fleet(SIX), list[Sample]()

    def record(sample: Sample) -> tuple[Sample]:
        kept.append(sample)
        return (sample,)

    fleet.meddle = on(KEY, record)
    fleet.run(8.0)
    fleet.kill("robot2")
    tape = iter(kept[-150:])

    fleet.meddle = on(POSITION.key("robot1"), lambda one: (one, next(tape)._replace(arrived=one.arrived)))
    fleet.run(2.0)
    assert fleet.agents["robot3"].neighbours.each["robot2"].stream.state.arrived == pytest.approx(
        8.0, abs=0.1
    )


@pytest.mark.slow
def test_successor_agent_is_followed_after_first_falls_silent() -> None:
    fleet = Fleet(SIX).after(8.0)
    fleet.restart("robot2")  # with a new publisher id
    stream = fleet.agents["robot3"].neighbours.each["robot2"].stream
    last = stream.state.arrived or 0.0
    fleet.run(last + LIMIT - fleet.now)
    assert stream.state.arrived == last
    fleet.run(PERIOD + 0.002)
    assert stream.state.arrived is not None
    assert stream.state.arrived > last
    fleet.run(5.0)
    assert fleet.error() < SIX.settled
    assert fleet.agents["robot3"].decision.state == "run"


def test_former_publisher_may_return_but_not_repeat() -> None:
    """It was disconnected while another agent of the robot was received, which has ended since."""
    publisher = AcceptedPublisher("robot2", 20.0)
    publisher.admit(PositionAttachment(publisher_id="a", count=1), 0.0)
    publisher.admit(PositionAttachment(publisher_id="b", count=1), 1.0)
    with pytest.raises(BadMessage, match="repeated"):
        publisher.admit(PositionAttachment(publisher_id="a", count=1), 9.0)
    publisher.admit(PositionAttachment(publisher_id="b", count=2), 9.0)
    with pytest.raises(BadMessage, match="second publisher"):
        publisher.admit(PositionAttachment(publisher_id="a", count=180), 9.05)
    publisher.admit(PositionAttachment(publisher_id="a", count=190), 10.0)


@pytest.mark.parametrize("actual_rate", [20.0, 50.0, 100.0])
def test_publisher_above_nominal_rate_is_accepted_after_outage(actual_rate: float) -> None:
    publisher, received = AcceptedPublisher("robot2", 20.0), 0.0
    for count in range(round(20.0 * actual_rate)):
        mono = count / actual_rate
        if 5.0 <= mono < 12.0:
            continue
        with suppress(BadMessage):
            publisher.admit(PositionAttachment(publisher_id="a", count=count), mono)
            received = mono
        assert mono <= 12.1 or received == mono


def test_highest_possible_count_silences_no_publisher() -> None:
    publisher = AcceptedPublisher("robot2", 20.0)
    publisher.admit(PositionAttachment(publisher_id="a", count=1), 0.0)
    with pytest.raises(BadMessage, match="position count leaps from 1 to "):
        publisher.admit(PositionAttachment(publisher_id="a", count=2**63 - 1), 0.01)
    publisher.admit(PositionAttachment(publisher_id="a", count=2), PERIOD)


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 40), st.floats(0.0, 0.1)), max_size=80))
def test_publisher_changes_only_after_limit_and_counts_rise(
    messages: list[tuple[str, int, float]],
) -> None:
    publisher, mono = AcceptedPublisher("robot2", 20.0), 0.0
    admitted: list[tuple[str, int, float]] = []
    for name, count, wait in messages:
        mono += wait
        try:
            publisher.admit(PositionAttachment(publisher_id=name, count=count), mono)
        except BadMessage:
            continue
        if admitted and admitted[-1][0] == name:
            assert count > admitted[-1][1]
        elif admitted:
            assert mono - admitted[-1][2] > publisher.limit
            assert count > max((number for one, number, _ in admitted if one == name), default=-1)
        admitted.append((name, count, mono))


def test_second_publisher_of_leader_changes_no_command() -> None:
    fleet = Fleet(PAIR)
    fleet.meddle = on(
        POSITION.key("leader"), lambda one: (one, moved(decoded(one, publisher_id="second"), -3.0))
    )
    assert fleet.after(10.0).commands == Fleet(PAIR).after(10.0).commands


def leading(publisher_id: str, term: int | None, count: int = 0) -> PositionAttachment:
    result = None if term is None else Order(term=term, beat=count, mode="run", shape="hexagon")
    return PositionAttachment(publisher_id=publisher_id, count=count, order=result)


def test_leader_of_later_voted_term_is_accepted_immediately() -> None:
    """The earlier leader has ended in order: there is no wait, and the leader is not contested."""
    publisher = AcceptedPublisher("leader", 1.0 / PERIOD)
    publisher.admit(leading("old", 8), 0.0, 8)
    publisher.admit(leading("new", 9), PERIOD, 9)
    assert publisher.state.contested == float("-inf")
    with pytest.raises(BadMessage, match="second publisher"):
        publisher.admit(leading("old", 8, 1), 2 * PERIOD, 9)


@pytest.mark.parametrize(
    ("old", "new", "voted_term"),
    [(8, 9, 0), (8, 9, 8), (8, 9, 10), (8, 8, 8), (8, 7, 7), (None, 9, 9)],
    ids=["no standbys", "no vote", "vote for another term", "same term", "earlier term", "no order"],
)
def test_any_other_second_publisher_of_leader_is_refused(old: int | None, new: int, voted_term: int) -> None:
    publisher = AcceptedPublisher("leader", 1.0 / PERIOD)
    publisher.admit(leading("old", old), 0.0, voted_term)
    with pytest.raises(BadMessage, match="second publisher"):
        publisher.admit(leading("new", new), PERIOD, voted_term)
    assert publisher.state.contested == PERIOD
    publisher.admit(leading("old", old, 1), 2 * PERIOD, voted_term)
