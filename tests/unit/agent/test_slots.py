"""Where an agent takes the slots to be, from orders that come late, unevenly, or not at all."""

from __future__ import annotations

import cmath
import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.following.slots import MAX_SLOT_SPEED_SHARE, Slots
from formation.mission.file import load
from formation.protocol.order import Order
from formation.protocol.order import Slots as Said
from formation.slots.shape import PlacedShape
from tests.support.missions import team

SIX = load("six_robots")
PERIOD = 1.0 / SIX.robots[SIX.leader].rate
STEP = 0.02


def ordered(beat: int, *, term: int = 1, **slots: object) -> Order:
    result = Said.model_validate(slots) if slots else None
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
def test_jumped_order_is_reached_exactly_and_then_rests(rotation: float, scale: float) -> None:
    slots = Slots(SIX, "robot4")
    slots.follow(ordered(1), 0.0, 0.0)
    for k in range(1, 200):
        order = ordered(1 + k, mix={"wedge": 1.0}, rotation=rotation, scale=scale)
        slots.follow(order, k * PERIOD, k * PERIOD)
    placed_shape = PlacedShape.of(order)
    assert slots.state.at == {name: placed_shape.slot(SIX, name) for name in slots.state.at}
    assert set(slots.state.velocity.values()) == {0j}


def followed(rate: float, *, jitter: float, loss: float = 0.0, seed: int = 1) -> list[tuple[float, float]]:
    """Relative errors of the velocity, and relative paces, while a shape turns at `rate` [rad/s]."""
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
def test_a_turning_shape_turns_evenly_despite_uneven_orders(rate: float, jitter: float, loss: float) -> None:
    found = followed(rate, jitter=jitter, loss=loss)
    assert max(off for off, _ in found) < 0.02
    assert max(abs(pace - 1.0) for _, pace in found) < (0.25 if jitter else 0.05)


def test_observers_agree_on_slot_at_full_speed() -> None:
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


def test_a_new_leader_moves_the_shape_on_from_where_it_was() -> None:
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
