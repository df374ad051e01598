"""One voter: when it votes, and what it refuses."""

from __future__ import annotations

from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.leader.candidacy import Candidacy
from formation.protocol.election import (
    MAX_TERM_LEAD,
    TERM_EXPIRY_TIME,
    VOTE_BOUND_TIME,
    Voter,
    new_term,
    quarantine,
    rank_of,
    too_far,
)
from formation.protocol.order import Ballot, PositionAttachment
from formation.wire import BadMessage, Now
from tests.unit.leader.team import EPOCH
from tests.unit.leader.team import chain as mission

TERM = new_term(0, Now(0.0, EPOCH), 0)
TAG = mission().tag
Q = quarantine(mission())


def ballot(
    number: int = 1, term: int = TERM, candidacy: Literal["candidate", "leader", "leaving"] = "leader"
) -> Ballot:
    return Ballot(mission=TAG, term=term, number=number, candidacy=candidacy)


LATER = ballot(term=TERM + 1, candidacy="candidate")


def drives(voter: Voter, begin: float, end: float) -> None:
    """It hears and commands its robot all the time."""
    for period in range(1, round((end - begin) / 0.05) + 1):
        voter.aware(begin + 0.05 * period)
        voter.commanded(begin + 0.05 * period)


def told_quickly(voter: Voter, ballot: Ballot, mono: float, candidate: str = "led") -> tuple[int, int]:
    """Within the same step; the voted term and the last ballot after it."""
    voter.receive(ballot, candidate, mono, Now(mono, EPOCH + mono))
    return voter.state.voted_term, voter.state.last_ballot


def told_to(voter: Voter, ballot: Ballot, mono: float, candidate: str = "led") -> tuple[int, int]:
    if voter.state.stepped > float("-inf"):
        drives(voter, voter.state.stepped, mono)
    return told_quickly(voter, ballot, mono, candidate)


@pytest.fixture
def voter() -> Voter:
    """Has voted for the leader's own process."""
    voter = Voter(mission())
    drives(voter, -2.0, 1.0)
    assert told_to(voter, ballot(5), 1.0) == (TERM, 5)
    return voter


@given(st.integers(0, 63), st.floats(0.0, 1e9), st.floats(0.0, 4e9), st.integers(0, 2**62))
def test_term_is_above_all_that_others_may_believe(rank: int, mono: float, wall: float, known: int) -> None:
    now = Now(mono, wall)
    term = new_term(rank, now, known)
    assert term > known or too_far(known, now)
    assert term * 1e-9 - wall < MAX_TERM_LEAD + 2.0
    assert term >= int(wall * 1e9)
    assert rank_of(term) == rank


def test_a_vote_is_bound_until_its_term_has_been_silent(voter: Voter) -> None:
    assert told_to(voter, LATER, 1.0 + VOTE_BOUND_TIME - 0.01, "s0") == (TERM, 5)
    assert told_to(voter, ballot(6), 1.54) == (TERM, 6)
    assert told_to(voter, LATER, 1.6, "s0") == (TERM, 6)
    assert told_to(voter, LATER, 1.55 + VOTE_BOUND_TIME, "s0") == (TERM + 1, 1)


@pytest.mark.parametrize(("term", "number"), [(TERM, 5), (TERM, 4), (TERM - 64, 9)])
def test_repeated_and_outdated_ballots_change_nothing(voter: Voter, term: int, number: int) -> None:
    assert told_to(voter, ballot(number, term=term), 5.0) == (TERM, 5)


def test_leaving_candidate_frees_only_its_own_votes(voter: Voter) -> None:
    told_to(voter, ballot(9, term=TERM - 64, candidacy="leaving"), 1.1)
    assert told_to(voter, LATER, 1.1, "s0") == (TERM, 5)
    told_to(voter, ballot(6, candidacy="leaving"), 1.1)
    assert told_to(voter, LATER, 1.1, "s0") == (TERM + 1, 1)


def test_agent_that_starts_does_not_vote_at_once() -> None:
    voter = Voter(mission())
    drives(voter, 9.95, 10.0)
    first = ballot(candidacy="candidate")
    assert told_to(voter, first, 10.0 + Q - 0.01) == (0, 0)
    assert told_to(voter, first, 10.0 + Q + 0.05) == (TERM, 1)


def test_agent_beside_another_never_votes() -> None:
    voter = Voter(mission())
    for period in range(400):
        mono = 0.05 * period
        voter.aware(mono, rival=period % 18 == 0)  # the other one stalls now and then
        voter.commanded(mono)
        assert told_quickly(voter, ballot(period + 1), mono) == (0, 0)


def test_vote_is_not_renewed_beside_another_agent(voter: Voter) -> None:
    voter.aware(1.05, rival=True)
    assert told_quickly(voter, ballot(6), 1.05) == (TERM, 5)


def test_frozen_agent_does_not_vote_when_it_thaws(voter: Voter) -> None:
    voter.aware(1.5)  # after 0.5 s
    assert told_quickly(voter, ballot(6), 1.5) == (TERM, 5)
    voter.commanded(1.5)
    assert told_to(voter, ballot(7), 1.5 + Q - 0.01) == (TERM, 5)
    assert told_to(voter, ballot(8), 1.55 + Q) == (TERM, 8)


def test_stalled_agent_reads_signs_of_life_before_it_votes(voter: Voter) -> None:
    voter.aware(1.2)  # too short a gap to lose its vote
    voter.commanded(1.2)
    assert told_quickly(voter, ballot(6), 1.2) == (TERM, 5)
    assert told_to(voter, ballot(7), 1.35) == (TERM, 7)


def test_readonly_agent_never_votes() -> None:
    voter = Voter(mission(), votes=False)
    drives(voter, 0.0, 5.0)
    assert told_to(voter, ballot(), 5.0) == (0, 0)
    voter.follows(TERM, 5.0)
    assert voter.state.voted_term == 0


def test_silent_term_is_forgotten(voter: Voter) -> None:
    earlier = ballot(term=TERM - 64, candidacy="candidate")
    assert told_to(voter, earlier, 1.0 + TERM_EXPIRY_TIME - 0.05) == (TERM, 5)
    assert (voter.state.refused, voter.state.because) == (TERM - 64, "earlier")
    assert told_to(voter, earlier, 1.0 + TERM_EXPIRY_TIME + 0.1) == (TERM - 64, 1)


def test_voted_term_from_a_file_expires_too() -> None:
    voter = Voter(mission())
    voter.state.voted_term = TERM + 20 * 3600 * 10**9
    drives(voter, 0.0, TERM_EXPIRY_TIME)
    assert voter.state.voted_term > TERM
    drives(voter, TERM_EXPIRY_TIME, TERM_EXPIRY_TIME + 0.2)
    assert voter.state.voted_term == 0


def test_ballot_of_another_mission_is_refused(voter: Voter) -> None:
    others = Ballot(term=TERM, number=6, candidacy="leader", mission="0123abcd")
    with pytest.raises(BadMessage, match=f"led runs mission 0123abcd, this process {TAG}"):
        told_quickly(voter, others, 1.0)
    assert (voter.state.last_ballot, voter.state.refused) == (5, 0)


def test_rising_beat_sets_voted_term_without_a_vote(voter: Voter) -> None:
    voter.follows(TERM + 1, 1.1)
    assert (voter.state.voted_term, voter.state.last_ballot) == (TERM + 1, 0)
    same = ballot(9, term=TERM + 1)
    assert told_to(voter, same, 1.5, "s0") == (TERM + 1, 0)
    voter.follows(TERM + 1, 1.5)
    assert told_to(voter, same, 1.0 + VOTE_BOUND_TIME, "s0") == (TERM + 1, 9)


def test_no_other_candidate_gets_the_vote_while_a_beat_rises(voter: Voter) -> None:
    voter.follows(TERM, 3.0)
    assert told_to(voter, LATER, 3.0 + VOTE_BOUND_TIME - 0.01, "s0") == (TERM, 5)
    assert told_to(voter, LATER, 3.01 + VOTE_BOUND_TIME, "s0") == (TERM + 1, 1)


@pytest.mark.parametrize(
    ("term", "candidate", "why"),
    [
        (TERM + 86_500 * 10**9 // 64 * 64, "led", "absurd term"),
        (TERM + 1, "led", "not led's"),
        (TERM + 3, "s1", "not s1's"),
    ],
)
def test_impossible_ballot_is_refused_by_name(voter: Voter, term: int, candidate: str, why: str) -> None:
    wrong = ballot(term=term, candidacy="candidate")
    with pytest.raises(BadMessage, match=why):
        told_to(voter, wrong, 5.0, candidate)
    with pytest.raises(BadMessage, match=why):
        Candidacy(mission(), "s0").receive_ballot(wrong, candidate, 5.0, Now(5.0, EPOCH + 5.0))


def test_an_absurd_voted_term_is_refused() -> None:
    one = Candidacy(mission(), "s0")
    absurd = PositionAttachment(publisher_id="", count=1, voted_term=2**62, mission=TAG)
    with pytest.raises(BadMessage, match="absurd term"):
        one.receive("f0", absurd, 5.0, Now(5.0, EPOCH + 5.0))
    assert one.known == 0


def test_refusal_of_non_candidate_names_candidates() -> None:
    with pytest.raises(ValueError, match="candidate 'f0': must be one of led, s0, s1"):
        Candidacy(mission(), "f0")


def test_without_standbys_a_robot_votes_for_no_term() -> None:
    voter = Voter(mission(standbys=0))
    voter.aware(0.0)
    voter.follows(TERM, 1.0)
    assert (voter.state.voted_term, voter.state.last_ballot) == (0, 0)
