"""Which process publishes for a neighbour: one, and nothing that it has published before."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.following.publisher import AcceptedPublisher
from formation.mission.file import load
from formation.protocol import order
from formation.protocol.order import Order, PositionAttachment
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
    result = order.decode(PositionAttachment, sample.attachment or b"").model_copy(update=changes)
    return sample._replace(attachment=order.encode(result))


def moved(sample: Sample, by: complex) -> Sample:
    pose = decode(Pose, sample.payload)
    return sample._replace(payload=encode(Pose(pose.stamp, pose.position + by, pose.heading)))


def second_agent(sample: Sample) -> tuple[Sample, ...]:
    """Another agent speaks for robot2, a metre away and ordering a stop, twice as often as the first."""
    result = order.decode(PositionAttachment, sample.attachment or b"")
    stop = result.order and result.order.model_copy(update={"mode": "stop", "beat": result.order.beat + 1})
    false = moved(decoded(sample, publisher_id="second", order=stop), 1.0 + 1.0j)
    return (sample, false, decoded(false, count=result.count + 1))


def playing_back(seconds: float, *, speed: int) -> Meddle:
    """Somebody plays back what robot2 said some time ago, `speed` messages for each that it says."""
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
def test_what_was_said_before_changes_no_command_and_is_counted(
    undisturbed: Commands, seconds: float, speed: int
) -> None:
    fleet, disturbed = commands(playing_back(seconds, speed=speed))
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


def test_former_publisher_repeats_nothing_but_may_return() -> None:
    """Its process was cut off while another agent of the robot was received, and that one has ended."""
    publisher = AcceptedPublisher("robot2", 20.0)
    publisher.admit(PositionAttachment(publisher_id="a", count=1), 0.0)
    publisher.admit(PositionAttachment(publisher_id="b", count=1), 1.0)
    with pytest.raises(BadMessage, match="repeated"):
        publisher.admit(PositionAttachment(publisher_id="a", count=1), 9.0)
    publisher.admit(PositionAttachment(publisher_id="b", count=2), 9.0)
    with pytest.raises(BadMessage, match="second publisher"):
        publisher.admit(PositionAttachment(publisher_id="a", count=180), 9.05)
    publisher.admit(PositionAttachment(publisher_id="a", count=190), 10.0)


@pytest.mark.parametrize("told_at", [20.0, 50.0, 100.0])
def test_robot_above_nominal_rate_is_heard_after_outage(told_at: float) -> None:
    publisher, received = AcceptedPublisher("robot2", 20.0), 0.0
    for count in range(round(20.0 * told_at)):
        mono = count / told_at
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
def test_one_publisher_at_a_time_with_rising_count(messages: list[tuple[str, int, float]]) -> None:
    publisher, mono = AcceptedPublisher("robot2", 20.0), 0.0
    admitted: list[tuple[str, int, float]] = []
    for who, count, wait in messages:
        mono += wait
        try:
            publisher.admit(PositionAttachment(publisher_id=who, count=count), mono)
        except BadMessage:
            continue
        if admitted and admitted[-1][0] == who:
            assert count > admitted[-1][1]
        elif admitted:
            assert mono - admitted[-1][2] > publisher.limit
            assert count > max((number for one, number, _ in admitted if one == who), default=-1)
        admitted.append((who, count, mono))


def test_a_leader_has_one_publisher_as_well() -> None:
    fleet = Fleet(PAIR)
    fleet.meddle = on(
        POSITION.key("leader"), lambda one: (one, moved(decoded(one, publisher_id="second"), -3.0))
    )
    assert fleet.after(10.0).commands == Fleet(PAIR).after(10.0).commands


def leading(publisher_id: str, term: int | None, count: int = 0) -> PositionAttachment:
    result = None if term is None else Order(term=term, beat=count, mode="run", shape="hexagon")
    return PositionAttachment(publisher_id=publisher_id, count=count, order=result)


def test_leader_of_later_voted_term_is_accepted_immediately() -> None:
    """The one before it has stopped in order: nothing is to be waited for, and nobody is suspect."""
    publisher = AcceptedPublisher("leader", 1.0 / PERIOD)
    publisher.admit(leading("old", 8), 0.0, 8)
    publisher.admit(leading("new", 9), PERIOD, 9)
    assert publisher.state.contested == float("-inf")
    with pytest.raises(BadMessage, match="second publisher"):
        publisher.admit(leading("old", 8, 1), 2 * PERIOD, 9)


@pytest.mark.parametrize(
    ("old", "new", "voted_term"),
    [(8, 9, 0), (8, 9, 8), (8, 9, 10), (8, 8, 8), (8, 7, 7), (None, 9, 9)],
    ids=["no standbys", "not voted for", "another voted for", "the same term", "an earlier term", "no order"],
)
def test_any_other_second_publisher_of_the_leader_waits(old: int | None, new: int, voted_term: int) -> None:
    publisher = AcceptedPublisher("leader", 1.0 / PERIOD)
    publisher.admit(leading("old", old), 0.0, voted_term)
    with pytest.raises(BadMessage, match="second publisher"):
        publisher.admit(leading("new", new), PERIOD, voted_term)
    assert publisher.state.contested == PERIOD
    publisher.admit(leading("old", old, 1), 2 * PERIOD, voted_term)
