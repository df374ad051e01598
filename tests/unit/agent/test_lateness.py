"""Freshness of stamped messages, and fleets with a growing delay of messages."""

from __future__ import annotations

import math
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.pose.stream import Stream, TooLateError
from formation.control.tracker import MAX_DELAY
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.lateness import MAX_BEAT_LATENESS, SETTLED_TIME
from formation.protocol.order import LEADER_TIMEOUT_SECONDS
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import AgentState
from formation.wire import BadMessage, Now
from tests.support.examples import slow
from tests.support.fleet import EPOCH, Fleet, Link, at
from tests.support.missions import with_robots

SIX = load("six_robots")
EXTERNAL = with_robots("six_robots", localisation="external")
PAIR = load("turtlebot3_pair")
HELD_WITHIN = LEADER_TIMEOUT_SECONDS + MAX_BEAT_LATENESS + 1.5
"""Time after their leader's death within which robots behind links that slow down hold [s]."""


@pytest.mark.slow
@pytest.mark.parametrize(("mission", "late"), [(SIX, 0.3), (EXTERNAL, 1.0)], ids=["odometry", "external"])
def test_robot_holds_while_own_positions_are_late(mission: Mission, late: float) -> None:
    fleet = Fleet.under_way(mission, 9.0)
    fleet.sensors["robot3"] = Link(0.0, (late, late))
    fleet.run(1.0)
    assert fleet.driven("robot3", 7.0) < 0.1
    assert fleet.status("robot3").state == "hold"
    fleet.sensors.clear()
    fleet.run(6.0)
    assert fleet.status("robot3").state == "run"


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.1, 0.15])
def test_own_positions_late_within_limit_keep_formation(late: float) -> None:
    fleet = Fleet(SIX)
    fleet.sensors = dict.fromkeys(SIX.followers, Link(0.0, (late, late)))
    fleet.run(20.0)
    assert fleet.error() < SIX.settled
    assert fleet.states == {AgentState.RUN}


@pytest.mark.parametrize(("growth", "bandwidth"), [(1.0, math.inf), *slow((0.0, 3000.0))])
def test_robots_hold_soon_after_leader_dies_behind_slow_links(growth: float, bandwidth: float) -> None:
    fleet = Fleet.under_way(PAIR, 9.0)
    link = Link(0.0, (0.001, 0.002), growth=growth, bandwidth=bandwidth)
    for pair in product(("leader", *PAIR.followers), PAIR.followers):
        fleet.links[pair] = link._replace(since=fleet.now)
    fleet.run(4.0)
    fleet.kill("leader")
    fleet.run(HELD_WITHIN)
    assert all(AgentState.RUN not in one.states for one in fleet.every(0.05, 30.0 - HELD_WITHIN))


def behind_slowing_links(seconds: float) -> Fleet:
    fleet = Fleet.under_way(PAIR, 8.0)
    fleet.links["leader", "robot2"] = Link(0.0, (0.0005, 0.002), growth=1.0, since=fleet.now)
    return fleet.after(seconds)


def test_hold_takes_effect_behind_slowing_links() -> None:
    fleet = behind_slowing_links(3.0)
    fleet.ask("robot1", "hold")
    fleet.run(LEADER_TIMEOUT_SECONDS + MAX_BEAT_LATENESS)
    assert fleet.agents["robot2"].decision.state is AgentState.HOLD


def test_robot_follows_again_after_links_recover() -> None:
    fleet = behind_slowing_links(5.0)
    assert fleet.agents["robot2"].decision.state == "hold"
    fleet.heal()
    fleet.run(1.0)
    assert fleet.agents["robot2"].decision.state is AgentState.RUN


def test_thawed_leader_is_followed_at_once() -> None:
    fleet = Fleet.under_way(PAIR, 8.0)
    fleet.freeze("leader")
    fleet.run(5.0)
    fleet.thaw("leader")
    fleet.run(0.5)
    assert fleet.agents["robot2"].decision.state is AgentState.RUN


@pytest.mark.slow
def test_uneven_links_cause_only_short_holds() -> None:
    fleet = Fleet(SIX, delay=(0.1, 0.3), seed=3).after(15.0)
    held: list[Reason] = []
    for _ in fleet.every(0.1, 10.0):
        agents = fleet.agents.values()
        held += [one.decision.reason for one in agents if one.decision.state is AgentState.HOLD]
    assert len(held) < 10  # samples that overtake each other leave gaps of over three periods
    assert {reason.code for reason in held} <= {Code.NO_NEIGHBOUR}
    assert not any(reason.values["unavailable"] for reason in held)


RATE = 20.0
PERIOD = 1.0 / RATE


def stream_after(*moments: float, sender_error: float = 0.0) -> Stream:
    stream = Stream(RATE)
    for moment in moments:
        stream.admit(EPOCH + moment + sender_error, moment, at(moment))
    return stream


def test_stream_is_not_fresh_before_first_message() -> None:
    stream = Stream(RATE)
    assert not stream.fresh(at(0.0))
    assert stream.silence(at(0.0)) == float("inf")


@pytest.mark.parametrize(
    ("sent", "arrived", "interval"), [(0.050, 0.057, 0.050), (0.3, 0.3, 0.3), (1.1, 1.1, None)]
)
def test_interval_is_from_sender_stamps_and_none_after_silence(
    sent: float, arrived: float, interval: float | None
) -> None:
    elapsed = stream_after(0.0).admit(EPOCH + sent, arrived, at(arrived))
    assert elapsed == (interval and pytest.approx(interval, abs=1e-6))


@pytest.mark.parametrize(
    ("error", "agrees", "way"),
    [
        *((-way, True, way) for way in (0.0, 0.2, 0.499)),
        (-0.7, False, 0.3),
        *((error, False, 0.0) for error in (-10.0, -1.0, 0.5, 10.0)),
    ],
    ids=lambda value: f"{value}",
)
def test_transport_delay_counts_for_age_but_not_for_freshness(error: float, agrees: bool, way: float) -> None:
    """If the sender's clock can be right; only part of a delay that is too long counts."""
    stream = stream_after(0.0, sender_error=error)
    assert stream.clock_agrees is agrees
    assert stream.age(at(0.02)) == pytest.approx(0.02 + way, abs=1e-6)
    assert stream.fresh(at(3 * PERIOD - 1e-9))
    assert not stream.fresh(at(3 * PERIOD + 1e-6))


def test_overtaken_message_is_refused() -> None:
    stream = stream_after(0.0, 0.10)
    with pytest.raises(BadMessage):
        stream.admit(EPOCH + 0.05, 0.101, at(0.101))


@pytest.mark.parametrize("step", [-3600.0, -10.0, 10.0, 3600.0])
def test_changed_sender_clock_is_accepted_after_silence(step: float) -> None:
    stream = stream_after(0.0, 0.05)
    for moment in (0.10, 0.15, 0.199):
        with pytest.raises(BadMessage):
            stream.admit(EPOCH + moment + step, moment, at(moment))
    assert stream.admit(EPOCH + 0.25 + step, 0.25, at(0.25)) is None
    assert stream.admit(EPOCH + 0.30 + step, 0.30, at(0.30)) == pytest.approx(0.05, abs=1e-6)
    assert stream.fresh(at(0.30))
    assert not stream.clock_agrees


@pytest.mark.parametrize("speed", [1, 2, 5])
def test_replayed_messages_among_fresh_ones_are_refused(speed: int) -> None:
    stream = stream_after(0.0)
    for number in range(1, 100):
        moment = number * PERIOD
        for part in range(speed):
            replayed = moment + part * PERIOD / speed
            with pytest.raises(BadMessage):
                stream.admit(EPOCH - 10.0 + replayed, replayed, at(replayed))
        end = moment + PERIOD * 0.99
        stream.admit(EPOCH + end, end, at(end))
        assert stream.state.stamp == pytest.approx(EPOCH + end, abs=1e-6)


def test_repeated_message_is_refused_forever() -> None:
    stream = stream_after(0.0, 0.05)
    for number in range(2, 200):
        with pytest.raises(BadMessage, match="out of step"):
            stream.admit(EPOCH + 0.05, number * PERIOD, at(number * PERIOD))
    assert stream.state.stamp == pytest.approx(EPOCH + 0.05)
    assert stream.state.arrived == 0.05
    assert not stream.fresh(at(10.0))


def test_stream_with_rate_of_one_hertz_admits_each_message() -> None:
    stream = Stream(1.0)
    for second in range(20):
        late = 0.01 * (second % 3)
        elapsed = stream.admit(EPOCH + second, second + late, at(second + late))
        assert elapsed == (pytest.approx(1.0, abs=1e-6) if second else None)


@pytest.mark.parametrize("days", [-20_000.0, -2.0, 2.0, 20_000.0])
def test_stamp_days_away_is_refused(days: float) -> None:
    with pytest.raises(BadMessage, match="absurd stamp"):
        Stream(RATE).admit(EPOCH + days * 86_400.0, 0.0, at(0.0))


def test_delayed_burst_of_messages_is_admitted_completely() -> None:
    stream, interval = stream_after(0.0), pytest.approx(PERIOD, abs=1e-6)
    for number in range(1, 9):
        moment = 0.4 + 0.001 * number
        assert stream.admit(EPOCH + number * PERIOD, moment, at(moment)) == interval
    assert stream.age(at(0.41)) == pytest.approx(0.01, abs=1e-6)


def test_messages_with_growing_delay_are_refused() -> None:
    stream, refused = stream_after(0.0), 0
    for number in range(1, 100):
        sent, moment = number * PERIOD, 2.0 * number * PERIOD
        if sent <= MAX_DELAY:
            stream.admit(EPOCH + sent, moment, at(moment))
            continue
        with pytest.raises(TooLateError, match="later than the quickest"):
            stream.admit(EPOCH + sent, moment, at(moment))
        refused += 1
    assert refused > 80
    assert not stream.fresh(at(9.0))


def test_prompt_message_after_late_ones_is_admitted_at_once() -> None:
    stream = stream_after(0.0)
    for number in range(1, 20):
        moment = 3.0 + number * PERIOD
        with pytest.raises(TooLateError):
            stream.admit(EPOCH + moment - 3.0, moment, at(moment))
    stream.admit(EPOCH + 4.1, 4.1, at(4.1))
    assert stream.fresh(at(4.1))
    assert stream.state.late == pytest.approx(0.0, abs=1e-6)


def test_messages_with_constant_delay_are_admitted_after_settled_time() -> None:
    stream, sent = stream_after(0.0), 0.0
    while sent < SETTLED_TIME - 0.1:
        sent += PERIOD
        with pytest.raises(TooLateError):
            stream.admit(EPOCH + sent, sent + 3.0, at(sent + 3.0))
    sent += 0.2
    assert stream.admit(EPOCH + sent, sent + 3.0, at(sent + 3.0)) is None
    assert stream.fresh(at(sent + 3.0))


@pytest.mark.parametrize("step", [-3600.0, -10.0, 10.0, 3600.0])
@pytest.mark.parametrize("under_way", [0, 1, 2])
def test_clock_step_of_machine_costs_one_interval(step: float, under_way: int) -> None:
    stream, intervals = Stream(20.0), []
    for k in range(10):
        mono, after = 0.05 * k, step * (k >= 4)
        stamp = 100.0 + mono + step * (k >= 4 + under_way)
        intervals.append(stream.admit(stamp, mono + 0.01, Now(mono + 0.01, 100.01 + mono + after)))
        assert stream.state.delay == pytest.approx(0.01, abs=1e-6)
    assert intervals.count(None) == 2, "only the first message, and the first by the new clock, have none"


def test_delay_is_by_new_clock_soon_after_clock_step() -> None:
    stream = Stream(20.0)
    for k in range(60):
        mono = 0.05 * k
        stream.admit(100.0 + mono, mono + 0.01, Now(mono + 0.01, 100.01 + mono + 10.0 * (k > 4)))
    assert stream.state.delay == pytest.approx(10.01)


@given(st.lists(st.tuples(st.floats(-1e7, 1e7), st.floats(0.0, 0.5)), max_size=30))
def test_admitted_interval_is_positive_and_within_wait(messages: list[tuple[float, float]]) -> None:
    stream, mono, last = Stream(RATE), 0.0, 0.0
    for offset, wait in messages:
        mono += wait
        try:
            elapsed = stream.admit(EPOCH + mono + offset, mono, at(mono))
        except BadMessage:
            continue
        wait_since, last = mono - last, mono
        assert elapsed is None or 0.0 < elapsed <= wait_since + stream.longest_delay
        assert 0.0 <= stream.age(at(mono)) <= stream.longest_delay
