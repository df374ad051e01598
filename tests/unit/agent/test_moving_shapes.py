"""Shapes that move while the team drives: robots go with their slots, and never in jerks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.following.orders import Orders
from formation.agent.following.slots import MAX_SLOT_SPEED_SHARE
from formation.agent.following.slots import Slots as Taken
from formation.control.ramp import FIRST_CHANGE_SHARE, MAX_RAMP_PERIODS
from formation.control.unicycle import AT_REST, Command
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.order import Order, Slots
from formation.simulation.edges import Edges, edge_errors
from formation.topics import POSITION
from formation.wire import BadMessage, Now
from tests.support.fleet import Fleet
from tests.support.meddling import reordered
from tests.support.missions import with_robots
from tests.unit.agent.sudden import most_sudden
from tests.unit.agent.wished import Wishes

SIX = load("six_robots")
GAP = 0.15
"""After so long a silence of its agent a watchdog stops the robot [s]."""
WISHES = st.builds(Command, st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))


def farthest(fleet: Fleet) -> float:
    """Longest edge error of the robots as they really are, in the shape as it is by now [m]."""
    slots = np.array(fleet.leader.plan.shape_transition.placed_shape.slots(fleet.mission))
    return float(np.max(edge_errors(Edges(fleet.mission.graph), np.array(fleet.points()), slots)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mission", "shapes"), [("six_robots", ("wedge", "hexagon")), ("patrol", ("line", "wedge"))]
)
def test_edges_stay_within_four_centimetres_during_shape_transition(
    mission: str, shapes: tuple[str, ...]
) -> None:
    fleet = Fleet(load(mission)).after(9.0)
    since = fleet.now
    for shape in shapes:
        assert fleet.order_shape(shape).ok
        worst = fastest = 0.0
        for _ in fleet.every(0.1, 3.0):
            worst = max(worst, farthest(fleet))
            fastest = max(
                fastest, *(abs(v) for a in fleet.agents.values() for v in a._slots.state.velocity.values())
            )
        fleet.run(3.0)
        assert fastest > 0.15
        assert worst < 0.04
        assert farthest(fleet) < 0.005
    assert most_sudden(fleet, since) < 0.18  # a gain of 8 1/s instead of 4; the ramp allows 0.2


def unaware_of_velocities(slots: Taken) -> None:
    follow = slots.follow

    def followed(order: Order, arrived: float, moment: float) -> None:
        follow(order, arrived, moment)
        slots.state.velocity = dict.fromkeys(slots.state.velocity, 0j)

    slots.follow = followed  # type: ignore[method-assign]


def test_without_their_slots_velocity_they_would_lag_behind() -> None:
    fleet = Fleet.under_way(SIX, 9.0)
    for agent in fleet.agents.values():
        unaware_of_velocities(agent._slots)
    fleet.order_shape("wedge")
    assert max(farthest(fleet) for _ in fleet.every(0.1, 3.0)) > 0.05


@pytest.mark.slow
def test_jumping_order_is_limited_to_slot_speed() -> None:
    fleet = Fleet.under_way(SIX, 9.0)
    since, jump = fleet.now, Slots(mix={"wedge": 1.0}, rotation=1.5)
    fleet.meddle = reordered(POSITION.key("robot1"), slots=jump)
    most = MAX_SLOT_SPEED_SHARE * SIX.robot.max_speed
    for _ in range(100):
        before, began = {n: dict(a._slots.state.at) for n, a in fleet.agents.items()}, fleet.now
        fleet.run(0.05)
        for name, agent in fleet.agents.items():
            for other, was in before[name].items():
                assert abs(agent._slots.state.at[other] - was) <= most * (fleet.now - began + 0.06)
    assert most_sudden(fleet, since) <= 0.21
    assert {agent._slots.state.standing for agent in fleet.agents.values()} == {True}


@pytest.mark.parametrize(
    ("slots", "why"),
    [
        (Slots(mix={"star": 1.0}), "unknown shape 'star'; known: hexagon, wedge"),
        (Slots(mix={"hexagon": 0.5, "wedge": 0.4}), "shares that sum to 0.9; must be 1"),
        (Slots(mix={"hexagon": 1.0, "wedge": 1e-5}), "must be 1"),
    ],
)
def test_slots_that_are_none_are_refused(slots: Slots, why: str) -> None:
    orders = Orders(SIX)
    order = Order(term=1, beat=1, mode="run", shape="hexagon", slots=slots)
    with pytest.raises(BadMessage, match=why):
        orders.receive(order, "robot1", 0.0, Now(0.0, 1.7e9))


@given(st.lists(st.tuples(WISHES, st.floats(0.0, 0.5)), max_size=40))
def test_reaching_a_limit_from_rest_takes_the_ramp(wishes: list[tuple[Command, float]]) -> None:
    sent, moment, spec = Wishes(SIX, "robot2"), 10.0, SIX.robots["robot2"]
    sent.put(moment, AT_REST)
    for wish, wait in wishes:
        before, last, moment = sent.newest, moment, moment + wait
        silence = moment - last  # rounded, as the ramp sees it
        sent.put(moment, wish)
        after_a_gap = silence > GAP and before != AT_REST
        share = (
            FIRST_CHANGE_SHARE if after_a_gap else min(silence, MAX_RAMP_PERIODS / spec.rate) / spec.ramp
        ) + 1e-9
        if sent.newest != AT_REST:
            assert abs(sent.newest.speed - before.speed) <= share * spec.max_speed
            assert abs(sent.newest.turn_rate - before.turn_rate) <= share * spec.max_turn_rate


@given(WISHES, WISHES, st.floats(GAP, 2.0))
def test_watchdog_zero_after_gap_causes_no_large_jump(wish: Command, then: Command, gap: float) -> None:
    wishes, moment, spec = Wishes(SIX, "robot2"), 10.0, SIX.robots["robot2"]
    for _ in range(10):
        moment += 0.05
        wishes.put(moment, wish)
    before, most = wishes.newest, FIRST_CHANGE_SHARE + 1e-9
    for wait in (gap + 0.01, 0.05):
        moment += wait
        wishes.put(moment, then)
        if wishes.newest == AT_REST:
            return
        for last in (before, AT_REST):  # or the watchdog was faster
            assert abs(wishes.newest.speed - last.speed) <= most * spec.max_speed
            assert abs(wishes.newest.turn_rate - last.turn_rate) <= most * spec.max_turn_rate
        before = wishes.newest


@pytest.mark.parametrize("rate", [1.0, 5.0, 10.0, 50.0])
def test_rare_commands_change_by_less_than_half_limit(rate: float) -> None:
    wishes = Wishes(with_robots("six_robots", rate=rate), "robot2")
    spec, moment, before = SIX.robots["robot2"], 10.0, AT_REST
    for _ in range(10):
        moment += 2.5 / rate
        wishes.put(moment, Command(spec.max_speed, -spec.max_turn_rate))
        assert abs(wishes.newest.speed - before.speed) <= 0.45 * spec.max_speed + 1e-9
        assert abs(wishes.newest.turn_rate - before.turn_rate) <= 0.45 * spec.max_turn_rate + 1e-9
        before = wishes.newest
    assert before == Command(spec.max_speed, -spec.max_turn_rate)


def settled(mission: Mission) -> float:
    """When the formation error stays under what counts as settled [s]."""
    fleet, since = Fleet(mission), 0.0
    while fleet.now < 9.0:
        fleet.run(0.1)
        since = fleet.now if fleet.error() > mission.settled else since
    assert since < 8.9
    return since


@pytest.mark.slow
@pytest.mark.parametrize("name", ["six_robots", "turtlebot3_pair"])
def test_ramps_cost_under_a_second_of_settling(name: str) -> None:
    at_once, ramped = with_robots(name, ramp=0.0), with_robots(name, ramp=0.25)
    assert settled(ramped) < settled(at_once) + 1.0
