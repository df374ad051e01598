"""Who leads: never two at once, whatever happens; and somebody, once it no longer does."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.leader.candidacy import Candidacy
from formation.protocol.election import new_term
from formation.protocol.order import Order, PositionAttachment
from formation.wire import Now
from tests.unit.formation.elections import EPOCH, World, mission

TERM = new_term(0, Now(0.0, EPOCH), 0)
WHAT = st.sampled_from(
    [
        *("nothing", "cut", "split", "deafen", "heal", "freeze", "thaw", "restart"),
        *("stand", "stand", "kill", "clock", "network", "twin", "untwin"),
    ]
)


@dataclass(frozen=True)
class Happening:
    """To some of the processes, or between them and the rest."""

    what: str
    whom: frozenset[int]
    number: int
    seconds: float

    def to(self, world: World) -> None:
        names = list(world.processes)
        some = [name for index, name in enumerate(names) if index in self.whom]
        rest = [name for name in names if name not in some]
        across = {(one, other) for one in some for other in rest}
        if self.what == "cut":
            world.cut |= {(one, names[self.number % len(names)]) for one in some}
        elif self.what == "split":
            world.cut |= across | {(other, one) for one, other in across}
        elif self.what == "deafen":
            world.cut |= across
        elif self.what == "heal":
            world.cut.clear()
        elif self.what == "network":
            world.loss, world.twice = (self.number % 4) * 0.2, (self.number % 3) * 0.3
            world.slowest = (0.01, 0.1, 0.4, 1.5)[self.number // 4]
        elif self.what == "twin":
            world.twin(world.mission.followers[self.number % len(world.mission.followers)])
        elif self.what == "untwin":
            for name in world.twins:
                world.processes[name].alive = False
        for name in some:
            self._to(world, name)

    def _to(self, world: World, name: str) -> None:
        process = world.processes[name]
        if self.what == "freeze":
            world.freeze(name)
        elif self.what == "thaw":
            world.thaw(name)
        elif self.what == "restart":
            world.restart(name)
        elif self.what == "stand" and name in world.mission.candidates:
            world.stand(name)
        elif self.what == "kill":
            process.alive = False
        elif self.what == "clock":
            process.wall += 3600.0 * (self.number % 3 - 1)


HAPPENINGS = st.lists(
    st.builds(
        Happening,
        WHAT,
        st.frozensets(st.integers(0, 8), min_size=1, max_size=5),
        st.integers(0, 15),
        st.floats(0.0, 0.8),
    ),
    min_size=5,
    max_size=30,
)


@pytest.mark.slow
@settings(max_examples=150)
@given(followers=st.integers(1, 5), standbys=st.integers(1, 3), seed=st.integers(0, 2**32), them=HAPPENINGS)
def test_at_most_one_leads_under_any_fault(
    followers: int, standbys: int, seed: int, them: list[Happening]
) -> None:
    world = World(mission(followers, standbys), seed)
    world.run(1.2)
    for one in them:
        one.to(world)
        world.run(one.seconds)
    world.heal()
    for name, process in world.processes.items():
        if not process.alive and name not in world.twins:
            world.restart(name)
    for name in world.twins:
        world.processes[name].alive = False
    world.run(8.0)
    agreed = world.leader_terms[-1]
    world.run(2.0)
    assert world.leaders() == [agreed[0]]
    assert world.leader_terms[-1] == agreed
    assert {world.orders(name).voter.state.voted_term for name in world.mission.followers} == {agreed[1]}
    newest = [world.orders(name).newest for name in world.mission.followers]
    assert {order.term for order in newest if order is not None} == {agreed[1]}


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32), followers=st.integers(1, 5), restarted=st.booleans())
def test_standby_never_leads_before_lease_has_ended(seed: int, followers: int, restarted: bool) -> None:
    world = World(mission(followers), seed)
    world.run(2.0)
    assert world.leaders() == ["led"]
    world.cut |= {("led", name) for name in (*world.mission.followers, "s0", "s1")}
    for name in world.mission.followers if restarted else ():
        world.restart(name)
    for _ in range(200):
        world.stand("s0")
        world.run(0.01)
    assert [name for name, _ in world.leader_terms] == ["led", "s0"]


@pytest.fixture
def world() -> World:
    """The leader's own process leads."""
    world = World(mission())
    world.run(2.0)
    assert [name for name, _ in world.leader_terms] == ["led"]
    return world


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32), followers=st.integers(1, 7), takeover=st.sampled_from([0.4, 1.0, 3.0]))
def test_the_first_standby_leads_within_a_takeover_of_the_leaders_death(
    seed: int, followers: int, takeover: float
) -> None:
    world = World(mission(followers, 3, takeover), seed)
    world.run(2.0 * takeover + 1.0)
    assert world.leaders() == ["led"]
    world.processes["led"].alive = False
    world.run(takeover + 0.1)
    assert world.leaders() == ["s0"]
    world.run(2.0 * takeover)
    assert [name for name, _ in world.leader_terms] == ["led", "s0"]


def test_if_the_first_standby_is_dead_too_the_second_leads(world: World) -> None:
    world.processes["led"].alive = world.processes["s0"].alive = False
    world.run(1.1)
    assert world.leaders() == ["s1"]


def test_first_standby_succeeds_leaving_leader_at_once(world: World) -> None:
    left = world.candidacy("led").leave(world.processes["led"].now(world.true))
    assert left is not None
    assert left.candidacy == "leaving"
    world._say("led", ("s0", "s1", *world.mission.followers), left)
    world.processes["led"].alive = False
    world.run(0.4)
    assert world.leaders() == ["s0"]


@pytest.mark.parametrize("clock", [0.0, -3600.0, 3600.0])
def test_returning_leader_stands_by_and_can_lead_again(world: World, clock: float) -> None:
    world.processes["led"].alive = False
    world.run(1.5)
    world.processes["led"].wall += clock
    world.restart("led")
    world.run(3.0)
    assert world.leaders() == ["s0"]
    assert world.candidacy("led").state == "standby"
    world.processes["s0"].alive = False
    world.run(1.2)
    assert world.leaders() == ["led"]


def test_restarted_leader_with_late_clock_leads_if_alone() -> None:
    world = World(mission())
    world.run(2.0)
    for name in ("s0", "s1"):
        world.processes[name].alive = False
    world.processes["led"].wall -= 3600.0
    world.restart("led")
    world.run(2.5)
    assert world.leaders() == ["led"]
    assert len({term for _, term in world.leader_terms}) == 2


def test_a_frozen_leader_says_nothing_more_when_it_is_thawed(world: World) -> None:
    world.freeze("led")
    world.run(3.0)
    assert world.leaders() == ["s0"]
    world.thaw("led")
    result = world.processes["led"].beat
    world.run(1.0)
    assert world.processes["led"].beat == result
    assert world.leaders() == ["s0"]


def test_leader_cut_off_with_minority_resigns_before_successor(world: World) -> None:
    one, *others = world.mission.followers
    for name in ("led", one):
        for other in {"s0", "s1", *others}:
            world.cut |= {(name, other), (other, name)}
    world.run(0.62)
    assert world.leaders() == []
    world.run(0.5)
    assert world.leaders() == ["s0"]
    world.heal()
    world.run(2.0)
    assert world.leaders() == ["s0"]
    assert world.orders(one).voter.state.voted_term == world.candidacy("s0").term


def test_candidate_with_minority_never_asks_for_votes(world: World) -> None:
    for name in world.mission.followers[1:]:
        world.cut.add((name, "s0"))
    world.cut.add(("led", "s0"))
    world.processes["led"].alive = False
    world.run(5.0)
    assert world.candidacy("s0").term == 0
    assert world.leaders() == ["s1"]


@pytest.mark.parametrize("takeover", [0.4, 1.0, 3.0])
def test_leader_that_no_robot_hears_is_replaced(takeover: float) -> None:
    world = World(mission(takeover=takeover))
    world.run(2.0 * takeover + 1.0)
    assert world.leaders() == ["led"]
    world.cut = {("led", name) for name in world.mission.followers}
    world.run(4.0 * takeover)
    assert world.leaders() == ["s0"]


def test_robot_voting_for_leaderless_term_is_won_back(world: World) -> None:
    term = new_term(2, world.processes["s1"].now(world.true), 0)
    world.orders("f2").voter.follows(term, world.processes["f2"].now(world.true).mono)
    world.run(2.0)
    assert [name for name, _ in world.leader_terms] == ["led", "led"]
    assert world.leader_terms[-1][1] > term
    newest = world.orders("f2").newest
    assert newest is not None
    assert newest.term == world.leader_terms[-1][1]


def test_two_leaders_without_standbys_do_not_both_continue() -> None:
    alone = mission(standbys=0)
    first, second = Candidacy(alone, "led"), Candidacy(alone, "led")
    assert first.step(Now(0.0, EPOCH)) is None
    first.receive(
        "f0", PositionAttachment(publisher_id="", count=1, mission=alone.tag), 0.1, Now(0.1, EPOCH + 0.1)
    )
    first.step(Now(0.1, EPOCH + 0.1))
    assert first.leading
    for mono in (5.0, 5.9, 6.0):
        second.step(Now(mono, EPOCH + mono))
    assert second.leading

    def relayed(beat: int) -> PositionAttachment:
        result = Order(term=second.term, beat=beat, mode="run", shape="row")
        return PositionAttachment(publisher_id="", count=beat + 1, order=result, mission=alone.tag)

    for beat in range(1, 50):
        mono = 6.0 + beat * 0.05
        first.receive("f0", relayed(beat), mono, Now(mono, EPOCH + mono))
        first.step(Now(mono, EPOCH + mono))
        assert beat == 1 or first.state == "standby"
    before = first.term
    first.step(Now(mono + 1.1, EPOCH + mono))
    assert first.leading
    assert first.term > second.term > before
