from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.mission.file import load, parse, read
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.orders import Orders
from formation.monitor.metrics.words import as_json
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order, Slots, Tuned
from formation.slots.shape import PlacedShape
from tests.support.examples import examples
from tests.support.monitored import EPOCH, Fleet, driven, now, received

SIX = load("six_robots")
BEGINS, LASTS = 11.0, 4.0
"""When the shape begins to move, and for how long [s]."""
shares = st.floats(0.0, 1.0)
angles = st.floats(-3.0, 3.0)
scales = st.floats(0.5, 2.0)


def moving(time: float) -> Mapping[str, Any]:
    """Order at `time`: smoothly from the hexagon to a wedge rotated by 90° and scaled by 1.5."""
    if time < BEGINS:
        return {"shape": "hexagon"}
    wanted = {"shape": "wedge", "rotation": math.pi / 2, "scale": 1.5}
    part = min((time - BEGINS) / LASTS, 1.0)
    part = part * part * (3.0 - 2.0 * part)
    if part == 1.0:
        return wanted
    mix = {"hexagon": 1.0 - part, "wedge": part}
    return {**wanted, "slots": Slots(mix=mix, rotation=part * math.pi / 2, scale=1.0 + 0.5 * part)}


def test_robots_in_moving_slots_have_no_error() -> None:
    fleet = Fleet(wants=moving)
    metrics, worst = Metrics(fleet.mission), 0.0
    for tenth in range(100, 170):
        metrics = driven(fleet, (tenth + 1) / 10, metrics, tenth / 10 + 1e-6)
        error = metrics.snapshot(now((tenth + 1) / 10)).formation_error
        worst = max(worst, error or 0.0)
    assert worst < 0.005
    assert metrics.snapshot(now(17.0)).shape == "wedge"


def test_error_in_old_shape_equals_slot_displacement() -> None:
    fleet = Fleet(wants=moving)
    fleet.away = lambda robot, time: SIX.slot(robot) - PlacedShape.of(fleet.order(time)).slot(SIX, robot)
    metrics = driven(fleet, 13.0)
    seen, slots = metrics.snapshot(now(13.0)), metrics.orders.slots(metrics.placed(now(13.0))[0])
    for (one, other), error in seen.edges.items():
        moved = (slots[other] - slots[one]) - (SIX.slot(other) - SIX.slot(one))
        assert error == pytest.approx(abs(moved), abs=1e-9)
    assert seen.placed_shape is not None
    assert dict(seen.placed_shape.mix).keys() == {"hexagon", "wedge"}


@examples(50)
@given(share=shares, rotation=angles, scale=scales, part=shares)
def test_slots_are_interpolated_linearly_between_orders(
    share: float, rotation: float, scale: float, part: float
) -> None:
    orders = Orders(SIX, 10)
    slots = Slots(mix={"hexagon": share, "wedge": 1.0 - share}, rotation=rotation, scale=scale)
    first = Order(term=1, beat=1, mode="run", shape="hexagon")
    orders.process_order(first, 5.0, 5.0, 5.0)
    orders.process_order(Order(term=1, beat=2, mode="run", shape="wedge", slots=slots), 6.0, 6.0, 6.0)
    before, between, after = (orders.slots(at) for at in (4.0, 5.0 + part, 7.0))
    for name in SIX.names:
        assert between[name] == pytest.approx(before[name] + part * (after[name] - before[name]), abs=1e-9)
        assert after[name] == pytest.approx(PlacedShape.of(orders.newest or first).slot(SIX, name), abs=1e-9)


def test_slots_of_unknown_shape_are_rejected() -> None:
    fleet = Fleet(wants=lambda _: {"slots": Slots(mix={"hexagon": 0.5, "star": 0.5})})
    result = PositionAttachment(publisher_id="leader", count=1, order=fleet.order(10.0))
    position = Fleet().position("robot1", 10.0)._replace(attachment=json_message.encode(result))
    metrics = received(fleet, position)
    assert metrics.rejections.by_reason == {"robot1/position: unknown shape": 1}
    assert metrics.orders.newest is None


def test_new_shape_restarts_settling_time() -> None:
    middle = BEGINS + 0.5 * LASTS
    under_way, there = (driven(Fleet(wants=moving), at).snapshot(now(at)) for at in (middle, 20.0))
    assert under_way.formation_error == pytest.approx(0.0, abs=0.005)
    assert (under_way.formed, under_way.settled_at, under_way.converged) == (False, None, False)
    assert (there.formed, there.converged) == (True, True)
    assert there.ordered_at == pytest.approx(BEGINS - 10.0, abs=0.15)
    assert there.settling_time == pytest.approx(LASTS, abs=0.2)


@pytest.mark.parametrize(
    "change",
    [{"shape": "wedge"}, {"rotation": 1.0}, {"scale": 2.0}, {"route": "b7"}],
    ids=lambda change: next(iter(change)),
)
def test_settling_time_restarts_with_each_order_change(change: dict[str, Any]) -> None:
    fleet = Fleet(wants=lambda time: change if time > 15.0 else {})
    snapshot = driven(fleet, 20.0).snapshot(now(20.0))
    assert snapshot.ordered_at == pytest.approx(5.0, abs=0.15)
    assert snapshot.settling_time == pytest.approx(0.1, abs=0.15)


def test_hold_and_run_do_not_restart_settling_time() -> None:
    fleet = Fleet(wants=lambda time: {"mode": "hold"} if 12.0 < time < 14.0 else {})
    snapshot = driven(fleet, 20.0).snapshot(now(20.0))
    assert (snapshot.ordered_at, snapshot.settled_at) == (0.0, 0.0)


def test_turning_shape_counts_as_formed() -> None:
    text, name = read("six_robots")
    mission = parse(text.replace('leader = "robot1"', 'leader = "robot1"\nturning = true'), name)

    def turning(time: float) -> Mapping[str, Any]:
        rotation = 0.1 * time - (0.05 if time < 15.0 else 1.0)
        place = {"x": 0.0, "y": 0.0, "heading": 0.1 * time}
        return {"slots": Slots(mix={"hexagon": 1.0}, rotation=rotation), "place": place}

    snapshot = driven(Fleet(mission, wants=turning), 18.0).snapshot(now(18.0))
    assert snapshot.formed
    assert snapshot.formation_error == pytest.approx(0.0, abs=1e-3)


def test_monitor_clock_change_during_shape_transition_causes_no_error() -> None:
    fleet = Fleet(wants=moving)
    metrics = driven(fleet, 12.0)
    for sample in fleet.positions(12.0, 14.0):
        metrics.process_sample(sample, sample.arrived + EPOCH + 3600.0)
    snapshot = metrics.snapshot(now(14.0)._replace(wall=14.0 + EPOCH + 3600.0))
    assert snapshot.formation_error == pytest.approx(0.0, abs=0.005)


def test_snapshot_contains_gains_without_restarting_settling_time() -> None:
    tuned = Tuned(k_p=3.0, k_i=0.5)
    metrics = driven(Fleet(wants=lambda time: {"tuned": tuned} if time > 14.0 else {}), 18.0)
    seen = metrics.snapshot(now(18.0))
    assert seen.tuned == tuned
    assert seen.ordered_at == 0.0
    assert as_json(seen)["gains"] == {"k_p": 3.0, "k_i": 0.5}
