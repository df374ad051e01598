"""The guard's table, on a fake clock: who is stopped, when, and who is left alone."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.alive import FAREWELL
from agent.robots.guard.core import BRAKING, PARKING, SLOW, TABLE, Event, Guard, State
from agent.robots.simulated import World
from formation.mission import Mission
from formation.mission_file import load
from formation.ros2.messages import Number, Twist, TwistStamped, decode, encode
from formation.topics import ALIVE, CMD_VEL, command_topic
from formation.wire import Now, Outgoing, Sample

EPOCH = 1.7e9
SIX = load("six_robots")
PERIOD = 0.05
LIMIT = 0.15
ALIVE_2, CMD_2 = ALIVE.key("robot2"), CMD_VEL.key("robot2")


def at(seconds: float) -> Now:
    return Now(seconds, EPOCH + seconds)


def sign(moment: float, value: float = 1.0) -> Sample:
    return Sample(ALIVE_2, encode(Number(value)), None, moment)


def connected(mission: Mission = SIX, moment: float = 0.0) -> Guard:
    guard = Guard(mission, "robot2")
    guard.aware(connected=True, now=at(moment))
    return guard


def watching(moment: float = 0.0) -> Guard:
    guard = connected(moment=moment)
    assert guard.step(at(moment), [sign(moment)]) == []
    assert guard.state is State.WATCHING
    return guard


def lived(guard: Guard, start: float, end: float, signs: Iterable[Sample] = ()) -> list[float]:
    """Step as the loop would, from `start` to `end`; the moments at which zero was said."""
    said, moment, waiting = [], start, sorted(signs, key=lambda sample: sample.arrived)
    for _ in range(100_000):
        inbox = [sample for sample in waiting if sample.arrived <= moment]
        waiting = waiting[len(inbox) :]
        said += [moment for out in guard.step(at(moment), inbox) if is_zero(out)]
        following = min([guard.due, *(sample.arrived for sample in waiting[:1])])
        assert following > moment, "it wants to be stepped again and again"
        moment = following
        if moment > end:
            return said
    raise AssertionError("it never sleeps")


def is_zero(out: Outgoing) -> bool:
    assert out.key == CMD_2
    assert decode(Twist, out.payload) == Twist(0.0, 0.0)
    return True


def steady(start: float, end: float) -> list[Sample]:
    """An agent that lives from `start` to `end`, both included."""
    return [sign(start + i * PERIOD, i * PERIOD) for i in range(round((end - start) / PERIOD) + 1)]


def stepped(guard: Guard, moment: float, value: float | None = None) -> Guard:
    guard.step(at(moment), [] if value is None else [sign(moment, value)])
    assert guard.state in {State.BRAKING, State.PARKING}
    return guard


def parked() -> Guard:
    guard = connected()
    lived(guard, 0.0, 9.0)
    assert guard.state is State.DISARMED
    return guard


def test_a_guard_that_hears_its_agent_says_nothing() -> None:
    guard = connected()
    assert lived(guard, 0.0, 60.0, steady(0.02, 60.0)) == []
    assert guard.state is State.WATCHING


def test_an_agent_that_is_silent_for_three_periods_is_answered_by_zero_each_period() -> None:
    guard = watching()
    said = lived(guard, 0.0, 1.0)
    assert said[0] == pytest.approx(LIMIT)
    assert [b - a for a, b in pairwise(said)] == pytest.approx([PERIOD] * (len(said) - 1))
    assert len(said) >= 17
    assert guard.state is State.BRAKING


def test_every_other_sign_of_life_may_be_lost_and_the_rest_be_late_without_stopping_a_healthy_agent() -> None:
    signs = [
        sample._replace(arrived=sample.arrived + 0.04 * (i % 4 == 0))
        for i, sample in enumerate(steady(0.0, 10.0))
        if i % 2 == 0
    ]
    assert lived(watching(), 0.0, 9.9, signs) == []


def test_it_brakes_more_slowly_after_some_seconds_but_never_ends() -> None:
    said = lived(watching(), 0.0, 3600.0)
    slow = [moment for moment in said if moment > LIMIT + BRAKING + SLOW]
    assert [b - a for a, b in pairwise(slow)] == pytest.approx([SLOW] * (len(slow) - 1))
    assert slow[-1] > 3600.0 - SLOW - 1e-6
    fast = [moment for moment in said if moment < LIMIT + BRAKING]
    assert len(fast) == pytest.approx(BRAKING / PERIOD, abs=1.5)


def test_an_agent_that_comes_back_is_left_to_drive_at_once() -> None:
    guard = watching()
    assert lived(guard, 0.0, 2.0)
    assert lived(guard, 2.0, 10.0, steady(2.0, 10.0)) == []
    assert guard.state is State.WATCHING
    assert lived(guard, 10.0, 10.5)[0] == pytest.approx(10.0 + LIMIT)


def test_a_robot_whose_agent_took_its_leave_is_parked_and_then_left_alone() -> None:
    guard = watching()
    said = lived(guard, 0.1, 3600.0, [sign(0.1, 0.1), sign(0.12, FAREWELL)])
    assert said[0] == pytest.approx(0.12)
    assert said[-1] == pytest.approx(0.12 + PARKING, abs=PERIOD + 1e-6)
    assert len(said) == round(PARKING / PERIOD)
    assert guard.state is State.DISARMED
    assert guard.due == float("inf")


def test_a_farewell_frees_a_robot_whose_agent_died_without_a_word() -> None:
    guard = watching()
    assert len(lived(guard, 0.0, 30.0)) > 100
    said = lived(guard, 30.0, 60.0, [sign(30.0, FAREWELL)])
    assert said[-1] <= 30.0 + PARKING
    assert guard.state is State.DISARMED


def test_an_agent_that_starts_while_its_robot_is_parked_drives_at_once() -> None:
    guard = watching()
    said = lived(guard, 0.1, 2.0, [sign(0.1, FAREWELL), *steady(0.3, 2.0)])
    assert max(said) < 0.3
    assert guard.state is State.WATCHING


def test_a_guard_that_starts_where_no_agent_speaks_parks_the_robot_and_leaves_it_alone() -> None:
    guard = connected()
    said = lived(guard, 0.0, 3600.0)
    assert said[0] == pytest.approx(LIMIT)
    assert said[-1] < LIMIT + PARKING
    assert guard.state is State.DISARMED


def test_a_guard_that_starts_beside_a_healthy_agent_does_not_brake_it() -> None:
    for phase in (0.0, 0.02, 0.049):
        assert lived(connected(), 0.0, 5.0, steady(phase, 5.0)) == []


def test_time_without_a_router_does_not_count_as_silence_of_an_agent_that_was_never_heard() -> None:
    guard = Guard(SIX, "robot2")
    for moment in (0.0, 1.0, 100.0):
        guard.aware(connected=False, now=at(moment))
        assert guard.step(at(moment), []) == []
    guard.aware(connected=True, now=at(100.0))
    assert lived(guard, 100.0, 100.1, [sign(100.1)]) == []
    assert guard.state is State.WATCHING


def test_a_guard_that_finds_its_router_again_begins_anew() -> None:
    guard = connected()
    lived(guard, 0.0, 10.0)
    assert guard.state is State.DISARMED
    guard.aware(connected=False, now=at(10.0))
    guard.aware(connected=True, now=at(11.0))
    assert lived(guard, 11.0, 20.0)[0] == pytest.approx(11.0 + LIMIT)


def test_a_guard_that_finds_its_router_again_while_braking_brakes_at_full_rate_again() -> None:
    guard = watching()
    lived(guard, 0.0, 20.0)
    guard.aware(connected=False, now=at(20.0))
    guard.aware(connected=True, now=at(20.3))
    said = lived(guard, 20.3, 21.0)
    assert said[0] == 20.3
    assert len(said) >= 13


def test_a_router_that_comes_back_while_the_agent_is_watched_is_no_sign_of_life() -> None:
    guard = watching()
    guard.aware(connected=False, now=at(0.05))
    guard.aware(connected=True, now=at(0.12))
    assert lived(guard, 0.12, 1.0)[0] == pytest.approx(LIMIT)


@pytest.mark.parametrize(
    ("guard", "words"),
    [
        pytest.param(lambda: watching(10.0), 0, id="a healthy agent"),
        pytest.param(lambda: watching(9.8), 1, id="an agent just fallen silent"),
        pytest.param(lambda: stepped(watching(5.0), 6.0), 1, id="braking"),
        pytest.param(lambda: stepped(watching(9.9), 9.95, FAREWELL), 1, id="parking"),
        pytest.param(lambda: connected(moment=9.9), 1, id="not knowing"),
        pytest.param(parked, 0, id="a robot driven by hand"),
    ],
)
def test_a_guard_that_is_ended_has_zero_as_its_last_word_only_where_nobody_healthy_drives(
    guard: object, words: int
) -> None:
    assert callable(guard)
    said = guard().halt(at(10.05), "SIGTERM")
    assert len(said) == words
    assert all(map(is_zero, said))


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\x00\x01\x00\x00",
        encode(Twist(0.1, 0.0)),
        encode(Number(-7.0)),
        b"\x00\x01\x00\x00" + b"\xff" * 8,
    ],
)
def test_what_is_no_sign_of_life_does_not_keep_the_guard_from_braking_and_is_counted(payload: bytes) -> None:
    guard = watching()
    noise = [Sample(ALIVE_2, payload, None, 0.02 + i * PERIOD) for i in range(20)]
    assert lived(guard, 0.0, 0.9, noise)[0] == pytest.approx(LIMIT)
    assert guard.dropped == {ALIVE_2: 18}


def test_another_robots_sign_of_life_is_not_its_agents() -> None:
    guard = watching()
    other = [sign(i * PERIOD)._replace(key=ALIVE.key("robot3")) for i in range(1, 20)]
    assert lived(guard, 0.0, 0.9, other)[0] == pytest.approx(LIMIT)
    assert guard.dropped == {"elsewhere": 18}


def test_signs_of_life_that_waited_while_the_guard_slept_count_from_when_they_arrived() -> None:
    guard = watching()
    assert guard.step(at(1.0), steady(0.05, 0.95)) == []
    assert guard.state is State.WATCHING
    guard = watching()
    assert len(guard.step(at(1.0), steady(0.05, 0.8))) == 1


def test_it_listens_to_nothing_but_life_and_says_nothing_but_commands_of_the_robots_type() -> None:
    for name, kind in (("six_robots", "twist"), ("turtlebot3_pair", "twist_stamped")):
        mission = load(name)
        robot = mission.followers[0]
        guard = Guard(mission, robot)
        assert guard.subscriptions == (ALIVE.key(robot),)
        ((topic, key),) = guard.publications
        assert (topic, key) == (command_topic(mission.robots[robot].cmd_vel), CMD_VEL.key(robot))
        guard.aware(connected=True, now=at(0.0))
        (out,) = guard.step(at(1.0), [])
        stamped = TwistStamped(EPOCH + 1.0, 0.0, 0.0)
        assert out.payload == encode(stamped if kind == "twist_stamped" else Twist(0.0, 0.0))


def test_a_robot_without_an_agent_is_refused_by_name() -> None:
    for name in ("robot1", "robot9"):
        with pytest.raises(ValueError, match=re.escape(f"robot '{name}': must be a follower of six-robots:")):
            Guard(SIX, name)


def test_every_state_knows_what_follows_on_life_farewell_and_a_router_found_again() -> None:
    for state in State:
        assert TABLE[state, Event.ALIVE] is State.WATCHING
        assert TABLE[state, Event.FAREWELL] is State.PARKING
        assert (state, Event.CONNECTED) in TABLE


def test_only_one_who_hears_the_agent_or_has_parked_the_robot_can_come_to_be_silent() -> None:
    into_silence = {(event, after) for (_, event), after in TABLE.items() if after is State.DISARMED}
    assert into_silence == {(Event.PARKED, State.DISARMED)}
    assert {event for (_, event), after in TABLE.items() if after is State.WATCHING} == {
        Event.ALIVE,
        Event.CONNECTED,
    }


def stopped_after(
    rate: float, kind: Literal["twist", "twist_stamped"], death: float, delays: Sequence[float]
) -> float:
    """An agent drives a simulated robot and dies at `death` [s]; how much later the wheels stood [s].

    Each message of the agent takes one of `delays` [s]; so do the guard's.
    """
    robots = {
        name: spec.model_copy(update={"rate": rate, "cmd_vel": kind}) for name, spec in SIX.robots.items()
    }
    mission = SIX.model_copy(update={"robots": robots})
    world, guard = World(mission, ["robot2"]), connected(mission)
    events: list[tuple[float, str, Sample]] = []
    for i in range(int(death * rate) + 1):
        sent, wait = i / rate, delays[i % len(delays)]
        command = Twist(0.3, 0.1) if kind == "twist" else TwistStamped(EPOCH + sent, 0.3, 0.1)
        events.append((sent + wait, "world", Sample(CMD_2, encode(command), None, sent + wait)))
        events.append((sent + wait, "guard", sign(sent + wait, sent)))
    events.sort(key=lambda event: event[0])
    moment, number = 0.0, 0
    plant = world.plant("robot2")
    while moment <= death or plant.moving.speed or plant.moving.turn_rate:
        assert moment < death + 2.0, "it drives on"
        moment = min([guard.due, world.due, *(event[0] for event in events[:1])])
        moment = max(moment, 0.0)
        number += 1
        arrived = [event for event in events if event[0] <= moment]
        events = events[len(arrived) :]
        for out in guard.step(at(moment), [sample for _, who, sample in arrived if who == "guard"]):
            wait = delays[number % len(delays)]
            events.append((moment + wait, "world", Sample(out.key, out.payload, None, moment + wait)))
            events.sort(key=lambda event: event[0])
        world.step(at(moment), [sample for _, who, sample in arrived if who == "world"])
    return moment - death


@given(
    rate=st.sampled_from([20.0, 30.0, 50.0]),
    kind=st.sampled_from(["twist", "twist_stamped"]),
    death=st.floats(1.0, 1.2),
    delays=st.lists(st.floats(0.0, 0.02), min_size=1, max_size=7),
)
def test_whenever_an_agent_dies_its_robots_wheels_stand_within_0_3_s(
    rate: float, kind: Literal["twist", "twist_stamped"], death: float, delays: list[float]
) -> None:
    assert stopped_after(rate, kind, death, delays) <= 0.3
