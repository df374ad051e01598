"""The leader's order as neighbours relay it: what proves a leader alive, and what proves nothing."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field

import pytest

from formation.agent.following.orders import Orders
from formation.agent.pose.stream import MAX_STAMP_OFFSET
from formation.mission.file import load
from formation.protocol.order import Mode, Order
from formation.wire import BadMessage, Now

EPOCH = 1.7e9
TERM = int(EPOCH * 1e9)
HIGHEST = 2**63 - 1
PERIOD = 0.05


@dataclass
class Receiver:
    """An agent's ear for orders, and the time."""

    orders: Orders = field(default_factory=lambda: Orders(load("six_robots")))
    mono: float = 0.0

    def receive(
        self, beat: int, *, term: int = TERM, of: str = "robot1", mode: Mode = "run", after: float = PERIOD
    ) -> None:
        self.mono += after
        received = Order(term=term, beat=beat, mode=mode, shape="hexagon")
        self.orders.receive(received, of, self.mono, Now(self.mono, EPOCH + self.mono))

    @property
    def newest(self) -> tuple[int, int]:
        assert self.orders.newest is not None
        return self.orders.newest.term, self.orders.newest.beat


@pytest.fixture
def alive() -> Receiver:
    """Has heard a living leader's beats 1 to 3."""
    receiver = Receiver()
    for beat in (1, 2, 3):
        receiver.receive(beat)
    assert receiver.newest == (TERM, 3)
    return receiver


def test_an_order_counts_once_its_beat_has_risen() -> None:
    receiver = Receiver()
    receiver.receive(7)
    assert receiver.orders.newest is None
    receiver.receive(8)
    assert receiver.newest == (TERM, 8)
    assert receiver.orders.state.rose == receiver.mono


def test_relayed_last_order_of_dead_leader_never_counts() -> None:
    receiver = Receiver()
    for _ in range(100):
        receiver.receive(7, of="robot3")
        receiver.receive(9, of="robot2")
    assert receiver.orders.newest is None


def test_beat_must_rise_at_the_same_neighbour(alive: Receiver) -> None:
    receiver = Receiver()
    receiver.receive(7, of="robot3")
    receiver.receive(8, of="robot2")
    assert receiver.orders.newest is None
    rose = alive.orders.state.rose
    alive.receive(3, of="robot2")
    assert alive.orders.state.rose == rose


def test_relays_ahead_of_a_leader_that_is_heard_are_refused(alive: Receiver) -> None:
    """robot1 leads. Once it has been silent for three periods, relays count again."""
    for beat in (4, 5, 1000, HIGHEST):
        with pytest.raises(BadMessage, match=f"ahead of the leader.s own, received here: .* beat {beat};"):
            alive.receive(beat, of="robot2", after=0.0)
    with pytest.raises(BadMessage, match="ahead of the leader"):
        alive.receive(1, term=TERM + 64, of="robot2", after=0.0)
    assert alive.newest == (TERM, 3)
    for beat in (4, 5, 6, 7, 8):
        with suppress(BadMessage):
            alive.receive(beat, of="robot2")
    assert alive.newest == (TERM, 8)


def test_mode_is_obeyed_with_live_leaders_first_beat(alive: Receiver) -> None:
    alive.receive(4, mode="stop")
    assert alive.orders.newest is not None
    assert alive.orders.newest.mode == "stop"


def test_a_new_leader_is_followed_from_its_second_beat_on(alive: Receiver) -> None:
    alive.receive(1, term=TERM + 5)
    assert alive.newest == (TERM, 3)
    alive.receive(2, term=TERM + 5)
    assert alive.newest == (TERM + 5, 2)


@pytest.mark.parametrize(("term", "beat"), [(TERM, HIGHEST), (TERM + 10**12, 1), (TERM + 10**12, HIGHEST)])
def test_a_single_forged_order_changes_nothing_and_costs_two_beats(
    alive: Receiver, term: int, beat: int
) -> None:
    alive.receive(beat, term=term)
    assert alive.newest == (TERM, 3)
    alive.receive(5)
    alive.receive(6)
    assert alive.newest == (TERM, 6)


def test_leader_is_followed_immediately_after_long_outage(alive: Receiver) -> None:
    alive.receive(3 + 20 * 600, after=600.0)
    assert alive.newest == (TERM, 3 + 20 * 600)


def test_a_term_that_begins_days_from_now_is_dropped(alive: Receiver) -> None:
    absurd = TERM + int((MAX_STAMP_OFFSET + 60.0) * 1e9)
    for beat in (1, 2, 3):
        with pytest.raises(BadMessage, match="absurd term"):
            alive.receive(beat, term=absurd)
    assert alive.newest == (TERM, 3)


def test_a_leader_that_started_earlier_is_dropped_and_the_reason_named(alive: Receiver) -> None:
    for beat in (1000, 1001):
        with pytest.raises(BadMessage, match="earlier term"):
            alive.receive(beat, term=TERM - 1)
    assert alive.newest == (TERM, 3)
