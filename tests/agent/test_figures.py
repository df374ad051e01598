"""Figures that move while the team drives: robots go with their slots, and never in jerks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.commander import AT_REST, HALF, LONGEST, Commander
from agent.orders import Orders
from agent.slots import SHARE
from agent.slots import Slots as Taken
from formation.edges import Edges, edge_errors
from formation.mission import Mission
from formation.mission_file import load
from formation.order import Order, Slots, Told, decode, encode
from formation.topics import POSITION
from formation.unicycle import Command
from formation.wire import BadMessage, Now, Sample
from tests.agent.fleet import Fleet
from tests.agent.missions import with_robots
from tests.agent.sudden import most_sudden

SIX = load("six_robots")
GAP = 0.15
"""After so long a silence of its agent a guard stops the robot [s]."""


def farthest(fleet: Fleet) -> float:
    """Longest edge error of the robots as they really are, in the figure as it is by now [m]."""
    slots = np.array(fleet.leader.figure.slots(fleet.mission))
    return float(np.max(edge_errors(Edges(fleet.mission.graph), np.array(fleet.points()), slots)))


@pytest.mark.parametrize(
    ("mission", "shapes"), [("six_robots", ("wedge", "hexagon")), ("patrol", ("line", "wedge"))]
)
def test_on_the_way_from_shape_to_shape_every_edge_stays_within_four_centimetres(
    mission: str, shapes: tuple[str, ...]
) -> None:
    fleet = Fleet(load(mission))
    fleet.run(9.0)
    since = fleet.now
    for shape in shapes:
        assert fleet.take(shape).ok
        worst = fastest = 0.0
        for _ in range(30):
            fleet.run(0.1)
            worst = max(worst, farthest(fleet))
            fastest = max(
                fastest, *(abs(v) for a in fleet.agents.values() for v in a._slots.velocity.values())
            )
        fleet.run(3.0)
        assert fastest > 0.15
        assert worst < 0.04
        assert farthest(fleet) < 0.005
    assert most_sudden(fleet, since) < 0.15


def unaware_of_velocities(slots: Taken) -> None:
    follow = slots.follow

    def followed(order: Order, arrived: float, moment: float) -> None:
        follow(order, arrived, moment)
        slots.velocity = dict.fromkeys(slots.velocity, 0j)

    slots.follow = followed  # type: ignore[method-assign]


def test_without_their_slots_velocity_they_would_lag_behind() -> None:
    fleet = Fleet(SIX)
    fleet.run(9.0)
    for agent in fleet.agents.values():
        unaware_of_velocities(agent._slots)
    fleet.take("wedge")
    worst = 0.0
    for _ in range(30):
        fleet.run(0.1)
        worst = max(worst, farthest(fleet))
    assert worst > 0.05


def test_an_order_that_jumps_moves_nobody_faster_than_its_slot_may_go() -> None:
    fleet = Fleet(SIX)
    fleet.run(9.0)
    since, jump = fleet.now, Slots(mix={"wedge": 1.0}, rotation=1.5)

    def meddled(sample: Sample) -> tuple[Sample, ...]:
        if sample.key != POSITION.key("robot1") or sample.attachment is None:
            return (sample,)
        told = decode(Told, sample.attachment)
        if told.order is None:
            return (sample,)
        forged = told.model_copy(update={"order": told.order.model_copy(update={"slots": jump})})
        return (sample._replace(attachment=encode(forged)),)

    fleet.meddle = meddled
    most = SHARE * SIX.robot.max_speed
    for _ in range(100):
        before, began = {n: dict(a._slots.at) for n, a in fleet.agents.items()}, fleet.now
        fleet.run(0.05)
        for name, agent in fleet.agents.items():
            for other, was in before[name].items():
                assert abs(agent._slots.at[other] - was) <= most * (fleet.now - began + 0.06)
    assert most_sudden(fleet, since) <= 0.21
    assert {agent._slots._standing for agent in fleet.agents.values()} == {True}


@pytest.mark.parametrize(
    ("slots", "why"),
    [
        (Slots(mix={"star": 1.0}), "unknown shape 'star'; known: hexagon, wedge"),
        (Slots(mix={"hexagon": 0.5, "wedge": 0.4}), "shares sum to 0.9; must be 1"),
        (Slots(mix={"hexagon": 1.0, "wedge": 1e-5}), "must be 1"),
    ],
)
def test_slots_that_are_none_are_refused(slots: Slots, why: str) -> None:
    orders = Orders(SIX)
    order = Order(term=1, beat=1, mode="run", shape="hexagon", slots=slots)
    with pytest.raises(BadMessage, match=why):
        orders.hear(order, "robot1", 0.0, Now(0.0, 1.7e9))


@given(st.lists(st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(0.0, 0.5)), max_size=40))
def test_from_rest_to_a_limit_takes_at_least_the_ramp_however_suddenly_it_is_wanted(
    wishes: list[tuple[float, float, float]],
) -> None:
    commander, moment, spec = Commander(SIX, "robot2"), 10.0, SIX.robots["robot2"]
    commander.say(Now(moment, 1.7e9), AT_REST)
    for speed, turn_rate, wait in wishes:
        before, last, moment = commander.newest, moment, moment + wait
        silence = moment - last  # rounded, as the commander sees it
        commander.say(Now(moment, 1.7e9), Command(speed, turn_rate))
        after_a_gap = silence > GAP and before != AT_REST
        share = (HALF if after_a_gap else min(silence, LONGEST / spec.rate) / spec.ramp) + 1e-9
        if commander.newest != AT_REST:
            assert abs(commander.newest.speed - before.speed) <= share * spec.max_speed
            assert abs(commander.newest.turn_rate - before.turn_rate) <= share * spec.max_turn_rate


@given(
    st.floats(-1.5, 1.5),
    st.floats(-1.5, 1.5),
    st.floats(-1.5, 1.5),
    st.floats(-1.5, 1.5),
    st.floats(GAP, 2.0),
)
def test_after_a_gap_no_zero_of_the_guard_makes_a_jump_of_more_than_half_a_limit_wherever_it_comes(
    speed: float, turn_rate: float, then: float, turning: float, gap: float
) -> None:
    commander, moment, spec = Commander(SIX, "robot2"), 10.0, SIX.robots["robot2"]
    for _ in range(10):
        moment += 0.05
        commander.say(Now(moment, 1.7e9), Command(speed, turn_rate))
    before = commander.newest
    for wait in (gap + 0.01, 0.05):
        moment += wait
        commander.say(Now(moment, 1.7e9), Command(then, turning))
        if commander.newest == AT_REST:
            return
        for last in (before, AT_REST):  # or the guard was faster
            assert abs(commander.newest.speed - last.speed) <= (HALF + 1e-9) * spec.max_speed
            assert abs(commander.newest.turn_rate - last.turn_rate) <= (HALF + 1e-9) * spec.max_turn_rate
        before = commander.newest


@pytest.mark.parametrize("rate", [1.0, 5.0, 10.0, 50.0])
def test_no_command_is_half_a_limit_from_the_one_before_however_seldom_they_come(rate: float) -> None:
    commander = Commander(with_robots("six_robots", rate=rate), "robot2")
    spec, moment, before = SIX.robots["robot2"], 10.0, AT_REST
    for _ in range(10):
        moment += 2.5 / rate
        commander.say(Now(moment, 1.7e9), Command(spec.max_speed, -spec.max_turn_rate))
        assert abs(commander.newest.speed - before.speed) <= 0.45 * spec.max_speed + 1e-9
        assert abs(commander.newest.turn_rate - before.turn_rate) <= 0.45 * spec.max_turn_rate + 1e-9
        before = commander.newest
    assert before == Command(spec.max_speed, -spec.max_turn_rate)


def settled(mission: Mission) -> float:
    """When the formation error stays under what counts as settled [s]."""
    fleet, since = Fleet(mission), 0.0
    while fleet.now < 9.0:
        fleet.run(0.1)
        since = fleet.now if fleet.error() > mission.settled else since
    assert since < 8.9
    return since


@pytest.mark.parametrize("name", ["six_robots", "turtlebot3_pair"])
def test_ramps_cost_under_a_second_of_settling(name: str) -> None:
    at_once, ramped = with_robots(name, ramp=0.0), with_robots(name, ramp=0.25)
    assert settled(ramped) < settled(at_once) + 1.0
