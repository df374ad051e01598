"""What robots use of the leader's velocity and place in its orders, and what happens if these are wrong."""

from __future__ import annotations

from typing import Any

import pytest

from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.order import Motion, PositionAttachment
from tests.support.examples import slow
from tests.support.fleet import Fleet
from tests.support.missions import team
from tests.support.signed import SignedFleet

SIX = load("six_robots")
CORNER = ({"speed": 0.2, "heading_deg": 30.0, "duration": 8.0}, {"speed": 0.2, "heading_deg": 120.0})
TURNING = ({"radius": 1.0, "speed": 0.2, "heading_deg": 0.0},)


def mission(leader_orders: str, route: Any = CORNER, of: Mission = SIX) -> Mission:
    law = {**of.law.model_dump(), "leader_orders": leader_orders}
    return Mission.model_validate({**of.model_dump(), "law": law, "route": route})


def greatest_error(fleet: Fleet, begin: float, seconds: float) -> float:
    """The greatest formation error in a time that begins at `begin` [s]."""
    fleet.run(begin)
    return max(one.error() for one in fleet.every(0.05, seconds))


def ages(fleet: Fleet) -> dict[str, float]:
    """How old each robot takes the newest order to be now [s]."""
    return {name: agent.orders.age(fleet.now) for name, agent in fleet.agents.items()}


def test_ordered_velocity_more_than_halves_the_error_at_a_corner() -> None:
    before = greatest_error(Fleet(mission("none")), 7.9, 1.0)
    assert greatest_error(Fleet(mission("velocity")), 7.9, 1.0) < 0.45 * before


@pytest.mark.parametrize("use", [*slow("velocity"), "place"])
def test_robots_form_with_ordered_velocity_and_place(use: str) -> None:
    fleet = Fleet(mission(use, TURNING)).after(10.0)
    assert fleet.error() < 0.005


def test_velocity_is_used_by_default_only_where_orders_are_signed() -> None:
    unsigned, signed = Fleet(mission("signed", of=TEAM)), SignedFleet(mission("signed", of=TEAM))
    for fleet in (unsigned.after(3.0), signed.after(3.0)):
        orders = {name: agent.orders.leader(fleet.now) for name, agent in fleet.agents.items()}
        assert all((one is not None) is isinstance(fleet, SignedFleet) for one in orders.values())
        assert {one.place for one in orders.values() if one is not None} <= {None}


TEAM = team({"r0": ["leader"], "r1": ["r0"], "r2": ["r1"], "r3": ["r2"]})


def test_relays_add_the_time_for_which_they_kept_an_order() -> None:
    fleet = Fleet(mission("velocity", of=TEAM), delay=(0.01, 0.01)).after(3.0)
    steps = {name: fleet.agents[name].orders.state.newest for name in ("r0", "r3")}
    leader = fleet.candidates["leader"]
    for name, order in steps.items():
        assert order is not None
        true = fleet.now - leader._began - (order.beat - 1) * leader.rate.period
        assert ages(fleet)[name] == pytest.approx(true, abs=0.015)


def test_relay_that_lies_about_the_age_moves_no_robot_far() -> None:
    fleet = SignedFleet(mission("velocity", TURNING, TEAM))

    def older(sender: str, attachment: PositionAttachment) -> PositionAttachment:
        return attachment.model_copy(update={"order_age": 1.0}) if sender == "r0" else attachment

    fleet.tamper = older
    fleet.run(10.0)
    assert fleet.within_limits
    assert max(ages(fleet).values()) > 0.9
    assert 0.005 < fleet.error() < 0.1  # three edges of v/k, 0.2 rad aside


def test_leader_that_gives_a_wrong_velocity_misleads_by_little() -> None:
    fleet = Fleet(mission("velocity", of=TEAM))
    plan = fleet.candidates["leader"].plan
    true = plan.route.motion

    def wrong(time: float, pace: float) -> Motion | None:
        motion = true(time, pace)
        return None if motion is None else motion.model_copy(update={"x": 900.0, "y": 0.0})

    plan.route.motion = wrong  # type: ignore[method-assign]
    fleet.run(8.0)
    assert fleet.within_limits
    assert fleet.error() < 4 * 0.15  # cut to the leader's top speed, which leaves 2 v/k on each edge


def test_other_laws_do_not_use_the_orders() -> None:
    fleets = [Fleet(mission(use, of=TEAM), law="paper").after(4.0) for use in ("none", "velocity")]
    assert fleets[0].commands == fleets[1].commands
