"""Who may speak for a neighbour: one voice, and nothing that it has said before."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.voice import Voice
from formation import order
from formation.mission_file import load
from formation.order import Order, Told
from formation.ros2.messages import Pose, decode, encode
from formation.topics import POSITION
from formation.wire import BadMessage, Sample
from tests.agent.fleet import Fleet
from tests.agent.missions import with_robots

SIX = load("six_robots")
KEY = POSITION.key("robot2")
PERIOD = 0.05
LIMIT = 3 * PERIOD

Meddle = Callable[[Sample], tuple[Sample, ...]]


def told(sample: Sample, **changes: object) -> Sample:
    said = order.decode(Told, sample.attachment or b"").model_copy(update=changes)
    return sample._replace(attachment=order.encode(said))


def moved(sample: Sample, by: complex) -> Sample:
    pose = decode(Pose, sample.payload)
    return sample._replace(payload=encode(Pose(pose.stamp, pose.position + by, pose.heading)))


def second_agent(sample: Sample) -> tuple[Sample, ...]:
    """Another agent speaks for robot2, a metre away and ordering a stop, twice as often as the first."""
    if sample.key != KEY:
        return (sample,)
    said = order.decode(Told, sample.attachment or b"")
    stop = said.order and said.order.model_copy(update={"mode": "stop", "beat": said.order.beat + 1})
    false = moved(told(sample, voice="second", order=stop), 1.0 + 1.0j)
    return (sample, false, told(false, count=said.count + 1))


def playing_back(seconds: float, *, speed: int) -> Meddle:
    """Somebody plays back what robot2 said some time ago, `speed` messages for each that it says."""
    kept: list[Sample] = []

    def meddle(sample: Sample) -> tuple[Sample, ...]:
        if sample.key != KEY:
            return (sample,)
        kept.append(sample)
        now = len(kept) - 2 * round(seconds / PERIOD)  # each of two neighbours gets its own copy
        old = kept[max(0, now) : max(0, now) + speed]
        return (*(one._replace(arrived=sample.arrived) for one in old if now > 0), sample)

    return meddle


def commands(meddle: Meddle, seconds: float = 15.0) -> tuple[Fleet, dict[str, list[tuple[float, ...]]]]:
    fleet = Fleet(SIX)
    fleet.meddle = meddle
    fleet.run(seconds)
    return fleet, {name: [*fleet.commands[name]] for name in SIX.followers}


@pytest.fixture(scope="module")
def undisturbed() -> dict[str, list[tuple[float, ...]]]:
    return commands(lambda sample: (sample,))[1]


def test_a_second_agent_of_a_robot_changes_no_command_and_is_counted_and_named(
    undisturbed: dict[str, list[tuple[float, ...]]],
) -> None:
    fleet, disturbed = commands(second_agent)
    assert disturbed == undisturbed
    for name in ("robot3", "robot4"):
        agent = fleet.agents[name]
        assert agent.dropped[KEY] == pytest.approx(2 * 15.0 / PERIOD, abs=10)
        status = fleet.status(name)
        assert "robot2 speaks with a second voice" in status[f"dropped {KEY}"]
        assert status["second voice robot2"] == "two agents speak for it"


@pytest.mark.parametrize("seconds", [0.05, 0.1, 1.0, 5.0])
@pytest.mark.parametrize("speed", [1, 3])
def test_what_was_said_before_changes_no_command_and_is_counted(
    undisturbed: dict[str, list[tuple[float, ...]]], seconds: float, speed: int
) -> None:
    fleet, disturbed = commands(playing_back(seconds, speed=speed))
    assert disturbed == undisturbed
    for name in ("robot3", "robot4"):
        assert fleet.agents[name].dropped[KEY] >= (15.0 - seconds) / PERIOD - 10
        assert "said before" in fleet.status(name)[f"dropped {KEY}"]


def test_what_a_dead_neighbour_said_is_not_followed_when_it_is_played_back() -> None:
    fleet, kept = Fleet(SIX), list[Sample]()

    def record(sample: Sample) -> tuple[Sample]:
        if sample.key == KEY:
            kept.append(sample)
        return (sample,)

    fleet.meddle = record
    fleet.run(8.0)
    fleet.kill("robot2")
    tape = iter(kept[-150:])

    def play(sample: Sample) -> tuple[Sample, ...]:
        if sample.key != POSITION.key("robot1"):
            return (sample,)
        return (sample, next(tape)._replace(arrived=sample.arrived))

    fleet.meddle = play
    fleet.run(2.0)
    assert fleet.agents["robot3"]._neighbours.each["robot2"].stream.arrived == pytest.approx(8.0, abs=0.1)


def test_the_next_agent_of_a_robot_is_followed_once_the_first_has_fallen_silent() -> None:
    fleet = Fleet(SIX)
    fleet.run(8.0)
    fleet.nodes["robot2"].core = fleet.agents["robot2"] = fleet.new_agent("robot2")  # with a new voice
    fleet.revive("robot2")
    stream = fleet.agents["robot3"]._neighbours.each["robot2"].stream
    last = stream.arrived or 0.0
    fleet.run(last + LIMIT - fleet.now)
    assert stream.arrived == last
    fleet.run(PERIOD + 0.002)
    assert stream.arrived is not None
    assert stream.arrived > last
    fleet.run(5.0)
    assert fleet.error() < SIX.settled
    assert fleet.agents["robot3"].decision.state == "run"


def test_former_voice_repeats_nothing_but_may_return() -> None:
    """Its process was cut off while another agent of the robot was heard, and that one has ended."""
    voice = Voice("robot2", 20.0)
    voice.admit(Told(voice="a", count=1), 0.0)
    voice.admit(Told(voice="b", count=1), 1.0)
    with pytest.raises(BadMessage, match="said before"):
        voice.admit(Told(voice="a", count=1), 9.0)
    voice.admit(Told(voice="b", count=2), 9.0)
    with pytest.raises(BadMessage, match="second voice"):
        voice.admit(Told(voice="a", count=180), 9.05)
    voice.admit(Told(voice="a", count=190), 10.0)


@pytest.mark.parametrize("told_at", [20.0, 50.0, 100.0])
def test_a_robot_that_tells_more_often_than_was_promised_is_heard_again_after_an_outage(
    told_at: float,
) -> None:
    voice, heard = Voice("robot2", 20.0), 0.0
    for count in range(round(20.0 * told_at)):
        mono = count / told_at
        if 5.0 <= mono < 12.0:
            continue
        with suppress(BadMessage):
            voice.admit(Told(voice="a", count=count), mono)
            heard = mono
        assert mono <= 12.1 or heard == mono


def test_one_message_with_the_highest_count_there_is_silences_nobody() -> None:
    voice = Voice("robot2", 20.0)
    voice.admit(Told(voice="a", count=1), 0.0)
    with pytest.raises(BadMessage, match="just now at 1"):
        voice.admit(Told(voice="a", count=2**63 - 1), 0.01)
    voice.admit(Told(voice="a", count=2), PERIOD)


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 40), st.floats(0.0, 0.1)), max_size=80))
def test_while_one_voice_speaks_no_other_does_and_its_count_only_rises(
    messages: list[tuple[str, int, float]],
) -> None:
    voice, mono = Voice("robot2", 20.0), 0.0
    admitted: list[tuple[str, int, float]] = []
    for who, count, wait in messages:
        mono += wait
        try:
            voice.admit(Told(voice=who, count=count), mono)
        except BadMessage:
            continue
        if admitted and admitted[-1][0] == who:
            assert count > admitted[-1][1]
        elif admitted:
            assert mono - admitted[-1][2] > voice.limit
            assert count > max((number for one, number, _ in admitted if one == who), default=-1)
        admitted.append((who, count, mono))


def test_a_leader_has_one_voice_as_well() -> None:
    fleet = Fleet(with_robots("turtlebot3_pair"))

    def second_leader(sample: Sample) -> tuple[Sample, ...]:
        if sample.key != POSITION.key("leader"):
            return (sample,)
        return (sample, moved(told(sample, voice="second"), -3.0))

    honest = Fleet(with_robots("turtlebot3_pair"))
    fleet.meddle = second_leader
    for one in (fleet, honest):
        one.run(10.0)
    assert fleet.commands == honest.commands


def leading(voice: str, term: int, count: int = 0) -> Told:
    return Told(voice=voice, count=count, order=Order(term=term, beat=count, mode="run", shape="hexagon"))


def test_who_leads_in_a_later_term_that_was_promised_speaks_at_once() -> None:
    """The one before it has stopped in order: nothing is to be waited for, and nobody is suspect."""
    voice = Voice("leader", 1.0 / PERIOD)
    voice.admit(leading("old", 8), 0.0, 8)
    voice.admit(leading("new", 9), PERIOD, 9)
    assert voice.contested == float("-inf")
    with pytest.raises(BadMessage, match="second voice"):
        voice.admit(leading("old", 8, 1), 2 * PERIOD, 9)


@pytest.mark.parametrize(
    ("term", "promise"),
    [(9, 0), (9, 8), (9, 10), (8, 8), (7, 7)],
    ids=["no standbys", "not promised", "another promised", "the same term", "an earlier term"],
)
def test_any_other_second_voice_for_the_leader_waits(term: int, promise: int) -> None:
    voice = Voice("leader", 1.0 / PERIOD)
    voice.admit(leading("old", 8), 0.0, promise)
    with pytest.raises(BadMessage, match="second voice"):
        voice.admit(leading("new", term), PERIOD, promise)
    assert voice.contested == PERIOD
    voice.admit(leading("old", 8, 1), 2 * PERIOD, promise)


def test_a_voice_that_tells_no_order_is_followed_by_none_in_a_hurry() -> None:
    voice = Voice("leader", 1.0 / PERIOD)
    voice.admit(Told(voice="old", count=0), 0.0, 9)
    with pytest.raises(BadMessage, match="second voice"):
        voice.admit(leading("new", 9), PERIOD, 9)
