"""One voter: whom it promises itself to, and what it refuses."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.election import BOUND, Voter, new_term, rank_of
from formation.order import Ballot, Told
from formation.wire import BadMessage, Now
from leader.candidacy import Candidacy
from tests.formation.elections import EPOCH, mission

TERM = new_term(0, Now(0.0, EPOCH), 0)


def told_to(voter: Voter, ballot: Ballot, mono: float, candidate: str = "led") -> tuple[int, int]:
    voter.hear(ballot, candidate, mono, Now(mono, EPOCH + mono))
    return voter.promise, voter.echo


@pytest.fixture
def voter() -> Voter:
    """Has given its voice to the leader's own process."""
    voter = Voter(mission())
    voter.aware(0.0)
    assert told_to(voter, Ballot(term=TERM, number=5, standing="leader"), 1.0) == (TERM, 5)
    return voter


@given(st.integers(0, 63), st.floats(0.0, 1e9), st.floats(0.0, 4e9), st.integers(0, 2**62))
def test_a_term_is_above_all_that_are_known_and_says_whose_it_is(
    rank: int, mono: float, wall: float, known: int
) -> None:
    term = new_term(rank, Now(mono, wall), known)
    assert term > known
    assert term >= int(wall * 1e9)
    assert rank_of(term) == rank


def test_a_voice_is_bound_until_its_term_has_been_silent(voter: Voter) -> None:
    later = Ballot(term=TERM + 1, number=1, standing="candidate")
    assert told_to(voter, later, 1.0 + BOUND - 0.01, "s0") == (TERM, 5)
    assert told_to(voter, Ballot(term=TERM, number=6, standing="leader"), 1.54) == (TERM, 6)
    assert told_to(voter, later, 1.6, "s0") == (TERM, 6)
    assert told_to(voter, later, 1.55 + BOUND, "s0") == (TERM + 1, 1)


@pytest.mark.parametrize("ballot", [(TERM, 5), (TERM, 4), (TERM - 64, 9)])
def test_what_was_said_before_and_what_is_of_an_earlier_term_changes_nothing(
    voter: Voter, ballot: tuple[int, int]
) -> None:
    term, number = ballot
    assert told_to(voter, Ballot(term=term, number=number, standing="leader"), 100.0) == (TERM, 5)


def test_who_leaves_frees_the_voices_that_it_has_and_no_others(voter: Voter) -> None:
    later = Ballot(term=TERM + 1, number=1, standing="candidate")
    told_to(voter, Ballot(term=TERM - 64, number=9, standing="leaving"), 1.1)
    assert told_to(voter, later, 1.1, "s0") == (TERM, 5)
    told_to(voter, Ballot(term=TERM, number=6, standing="leaving"), 1.1)
    assert told_to(voter, later, 1.1, "s0") == (TERM + 1, 1)


def test_a_robot_that_has_just_started_waits_for_it_may_have_forgotten_whom_it_promised_itself() -> None:
    voter = Voter(mission())
    voter.aware(10.0)
    ballot = Ballot(term=TERM, number=1, standing="candidate")
    assert told_to(voter, ballot, 10.0 + BOUND - 0.01) == (0, 0)
    assert told_to(voter, ballot, 10.0 + BOUND) == (TERM, 1)


def test_a_beat_that_rises_is_a_promise_but_gives_no_voice(voter: Voter) -> None:
    voter.follows(TERM + 1, 1.1)
    assert (voter.promise, voter.echo) == (TERM + 1, 0)
    ballot = Ballot(term=TERM + 1, number=9, standing="leader")
    assert told_to(voter, ballot, 1.5, "s0") == (TERM + 1, 0)
    voter.follows(TERM + 1, 1.5)
    assert told_to(voter, ballot, 1.0 + BOUND, "s0") == (TERM + 1, 9)


def test_while_a_beat_rises_nobody_else_gets_the_voice(voter: Voter) -> None:
    voter.follows(TERM, 3.0)
    later = Ballot(term=TERM + 1, number=1, standing="candidate")
    assert told_to(voter, later, 3.0 + BOUND - 0.01, "s0") == (TERM, 5)
    assert told_to(voter, later, 3.01 + BOUND, "s0") == (TERM + 1, 1)


@pytest.mark.parametrize(
    ("term", "candidate", "why"),
    [
        (TERM + 86_500 * 10**9 // 64 * 64, "led", "absurd term"),
        (TERM + 1, "led", "not led's"),
        (TERM + 3, "s1", "not s1's"),
    ],
)
def test_a_ballot_that_nobody_can_have_sent_is_refused_by_name(
    voter: Voter, term: int, candidate: str, why: str
) -> None:
    ballot = Ballot(term=term, number=1, standing="candidate")
    with pytest.raises(BadMessage, match=why):
        told_to(voter, ballot, 5.0, candidate)
    with pytest.raises(BadMessage, match=why):
        Candidacy(mission(), "s0").hear_ballot(ballot, candidate, 5.0, Now(5.0, EPOCH + 5.0))


def test_an_absurd_promise_is_refused() -> None:
    one = Candidacy(mission(), "s0")
    with pytest.raises(BadMessage, match="absurd term"):
        one.hear("f0", Told(voice="", count=1, promise=2**62), 5.0, Now(5.0, EPOCH + 5.0))
    assert one.known == 0


def test_who_is_no_candidate_is_told_who_is() -> None:
    with pytest.raises(ValueError, match="candidate 'f0': must be one of led, s0, s1"):
        Candidacy(mission(), "f0")


def test_without_standbys_a_robot_promises_nothing() -> None:
    voter = Voter(mission(standbys=0))
    voter.aware(0.0)
    voter.follows(TERM, 1.0)
    assert (voter.promise, voter.echo) == (0, 0)
