"""The watchdog's table on a fake clock: when it stops the robot, and when it does not."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import cycle, pairwise
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.safety.commander import FAREWELL
from formation.agent.simulated.simulated import World
from formation.agent.watchdog.core import BRAKING_TIME, PARKING_TIME, SLOW_PERIOD, TABLE, Event, Watchdog
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.status import WatchdogState
from formation.ros2.messages import Number, Twist, TwistStamped, decode, encode
from formation.topics import ALIVE, CMD_VEL, command_topic
from formation.wire import Outgoing, Sample
from tests.support.fleet import EPOCH, at

SIX = load("six_robots")
PERIOD, LIMIT = 0.05, 0.15
CDR = b"\x00\x01\x00\x00"
"""The header of every encoded message."""
ALIVE_2, CMD_2 = ALIVE.key("robot2"), CMD_VEL.key("robot2")


def sign(moment: float, value: float = 1.0) -> Sample:
    return Sample(ALIVE_2, encode(Number(value)), None, moment)


def connected(mission: Mission = SIX, moment: float = 0.0) -> Watchdog:
    watchdog = Watchdog(mission, "robot2")
    watchdog.aware(connected=True, now=at(moment))
    return watchdog


def watching(moment: float = 0.0) -> Watchdog:
    watchdog = connected(moment=moment)
    assert watchdog.step(at(moment), [sign(moment)]) == []
    assert watchdog.state is WatchdogState.WATCHING
    return watchdog


def run_loop(watchdog: Watchdog, start: float, end: float, signs: Iterable[Sample] = ()) -> list[float]:
    """Step as the loop would from `start` to `end`; return the moments at which zero was sent."""
    result, moment, waiting = [], start, sorted(signs, key=lambda sample: sample.arrived)
    for _ in range(100_000):
        inbox = [sample for sample in waiting if sample.arrived <= moment]
        waiting = waiting[len(inbox) :]
        result += [moment for out in watchdog.step(at(moment), inbox) if is_zero(out)]
        following = min([watchdog.due, *(sample.arrived for sample in waiting[:1])])
        assert following > moment, "due must be later than the last step"
        moment = following
        if moment > end:
            return result
    raise AssertionError("too many steps")


def is_zero(out: Outgoing) -> bool:
    assert out.key == CMD_2
    assert decode(Twist, out.payload) == Twist(0.0, 0.0)
    return True


def steady(start: float, end: float) -> list[Sample]:
    """Signs of life in each period from `start` to `end`, both included."""
    return [sign(start + i * PERIOD, i * PERIOD) for i in range(round((end - start) / PERIOD) + 1)]


def stepped(watchdog: Watchdog, moment: float, value: float | None = None) -> Watchdog:
    watchdog.step(at(moment), [] if value is None else [sign(moment, value)])
    assert watchdog.state in {WatchdogState.BRAKING, WatchdogState.PARKING}
    return watchdog


def parked() -> Watchdog:
    watchdog = connected()
    run_loop(watchdog, 0.0, 9.0)
    assert watchdog.state is WatchdogState.DISARMED
    return watchdog


def test_watchdog_sends_zero_fast_then_slowly_during_silence() -> None:
    watchdog = watching()
    result = run_loop(watchdog, 0.0, 3600.0)
    assert result[0] == pytest.approx(LIMIT)
    fast = [moment for moment in result if moment < LIMIT + BRAKING_TIME]
    slow = [moment for moment in result if moment > LIMIT + BRAKING_TIME + SLOW_PERIOD]
    assert len(fast) == pytest.approx(BRAKING_TIME / PERIOD, abs=1.5)
    for moments, period in ((fast, PERIOD), (slow, SLOW_PERIOD)):
        assert [b - a for a, b in pairwise(moments)] == pytest.approx([period] * (len(moments) - 1))
    assert slow[-1] > 3600.0 - SLOW_PERIOD - 1e-6
    assert watchdog.state is WatchdogState.BRAKING


def test_lost_and_late_signs_of_life_cause_no_zero() -> None:
    signs = [
        sample._replace(arrived=sample.arrived + 0.04 * (i % 4 == 0))
        for i, sample in enumerate(steady(0.0, 10.0))
        if i % 2 == 0
    ]
    assert run_loop(watching(), 0.0, 9.9, signs) == []


def test_watchdog_stops_sending_zero_when_agent_returns() -> None:
    watchdog = watching()
    assert run_loop(watchdog, 0.0, 2.0)
    assert run_loop(watchdog, 2.0, 10.0, steady(2.0, 10.0)) == []
    assert watchdog.state is WatchdogState.WATCHING
    assert run_loop(watchdog, 10.0, 10.5)[0] == pytest.approx(10.0 + LIMIT)


def test_robot_is_parked_and_watchdog_disarmed_after_farewell() -> None:
    watchdog = watching()
    result = run_loop(watchdog, 0.1, 3600.0, [sign(0.1, 0.1), sign(0.12, FAREWELL)])
    assert result[0] == pytest.approx(0.12)
    assert result[-1] == pytest.approx(0.12 + PARKING_TIME, abs=PERIOD + 1e-6)
    assert len(result) == round(PARKING_TIME / PERIOD)
    assert watchdog.state is WatchdogState.DISARMED
    assert watchdog.due == float("inf")


def test_agent_starting_during_parking_drives_at_once() -> None:
    watchdog = watching()
    result = run_loop(watchdog, 0.1, 2.0, [sign(0.1, FAREWELL), *steady(0.3, 2.0)])
    assert max(result) < 0.3
    assert watchdog.state is WatchdogState.WATCHING


def test_watchdog_without_agent_parks_robot_and_disarms() -> None:
    watchdog = connected()
    result = run_loop(watchdog, 0.0, 3600.0)
    assert result[0] == pytest.approx(LIMIT)
    assert result[-1] < LIMIT + PARKING_TIME
    assert watchdog.state is WatchdogState.DISARMED


@pytest.mark.parametrize("phase", [0.0, 0.02, 0.049])
def test_watchdog_beside_healthy_agent_does_not_brake(phase: float) -> None:
    watchdog = connected()
    assert run_loop(watchdog, 0.0, 60.0, steady(phase, 60.0)) == []
    assert watchdog.state is WatchdogState.WATCHING


def test_time_without_router_does_not_count_as_silence() -> None:
    watchdog = Watchdog(SIX, "robot2")
    for moment in (0.0, 1.0, 100.0):
        watchdog.aware(connected=False, now=at(moment))
        assert watchdog.step(at(moment), []) == []
    watchdog.aware(connected=True, now=at(100.0))
    assert run_loop(watchdog, 100.0, 100.1, [sign(100.1)]) == []
    assert watchdog.state is WatchdogState.WATCHING


def test_disarmed_watchdog_sends_zero_after_reconnection() -> None:
    watchdog = parked()
    watchdog.aware(connected=False, now=at(10.0))
    watchdog.aware(connected=True, now=at(11.0))
    assert run_loop(watchdog, 11.0, 20.0)[0] == pytest.approx(11.0 + LIMIT)


def test_reconnected_watchdog_brakes_at_full_rate_again() -> None:
    watchdog = watching()
    run_loop(watchdog, 0.0, 20.0)
    watchdog.aware(connected=False, now=at(20.0))
    watchdog.aware(connected=True, now=at(20.3))
    result = run_loop(watchdog, 20.3, 21.0)
    assert result[0] == 20.3
    assert len(result) >= 13


def test_reconnection_is_no_sign_of_life() -> None:
    watchdog = watching()
    watchdog.aware(connected=False, now=at(0.05))
    watchdog.aware(connected=True, now=at(0.12))
    assert run_loop(watchdog, 0.12, 1.0)[0] == pytest.approx(LIMIT)


@pytest.mark.parametrize(
    ("watchdog", "zeros"),
    [
        pytest.param(lambda: watching(10.0), 0, id="healthy agent"),
        pytest.param(lambda: watching(9.8), 1, id="agent just silent"),
        pytest.param(lambda: stepped(watching(5.0), 6.0), 1, id="braking"),
        pytest.param(lambda: stepped(watching(9.9), 9.95, FAREWELL), 1, id="parking"),
        pytest.param(lambda: connected(moment=9.9), 1, id="before any sign"),
        pytest.param(parked, 0, id="disarmed"),
    ],
)
def test_halted_watchdog_sends_zero_only_without_healthy_agent(watchdog: object, zeros: int) -> None:
    assert callable(watchdog)
    result = watchdog().halt(at(10.05), "SIGTERM")
    assert len(result) == zeros
    assert all(map(is_zero, result))


@pytest.mark.parametrize(
    ("key", "payload", "where"),
    [
        *((ALIVE_2, payload, ALIVE_2) for payload in (b"", CDR, CDR + b"\xff" * 8)),
        *((ALIVE_2, encode(message), ALIVE_2) for message in (Twist(0.1, 0.0), Number(-7.0))),
        (ALIVE.key("robot3"), encode(Number(1.0)), "elsewhere"),
    ],
)
def test_invalid_signs_of_life_do_not_prevent_braking(key: str, payload: bytes, where: str) -> None:
    watchdog = watching()
    noise = [Sample(key, payload, None, 0.02 + i * PERIOD) for i in range(20)]
    assert run_loop(watchdog, 0.0, 0.9, noise)[0] == pytest.approx(LIMIT)
    assert watchdog.dropped == {where: 18}


def test_queued_signs_of_life_count_from_their_arrival() -> None:
    watchdog = watching()
    assert watchdog.step(at(1.0), steady(0.05, 0.95)) == []
    assert watchdog.state is WatchdogState.WATCHING
    watchdog = watching()
    assert len(watchdog.step(at(1.0), steady(0.05, 0.8))) == 1


@pytest.mark.parametrize("later", [0.6, 1.0, 3.0])
def test_repeated_signs_of_life_do_not_delay_braking(later: float) -> None:
    signs = steady(0.0, 10.0)
    repeated = [sample._replace(arrived=sample.arrived + later) for sample in signs]
    watchdog = connected()
    assert run_loop(watchdog, 0.0, 10.5, signs + repeated)[0] == pytest.approx(10.0 + LIMIT)


def test_agent_with_slower_clock_counts_all_the_time() -> None:
    """The agent runs on another machine; no clock is set by the network."""
    watchdog, slower = connected(), 1.0 - 4e-4
    signs = [sign(moment, slower * moment) for moment in (i * PERIOD for i in range(36_000))]
    assert watchdog.step(at(0.0), signs[:1]) == []
    for one in signs[1:]:
        assert watchdog.step(at(one.arrived), [one]) == []


def test_younger_agent_counts_soon_after_the_older_has_died() -> None:
    watchdog = connected()
    result = run_loop(watchdog, 0.0, 20.0, steady(0.0, 10.0) + steady(5.02, 20.02))
    assert result
    assert min(result) >= 10.0 + LIMIT
    assert max(result) <= 10.0 + LIMIT + PERIOD
    assert watchdog.state is WatchdogState.WATCHING


def test_watchdog_subscribes_to_alive_and_publishes_only_cmd_vel() -> None:
    for name, kind in (("six_robots", "twist"), ("turtlebot3_pair", "twist_stamped")):
        mission = load(name)
        robot = mission.followers[0]
        watchdog = Watchdog(mission, robot)
        assert watchdog.subscriptions == (ALIVE.key(robot),)
        ((topic, key),) = watchdog.publications
        assert (topic, key) == (command_topic(mission.robots[robot].cmd_vel), CMD_VEL.key(robot))
        watchdog.aware(connected=True, now=at(0.0))
        (out,) = watchdog.step(at(1.0), [])
        stamped = TwistStamped(EPOCH + 1.0, 0.0, 0.0)
        assert out.payload == encode(stamped if kind == "twist_stamped" else Twist(0.0, 0.0))


def test_watchdog_refuses_leader_and_unknown_robot() -> None:
    for name in ("robot1", "robot9"):
        with pytest.raises(ValueError, match=re.escape(f"robot '{name}': must be a follower of six-robots:")):
            Watchdog(SIX, name)


def test_every_state_handles_alive_and_only_parking_disarms() -> None:
    for state in WatchdogState:
        assert TABLE[state, Event.ALIVE] is WatchdogState.WATCHING
        assert TABLE[state, Event.FAREWELL] is WatchdogState.PARKING
        assert (state, Event.CONNECTED) in TABLE
    events = {after: {event for (_, event), to in TABLE.items() if to is after} for after in WatchdogState}
    assert events[WatchdogState.DISARMED] == {Event.PARKED}
    assert events[WatchdogState.WATCHING] == {Event.ALIVE, Event.CONNECTED}


def frozen() -> Watchdog:
    """A watchdog 5 s after its agent started; the agent is frozen next."""
    watchdog = connected()
    run_loop(watchdog, 0.0, 4.99, steady(0.0, 4.95))
    return watchdog


def queued_signs(end: float) -> list[Sample]:
    """Signs of life from 5 s to `end`, all read at 15 s, when the watchdog thaws."""
    return [sign(15.0, 5.0 + i * PERIOD) for i in range(round((end - 5.0) / PERIOD) + 1)]


def test_thawed_watchdog_does_not_trust_queued_signs() -> None:
    watchdog, signs = frozen(), queued_signs(5.95)  # when the agent died
    assert watchdog.step(at(15.0), signs[:10]) == []
    assert watchdog.state.value == "listening"
    assert len(watchdog.step(at(15.16), signs[10:])) == 1
    assert watchdog.state.value == "parking"


def test_thawed_watchdog_sends_no_zero_beside_healthy_agent() -> None:
    watchdog = frozen()
    assert watchdog.step(at(15.0), queued_signs(6.95)) == []
    assert watchdog.step(at(15.03), [sign(15.03, 15.02)]) == []
    assert watchdog.state is WatchdogState.WATCHING


def stopped_after(
    rate: float, kind: Literal["twist", "twist_stamped"], death: float, delays: Sequence[float]
) -> float:
    """Time from the death of an agent at `death` [s] until the wheels of its simulated robot stand [s].

    Each message of the agent and the watchdog takes one of `delays` [s].
    """
    spec = SIX.robots["robot2"].model_copy(update={"rate": rate, "cmd_vel": kind})
    mission = SIX.model_copy(update={"robots": {**SIX.robots, "robot2": spec}})
    world, watchdog, waits = World(mission, ["robot2"]), connected(mission), cycle(delays)
    events: list[tuple[float, World | Watchdog, Sample]] = []
    for i in range(int(death * rate) + 1):
        sent = i / rate
        arrives = sent + next(waits)
        command = Twist(0.3, 0.1) if kind == "twist" else TwistStamped(EPOCH + sent, 0.3, 0.1)
        events.append((arrives, world, Sample(CMD_2, encode(command), None, arrives)))
        events.append((arrives, watchdog, sign(arrives, sent)))
    moment, plant = 0.0, world.plant("robot2")
    while moment <= death or plant.moving.speed or plant.moving.turn_rate:
        assert moment < death + 2.0, "the robot drives on"
        events.sort(key=lambda event: event[0])
        moment = max(0.0, min([watchdog.due, world.due, *(event[0] for event in events[:1])]))
        arrived = [event for event in events if event[0] <= moment]
        events = events[len(arrived) :]
        for out in watchdog.step(at(moment), [sample for _, to, sample in arrived if to is watchdog]):
            arrives = moment + next(waits)
            events.append((arrives, world, Sample(out.key, out.payload, None, arrives)))
        world.step(at(moment), [sample for _, to, sample in arrived if to is world])
    return moment - death


@given(
    rate=st.sampled_from([20.0, 30.0, 50.0]),
    kind=st.sampled_from(["twist", "twist_stamped"]),
    death=st.floats(1.0, 1.2),
    delays=st.lists(st.floats(0.0, 0.02), min_size=1, max_size=7),
)
def test_wheels_stop_within_300_ms_of_agent_death(
    rate: float, kind: Literal["twist", "twist_stamped"], death: float, delays: list[float]
) -> None:
    assert stopped_after(rate, kind, death, delays) <= 0.3
