"""The leader's order as neighbours relay it: when it counts, and what robots use of it."""

from __future__ import annotations

from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from typing import Any

import pytest

from formation.agent.following.orders import Orders
from formation.agent.pose.stream import MAX_STAMP_OFFSET, TooLateError
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Mode, Motion, Order
from formation.wire import BadMessage
from tests.support.examples import slow
from tests.support.fleet import EPOCH, Fleet, at
from tests.support.missions import team
from tests.support.signed import SignedFleet

TERM = int(EPOCH * 1e9)
SIX = load("six_robots")
HIGHEST = 2**63 - 1
PERIOD = 0.05


@dataclass
class Receiver:
    """Gives orders to an agent's `Orders`, and counts the time."""

    orders: Orders = field(default_factory=lambda: Orders(SIX))
    mono: float = 0.0

    def receive(
        self, beat: int, *, term: int = TERM, of: str = "robot1", mode: Mode = "run", after: float = PERIOD,
        driven: bool = False,
    ) -> None:  # fmt: skip
        self.mono += after
        received = Order(term=term, beat=beat, mode=mode, shape="hexagon", driven=driven)
        self.orders.receive(received, of, self.mono, at(self.mono))

    @property
    def newest(self) -> tuple[int, int]:
        assert self.orders.newest is not None
        return self.orders.newest.term, self.orders.newest.beat


@pytest.fixture
def after_three_beats() -> Receiver:
    """A receiver after beats 1 to 3 of a living leader."""
    receiver = Receiver()
    for beat in (1, 2, 3):
        receiver.receive(beat)
    assert receiver.newest == (TERM, 3)
    return receiver


def test_order_counts_once_its_beat_has_risen() -> None:
    receiver = Receiver()
    receiver.receive(7)
    assert receiver.orders.newest is None
    receiver.receive(8)
    assert receiver.newest == (TERM, 8)
    assert receiver.orders.state.rose == receiver.mono


@pytest.mark.parametrize(
    ("late", "driven", "counts"), [(0.25, True, True), (0.35, True, False), (0.35, False, True)]
)
def test_driven_order_later_than_drive_timeout_is_relayed_and_moves_nothing(
    after_three_beats: Receiver, late: float, driven: bool, counts: bool
) -> None:
    receiver = after_three_beats
    with nullcontext() if counts else pytest.raises(TooLateError, match=r"limit 0\.3 s"):
        receiver.receive(4, after=PERIOD + late, driven=driven)
    assert receiver.newest == (TERM, 4)
    assert receiver.orders.state.lived == receiver.mono
    silence = 0.0 if counts else pytest.approx(late, abs=1e-3)
    assert receiver.mono - receiver.orders.state.rose == silence


def test_beat_must_rise_at_the_same_neighbour(after_three_beats: Receiver) -> None:
    receiver = Receiver()
    for _ in range(100):  # relays of the last order of a dead leader
        receiver.receive(7, of="robot3")
        receiver.receive(8, of="robot2")
    assert receiver.orders.newest is None
    rose = after_three_beats.orders.state.rose
    after_three_beats.receive(3, of="robot2")
    assert after_three_beats.orders.state.rose == rose


def test_relays_ahead_of_received_leader_are_refused(after_three_beats: Receiver) -> None:
    """robot1 leads. Once it has been silent for three periods, relays count again."""
    for beat in (4, 5, 1000, HIGHEST):
        with pytest.raises(BadMessage, match=f"ahead of the leader.s own, received here: .* beat {beat};"):
            after_three_beats.receive(beat, of="robot2", after=0.0)
    with pytest.raises(BadMessage, match="ahead of the leader"):
        after_three_beats.receive(1, term=TERM + 64, of="robot2", after=0.0)
    assert after_three_beats.newest == (TERM, 3)
    for beat in (4, 5, 6, 7, 8):
        with suppress(BadMessage):
            after_three_beats.receive(beat, of="robot2")
    assert after_three_beats.newest == (TERM, 8)


def test_new_leader_is_followed_from_its_second_beat(after_three_beats: Receiver) -> None:
    after_three_beats.receive(1, term=TERM + 5)
    assert after_three_beats.newest == (TERM, 3)
    after_three_beats.receive(2, term=TERM + 5)
    assert after_three_beats.newest == (TERM + 5, 2)


@pytest.mark.parametrize(("term", "beat"), [(TERM, HIGHEST), (TERM + 10**12, 1), (TERM + 10**12, HIGHEST)])
def test_single_forged_order_changes_nothing_and_costs_two_beats(
    after_three_beats: Receiver, term: int, beat: int
) -> None:
    after_three_beats.receive(beat, term=term)
    assert after_three_beats.newest == (TERM, 3)
    after_three_beats.receive(5)
    after_three_beats.receive(6)
    assert after_three_beats.newest == (TERM, 6)


def test_leader_is_obeyed_immediately_after_long_outage(after_three_beats: Receiver) -> None:
    after_three_beats.receive(3 + 20 * 600, after=600.0, mode="stop")
    assert after_three_beats.newest == (TERM, 3 + 20 * 600)
    assert after_three_beats.orders.newest is not None
    assert after_three_beats.orders.newest.mode == "stop"


@pytest.mark.parametrize(
    ("term", "why"),
    [(TERM + int((MAX_STAMP_OFFSET + 60.0) * 1e9), "absurd term"), (TERM - 1, "earlier term")],
    ids=["days ahead", "earlier"],
)
def test_order_of_impossible_or_earlier_term_is_dropped(
    after_three_beats: Receiver, term: int, why: str
) -> None:
    for beat in (1, 2, 1000, 1001):
        with pytest.raises(BadMessage, match=why):
            after_three_beats.receive(beat, term=term)
    assert after_three_beats.newest == (TERM, 3)


CORNER = ({"speed": 0.2, "heading_deg": 30.0, "duration": 8.0}, {"speed": 0.2, "heading_deg": 120.0})
TURNING = ({"radius": 1.0, "speed": 0.2, "heading_deg": 0.0},)


def mission(leader_orders: str, route: Any = CORNER, of: Mission = SIX) -> Mission:
    law = {**of.law.model_dump(), "leader_orders": leader_orders}
    return Mission.model_validate({**of.model_dump(), "law": law, "route": route})


def greatest_error(fleet: Fleet, begin: float, seconds: float) -> float:
    """The greatest formation error in the `seconds` after `begin` [s]."""
    fleet.run(begin)
    return max(one.error() for one in fleet.every(0.05, seconds))


def ages(fleet: Fleet) -> dict[str, float]:
    """The age of the newest order by each robot's estimate [s]."""
    return {name: agent.orders.age(fleet.now) for name, agent in fleet.agents.items()}


@pytest.mark.slow
def test_ordered_velocity_more_than_halves_error_at_corner() -> None:
    before = greatest_error(Fleet(mission("none")), 7.9, 1.0)
    assert greatest_error(Fleet(mission("velocity")), 7.9, 1.0) < 0.45 * before


@pytest.mark.parametrize("use", [*slow("velocity"), "place"])
def test_robots_form_with_ordered_velocity_and_place(use: str) -> None:
    fleet = Fleet(mission(use, TURNING)).after(10.0)
    assert fleet.error() < 0.005


def test_velocity_of_orders_is_used_only_if_signed() -> None:
    unsigned, signed = Fleet(mission("signed", of=TEAM)), SignedFleet(mission("signed", of=TEAM))
    for fleet in (unsigned.after(3.0), signed.after(3.0)):
        orders = {name: agent.orders.leader(fleet.now) for name, agent in fleet.agents.items()}
        assert all((one is not None) is isinstance(fleet, SignedFleet) for one in orders.values())
        assert {one.place for one in orders.values() if one is not None} <= {None}


TEAM = team({"r0": ["leader"], "r1": ["r0"], "r2": ["r1"], "r3": ["r2"]})


def test_relays_add_their_own_delay_to_order_age() -> None:
    fleet = Fleet(mission("velocity", of=TEAM), delay=(0.01, 0.01)).after(3.0)
    leader = fleet.candidates["leader"]
    for name in ("r0", "r3"):
        order = fleet.agents[name].orders.state.newest
        assert order is not None
        true = fleet.now - leader._first_beat_at - (order.beat - 1) * leader.rate.period
        assert ages(fleet)[name] == pytest.approx(true, abs=0.015)


def test_false_order_age_from_relay_moves_no_robot_far() -> None:
    fleet = SignedFleet(mission("velocity", TURNING, TEAM))

    def older(sender: str, attachment: PositionAttachment) -> PositionAttachment:
        return attachment.model_copy(update={"order_age": 1.0}) if sender == "r0" else attachment

    fleet.tamper = older
    fleet.run(10.0)
    assert fleet.within_limits
    assert max(ages(fleet).values()) > 0.9
    assert 0.005 < fleet.error() < 0.1  # three edges of v/k, 0.2 rad aside


def test_wrong_velocity_from_leader_causes_bounded_error() -> None:
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


def test_paper_law_ignores_velocity_of_orders() -> None:
    fleets = [Fleet(mission(use, of=TEAM), law="paper").after(4.0) for use in ("none", "velocity")]
    assert fleets[0].commands == fleets[1].commands
