"""The leader's order as neighbours relay it: what proves a leader alive, and what proves nothing."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field

import pytest

from agent.orders import Orders
from agent.stream import ABSURD
from formation.mission_file import load
from formation.order import Mode, Order
from formation.wire import BadMessage, Now

EPOCH = 1.7e9
TERM = int(EPOCH * 1e9)
HIGHEST = 2**63 - 1
PERIOD = 0.05


@dataclass
class Hearer:
    """An agent's ear for orders, and the time."""

    orders: Orders = field(default_factory=lambda: Orders(load("six_robots")))
    mono: float = 0.0

    def hear(
        self, beat: int, *, term: int = TERM, of: str = "robot1", mode: Mode = "run", after: float = PERIOD
    ) -> None:
        self.mono += after
        heard = Order(term=term, beat=beat, mode=mode, shape="hexagon")
        self.orders.hear(heard, of, self.mono, Now(self.mono, EPOCH + self.mono))

    @property
    def newest(self) -> tuple[int, int]:
        assert self.orders.newest is not None
        return self.orders.newest.term, self.orders.newest.beat


@pytest.fixture
def alive() -> Hearer:
    """Has heard a living leader's beats 1 to 3."""
    hearer = Hearer()
    for beat in (1, 2, 3):
        hearer.hear(beat)
    assert hearer.newest == (TERM, 3)
    return hearer


def test_an_order_counts_once_its_beat_has_risen() -> None:
    hearer = Hearer()
    hearer.hear(7)
    assert hearer.orders.newest is None
    hearer.hear(8)
    assert hearer.newest == (TERM, 8)
    assert hearer.orders.rose == hearer.mono


def test_the_last_order_of_a_dead_leader_never_counts_however_often_it_is_relayed() -> None:
    hearer = Hearer()
    for _ in range(100):
        hearer.hear(7, of="robot3")
        hearer.hear(9, of="robot2")
    assert hearer.orders.newest is None


def test_a_beat_must_rise_at_one_neighbour_and_not_from_one_to_another(alive: Hearer) -> None:
    hearer = Hearer()
    hearer.hear(7, of="robot3")
    hearer.hear(8, of="robot2")
    assert hearer.orders.newest is None
    rose = alive.orders.rose
    alive.hear(3, of="robot2")
    assert alive.orders.rose == rose


def test_relays_ahead_of_a_leader_that_is_heard_are_refused(alive: Hearer) -> None:
    """robot1 leads. Once it has been silent for three periods, relays count again."""
    for beat in (4, 5, 1000, HIGHEST):
        with pytest.raises(BadMessage, match=f"ahead of the leader, which is heard here: .* beat {beat};"):
            alive.hear(beat, of="robot2", after=0.0)
    with pytest.raises(BadMessage, match="ahead of the leader"):
        alive.hear(1, term=TERM + 64, of="robot2", after=0.0)
    assert alive.newest == (TERM, 3)
    for beat in (4, 5, 6, 7, 8):
        with suppress(BadMessage):
            alive.hear(beat, of="robot2")
    assert alive.newest == (TERM, 8)


def test_a_mode_is_obeyed_with_the_first_beat_of_a_leader_that_is_known_to_live(alive: Hearer) -> None:
    alive.hear(4, mode="stop")
    assert alive.orders.newest is not None
    assert alive.orders.newest.mode == "stop"


def test_a_new_leader_is_followed_from_its_second_beat_on(alive: Hearer) -> None:
    alive.hear(1, term=TERM + 5)
    assert alive.newest == (TERM, 3)
    alive.hear(2, term=TERM + 5)
    assert alive.newest == (TERM + 5, 2)


@pytest.mark.parametrize(("term", "beat"), [(TERM, HIGHEST), (TERM + 10**12, 1), (TERM + 10**12, HIGHEST)])
def test_a_single_forged_order_changes_nothing_and_costs_two_beats(
    alive: Hearer, term: int, beat: int
) -> None:
    alive.hear(beat, term=term)
    assert alive.newest == (TERM, 3)
    alive.hear(5)
    alive.hear(6)
    assert alive.newest == (TERM, 6)


def test_a_leader_that_was_cut_off_for_long_is_followed_again_at_once(alive: Hearer) -> None:
    alive.hear(3 + 20 * 600, after=600.0)
    assert alive.newest == (TERM, 3 + 20 * 600)


def test_a_term_that_begins_days_from_now_is_dropped(alive: Hearer) -> None:
    absurd = TERM + int((ABSURD + 60.0) * 1e9)
    for beat in (1, 2, 3):
        with pytest.raises(BadMessage, match="absurd term"):
            alive.hear(beat, term=absurd)
    assert alive.newest == (TERM, 3)


def test_a_leader_that_started_earlier_is_dropped_and_the_reason_named(alive: Hearer) -> None:
    for beat in (1000, 1001):
        with pytest.raises(BadMessage, match="earlier term"):
            alive.hear(beat, term=TERM - 1)
    assert alive.newest == (TERM, 3)
