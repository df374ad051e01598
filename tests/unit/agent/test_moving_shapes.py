"""Slots as agents compute them, and teams that follow changing shapes."""

from __future__ import annotations

import cmath
import random
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.agent.following.orders import Orders
from formation.agent.following.slots import MAX_SLOT_SPEED_SHARE, Slots
from formation.control.controller import Gains, Measured
from formation.control.laws import LAWS
from formation.control.pipeline import ControlState, Inputs, constrained
from formation.control.ramp import FIRST_CHANGE_SHARE, MAX_RAMP_PERIODS
from formation.control.unicycle import AT_REST, Command
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.order import Order
from formation.protocol.order import Slots as OrderedSlots
from formation.simulation.edges import Edges, edge_errors
from formation.slots.shape import PlacedShape
from formation.wire import BadMessage, Now
from tests.support.fleet import Fleet
from tests.support.missions import team, with_robots
from tests.unit.agent.sudden import largest_command_change

SIX = load("six_robots")
GAP = 0.15
"""Silence of an agent after which the watchdog stops its robot [s]."""
WANTED = st.builds(Command, st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))


class ConstrainedCommands:
    """The stages after the law, with their state, for a robot with nothing around it."""

    def __init__(self, mission: Mission, robot: str) -> None:
        self._params, self._state = mission.control(robot, LAWS["field"]), ControlState()
        self.newest = AT_REST
        """The newest command."""

    def put(self, moment: float, wanted: Command) -> Command:
        """Return the command at `moment` [s] for the wanted one."""
        inputs = Inputs(moment, 0.0, 1.0 + 0.0j, Measured(0j, 0j, 1), Gains(1.0, 0.0))
        self._state, outcome = constrained(self._state, wanted, inputs, (), self._params)
        self.newest = outcome.command
        return outcome.command


def greatest_edge_error(fleet: Fleet) -> float:
    """Greatest true edge error in the present placed shape [m]."""
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
            worst = max(worst, greatest_edge_error(fleet))
            fastest = max(
                fastest, *(abs(v) for a in fleet.agents.values() for v in a._slots.state.velocity.values())
            )
        fleet.run(3.0)
        assert fastest > 0.15
        assert worst < 0.04
        assert greatest_edge_error(fleet) < 0.005
    assert largest_command_change(fleet, since) < 0.18  # a gain of 8 1/s instead of 4; the ramp allows 0.2


@pytest.mark.parametrize(
    ("slots", "why"),
    [
        (OrderedSlots(mix={"star": 1.0}), "unknown shape 'star'; known: hexagon, wedge"),
        (OrderedSlots(mix={"hexagon": 0.5, "wedge": 0.4}), "shares that sum to 0.9; must be 1"),
        (OrderedSlots(mix={"hexagon": 1.0, "wedge": 1e-5}), "must be 1"),
    ],
)
def test_order_with_invalid_slots_is_refused(slots: OrderedSlots, why: str) -> None:
    orders = Orders(SIX)
    order = Order(term=1, beat=1, mode="run", shape="hexagon", slots=slots)
    with pytest.raises(BadMessage, match=why):
        orders.receive(order, "robot1", 0.0, Now(0.0, 1.7e9))


@given(st.lists(st.tuples(WANTED, st.floats(0.0, 0.5)), max_size=40))
def test_commands_change_no_faster_than_the_ramp(wanted: list[tuple[Command, float]]) -> None:
    sent, moment, spec = ConstrainedCommands(SIX, "robot2"), 10.0, SIX.robots["robot2"]
    sent.put(moment, AT_REST)
    for command, wait in wanted:
        before, last, moment = sent.newest, moment, moment + wait
        silence = moment - last  # rounded, as the ramp sees it
        sent.put(moment, command)
        after_a_gap = silence > GAP and before != AT_REST
        share = (
            FIRST_CHANGE_SHARE if after_a_gap else min(silence, MAX_RAMP_PERIODS / spec.rate) / spec.ramp
        ) + 1e-9
        if sent.newest != AT_REST:
            assert abs(sent.newest.speed - before.speed) <= share * spec.max_speed
            assert abs(sent.newest.turn_rate - before.turn_rate) <= share * spec.max_turn_rate


@given(WANTED, WANTED, st.floats(GAP, 2.0))
def test_first_commands_after_gap_change_by_limited_share(
    command: Command, then: Command, gap: float
) -> None:
    constrained, moment, spec = ConstrainedCommands(SIX, "robot2"), 10.0, SIX.robots["robot2"]
    for _ in range(10):
        moment += 0.05
        constrained.put(moment, command)
    before, most = constrained.newest, FIRST_CHANGE_SHARE + 1e-9
    for wait in (gap + 0.01, 0.05):
        moment += wait
        constrained.put(moment, then)
        if constrained.newest == AT_REST:
            return
        for last in (before, AT_REST):  # AT_REST if the watchdog was faster
            assert abs(constrained.newest.speed - last.speed) <= most * spec.max_speed
            assert abs(constrained.newest.turn_rate - last.turn_rate) <= most * spec.max_turn_rate
        before = constrained.newest


@pytest.mark.parametrize("rate", [1.0, 5.0, 10.0, 50.0])
def test_rare_commands_change_by_less_than_half_limit(rate: float) -> None:
    constrained = ConstrainedCommands(with_robots("six_robots", rate=rate), "robot2")
    spec, moment, before = SIX.robots["robot2"], 10.0, AT_REST
    for _ in range(10):
        moment += 2.5 / rate
        constrained.put(moment, Command(spec.max_speed, -spec.max_turn_rate))
        assert abs(constrained.newest.speed - before.speed) <= 0.45 * spec.max_speed + 1e-9
        assert abs(constrained.newest.turn_rate - before.turn_rate) <= 0.45 * spec.max_turn_rate + 1e-9
        before = constrained.newest
    assert before == Command(spec.max_speed, -spec.max_turn_rate)


def settling_time(mission: Mission) -> float:
    """The time from which on the formation error stays below `mission.settled` [s]."""
    fleet, since = Fleet(mission), 0.0
    while fleet.now < 9.0:
        fleet.run(0.1)
        since = fleet.now if fleet.error() > mission.settled else since
    assert since < 8.9
    return since


@pytest.mark.slow
@pytest.mark.parametrize("name", ["six_robots", "turtlebot3_pair"])
def test_ramp_delays_settling_by_under_a_second(name: str) -> None:
    at_once, ramped = with_robots(name, ramp=0.0), with_robots(name, ramp=0.25)
    assert settling_time(ramped) < settling_time(at_once) + 1.0


def driving(seconds: float = 10.0, *, loss: float = 0.0) -> Fleet:
    return Fleet.under_way(SIX, seconds, loss=loss, seed=3)


@pytest.mark.slow
def test_team_changes_shape_and_back_within_limits() -> None:
    fleet = driving(loss=0.3)
    for shape in ("wedge", "hexagon"):
        assert fleet.order_shape(shape).ok
        fleet.run(0.5)
        assert fleet.error() > SIX.settled
        fleet.run(9.5)
        assert fleet.error() < SIX.settled
    assert fleet.within_limits


def test_all_robots_take_new_shape_without_stopping() -> None:
    fleet = driving()
    before = {name: len(fleet.commands[name]) for name in SIX.followers}
    fleet.order_shape("wedge")
    fleet.run(0.5)
    assert {agent.orders.newest.shape for agent in fleet.agents.values() if agent.orders.newest} == {"wedge"}
    for name in SIX.followers:
        assert all(command[1:] != AT_REST for command in fleet.commands[name][before[name] :])


@pytest.mark.slow
@pytest.mark.parametrize("rest", ["hold", "stop"])
def test_resting_robots_take_new_shape_once_they_run(rest: str) -> None:
    fleet = driving()
    requested = SIX.names if rest == "stop" else ("robot1",)
    for name in requested:
        assert fleet.ask(name, rest).ok
    fleet.run(1.0)
    before, where = {name: len(fleet.commands[name]) for name in SIX.followers}, fleet.points()
    assert fleet.order_shape("wedge").ok
    fleet.run(3.0)
    for name in SIX.followers:
        assert {command[1:] for command in fleet.commands[name][before[name] :]} == {AT_REST}
    assert fleet.points() == pytest.approx(where, abs=1e-3)
    since = fleet.now
    for name in requested:
        assert fleet.set_going(name).ok
    fleet.run(10.0)
    assert largest_command_change(fleet, since, rests=True) < 0.5
    assert fleet.error() < SIX.settled
    assert fleet.within_limits


orders = st.one_of(
    st.sampled_from(["stop", "hold", "run", "release"]).map(lambda do: (do, None)),
    st.sampled_from(["hexagon", "wedge"]).map(lambda shape: ("shape", shape)),
)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(orders, st.floats(0.01, 1.0)), max_size=12))
def test_quick_random_requests_never_exceed_limits(
    given_orders: list[tuple[tuple[str, str | None], float]],
) -> None:
    fleet = driving(3.0, loss=0.1)
    for (do, shape), wait in given_orders:
        if shape is not None:
            fleet.order_shape(shape)
        for name in {"stop": SIX.names, "release": SIX.names, "shape": ()}.get(do, ("robot1",)):
            fleet.ask(name, do)
        fleet.run(wait)
        if fleet.leader.mode == "stop" and wait > 0.2:
            assert {fleet.last_command(name) for name in SIX.followers} == {AT_REST}
    assert fleet.within_limits


PERIOD = 1.0 / SIX.robots[SIX.leader].rate
STEP = 0.02


def ordered(beat: int, *, term: int = 1, **slots: object) -> Order:
    result = OrderedSlots.model_validate(slots) if slots else None
    return Order(term=term, beat=beat, mode="run", shape="hexagon", slots=result)


def turned(beat: int, rate: float) -> Order:
    return ordered(beat, mix={"hexagon": 1.0}, rotation=rate * beat * PERIOD)


@given(st.lists(st.tuples(st.integers(1, 5), st.floats(0.001, 0.5)), min_size=1, max_size=50))
def test_constant_order_gives_exact_slots_at_rest(received: list[tuple[int, float]]) -> None:
    slots, beat, moment = Slots(SIX, "robot4"), 7, 100.0
    for beats, wait in received:
        beat, moment = beat + beats, moment + wait
        slots.follow(ordered(beat), moment, moment)
        assert slots.state.at == {name: SIX.slot(name, "hexagon") for name in ("robot4", "robot2", "robot3")}
        assert set(slots.state.velocity.values()) == {0j}


@given(st.floats(-3.0, 3.0), st.floats(0.3, 3.0), st.floats(0.0, 1.0))
def test_newly_started_agent_adopts_current_slots(rotation: float, scale: float, share: float) -> None:
    order = ordered(9, mix={"hexagon": share, "wedge": 1.0 - share}, rotation=rotation, scale=scale)
    slots = Slots(SIX, "robot4")
    slots.follow(order, 5.0, 5.0)
    placed_shape = PlacedShape.of(order)
    assert slots.state.at == {name: placed_shape.slot(SIX, name) for name in slots.state.at}
    assert set(slots.state.velocity.values()) == {0j}


JUMPS = st.tuples(
    st.floats(-3.0, 3.0), st.floats(0.1, 5.0), st.integers(1, 30), st.floats(0.0, 0.3), st.integers(1, 3)
)


@given(st.lists(JUMPS, max_size=20))
def test_slot_speed_never_exceeds_its_share(jumps: list[tuple[float, float, int, float, int]]) -> None:
    slots, beat, moment = Slots(SIX, "robot5"), 1, 0.0
    slots.follow(ordered(beat), moment, moment)
    most = MAX_SLOT_SPEED_SHARE * SIX.robot.max_speed
    for rotation, scale, beats, wait, term in jumps:
        beat += beats
        order = ordered(beat, term=term, mix={"wedge": 1.0}, rotation=rotation, scale=scale)
        arrived = moment + wait
        for k in range(3):
            before, moment_before, moment = dict(slots.state.at), moment, arrived + k * STEP
            slots.follow(order, arrived, moment)
            for name, was in before.items():
                assert abs(slots.state.at[name] - was) <= most * (moment - moment_before) + 1e-9
                assert abs(slots.state.velocity[name]) <= most + 1e-9


@given(st.floats(-3.0, 3.0), st.floats(0.3, 3.0))
def test_slots_reach_jumped_order_exactly_and_stop(rotation: float, scale: float) -> None:
    slots = Slots(SIX, "robot4")
    slots.follow(ordered(1), 0.0, 0.0)
    for k in range(1, 200):
        order = ordered(1 + k, mix={"wedge": 1.0}, rotation=rotation, scale=scale)
        slots.follow(order, k * PERIOD, k * PERIOD)
    placed_shape = PlacedShape.of(order)
    assert slots.state.at == {name: placed_shape.slot(SIX, name) for name in slots.state.at}
    assert set(slots.state.velocity.values()) == {0j}


def followed(rate: float, *, jitter: float, loss: float = 0.0, seed: int = 1) -> list[tuple[float, float]]:
    """Relative velocity errors and speeds of a slot while its shape turns at `rate` [rad/s]."""
    draw, slots = random.Random(seed), Slots(SIX, "robot4")
    found: list[tuple[float, float]] = []
    order, arrived, before = turned(0, rate), 0.0, dict.fromkeys(("robot4", "robot2", "robot3"), 0j)
    coming = [
        (beat * PERIOD + 0.1 + draw.uniform(0.0, jitter), beat)
        for beat in range(240)
        if draw.random() >= loss or beat == 0
    ]
    moment = 0.1
    while moment < 10.0:
        for came, beat in coming:
            if came <= moment and beat > order.beat:
                order, arrived = turned(beat, rate), came
        slots.follow(order, arrived, moment)
        if moment > 2.0:
            speed = abs(slots.state.at["robot4"] - before["robot4"]) / STEP
            true = abs(rate * SIX.slot("robot4", "hexagon"))
            found.append((abs(abs(slots.state.velocity["robot4"]) / true - 1.0), speed / true))
        before, moment = dict(slots.state.at), moment + STEP
    return found


@pytest.mark.parametrize("rate", [0.05, 0.3])
@pytest.mark.parametrize(("jitter", "loss"), [(0.0, 0.0), (0.08, 0.0), (0.08, 0.3)])
def test_slots_turn_evenly_despite_uneven_orders(rate: float, jitter: float, loss: float) -> None:
    found = followed(rate, jitter=jitter, loss=loss)
    assert max(off for off, _ in found) < 0.02
    assert max(abs(pace - 1.0) for _, pace in found) < (0.25 if jitter else 0.05)


def test_agents_agree_on_slots_during_fast_transition() -> None:
    mission = team({"one": ["leader"], "two": ["one"], "three": ["one", "two"]})
    agents = [Slots(mission, name) for name in mission.followers]
    for k in range(100):
        order = Order(term=1, beat=k, mode="run", shape="wide" if k > 10 else "row")
        for slots in agents:
            slots.follow(order, k * PERIOD, k * PERIOD)
        for first, second in pairwise(agents):
            assert all(
                first.state.at[name] == second.state.at[name]
                for name in first.state.at.keys() & second.state.at.keys()
            )


def test_shape_turns_on_smoothly_under_new_leader() -> None:
    slots, rate = Slots(SIX, "robot4"), 0.2
    for beat in range(100):
        slots.follow(turned(beat, rate), beat * PERIOD, beat * PERIOD)
    before = dict(slots.state.at)
    for k in range(1, 40):
        result = turned(99 + k, rate).slots
        order = ordered(k, term=2).model_copy(update={"slots": result})
        moment = (99 + k) * PERIOD
        slots.follow(order, moment, moment)
        for name, was in before.items():
            assert abs(slots.state.at[name] - was) <= 1.5 * rate * abs(was) * PERIOD
        before = dict(slots.state.at)
    assert slots.state.at["robot4"] == pytest.approx(
        cmath.rect(1.0, rate * (99 + 39) * PERIOD) * SIX.slot("robot4", "hexagon"), abs=0.02
    )
