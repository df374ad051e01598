"""One voter: when it votes, and which ballots it refuses."""

from __future__ import annotations

from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.leader.candidacy import Candidacy
from formation.protocol.attachment import Ballot, PositionAttachment
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


def run_agent(voter: Voter, begin: float, end: float) -> None:
    """Let the agent receive and command its robot in every period."""
    for period in range(1, round((end - begin) / 0.05) + 1):
        voter.aware(begin + 0.05 * period)
        voter.commanded(begin + 0.05 * period)


def deliver_at_once(voter: Voter, ballot: Ballot, mono: float, candidate: str = "led") -> tuple[int, int]:
    """Receive a ballot within the present step; return the voted term and the last ballot."""
    voter.receive(ballot, candidate, mono, Now(mono, EPOCH + mono))
    return voter.state.voted_term, voter.state.last_ballot


def deliver(voter: Voter, ballot: Ballot, mono: float, candidate: str = "led") -> tuple[int, int]:
    if voter.state.stepped > float("-inf"):
        run_agent(voter, voter.state.stepped, mono)
    return deliver_at_once(voter, ballot, mono, candidate)


@pytest.fixture
def voter() -> Voter:
    """A voter that has voted for the leader's own process."""
    voter = Voter(mission())
    run_agent(voter, -2.0, 1.0)
    assert deliver(voter, ballot(5), 1.0) == (TERM, 5)
    return voter


@given(st.integers(0, 63), st.floats(0.0, 1e9), st.floats(0.0, 4e9), st.integers(0, 2**62))
def test_new_term_is_above_known_term_and_wall_time(rank: int, mono: float, wall: float, known: int) -> None:
    now = Now(mono, wall)
    term = new_term(rank, now, known)
    assert term > known or too_far(known, now)
    assert term * 1e-9 - wall < MAX_TERM_LEAD + 2.0
    assert term >= int(wall * 1e9)
    assert rank_of(term) == rank


def test_vote_is_bound_until_its_term_is_silent(voter: Voter) -> None:
    assert deliver(voter, LATER, 1.0 + VOTE_BOUND_TIME - 0.01, "s0") == (TERM, 5)
    assert deliver(voter, ballot(6), 1.54) == (TERM, 6)
    assert deliver(voter, LATER, 1.6, "s0") == (TERM, 6)
    assert deliver(voter, LATER, 1.55 + VOTE_BOUND_TIME, "s0") == (TERM + 1, 1)


@pytest.mark.parametrize(("term", "number"), [(TERM, 5), (TERM, 4), (TERM - 64, 9)])
def test_repeated_and_outdated_ballots_change_nothing(voter: Voter, term: int, number: int) -> None:
    assert deliver(voter, ballot(number, term=term), 5.0) == (TERM, 5)


def test_leaving_candidate_frees_only_its_own_votes(voter: Voter) -> None:
    deliver(voter, ballot(9, term=TERM - 64, candidacy="leaving"), 1.1)
    assert deliver(voter, LATER, 1.1, "s0") == (TERM, 5)
    deliver(voter, ballot(6, candidacy="leaving"), 1.1)
    assert deliver(voter, LATER, 1.1, "s0") == (TERM + 1, 1)


def test_started_agent_votes_only_after_quarantine() -> None:
    voter = Voter(mission())
    run_agent(voter, 9.95, 10.0)
    first = ballot(candidacy="candidate")
    assert deliver(voter, first, 10.0 + Q - 0.01) == (0, 0)
    assert deliver(voter, first, 10.0 + Q + 0.05) == (TERM, 1)


def test_agent_with_rival_never_votes() -> None:
    voter = Voter(mission())
    for period in range(400):
        mono = 0.05 * period
        voter.aware(mono, rival=period % 18 == 0)  # the other agent stalls now and then
        voter.commanded(mono)
        assert deliver_at_once(voter, ballot(period + 1), mono) == (0, 0)


def test_vote_is_not_renewed_with_rival(voter: Voter) -> None:
    voter.aware(1.05, rival=True)
    assert deliver_at_once(voter, ballot(6), 1.05) == (TERM, 5)


def test_frozen_agent_votes_only_after_quarantine(voter: Voter) -> None:
    voter.aware(1.5)  # after 0.5 s
    assert deliver_at_once(voter, ballot(6), 1.5) == (TERM, 5)
    voter.commanded(1.5)
    assert deliver(voter, ballot(7), 1.5 + Q - 0.01) == (TERM, 5)
    assert deliver(voter, ballot(8), 1.55 + Q) == (TERM, 8)


def test_agent_does_not_vote_in_step_after_short_stall(voter: Voter) -> None:
    voter.aware(1.2)  # a gap too short for a quarantine
    voter.commanded(1.2)
    assert deliver_at_once(voter, ballot(6), 1.2) == (TERM, 5)
    assert deliver(voter, ballot(7), 1.35) == (TERM, 7)


def test_readonly_agent_never_votes() -> None:
    voter = Voter(mission(), votes=False)
    run_agent(voter, 0.0, 5.0)
    assert deliver(voter, ballot(), 5.0) == (0, 0)
    voter.follows(TERM, 5.0)
    assert voter.state.voted_term == 0


def test_silent_voted_term_expires(voter: Voter) -> None:
    earlier = ballot(term=TERM - 64, candidacy="candidate")
    assert deliver(voter, earlier, 1.0 + TERM_EXPIRY_TIME - 0.05) == (TERM, 5)
    assert (voter.state.refused, voter.state.because) == (TERM - 64, "earlier")
    assert deliver(voter, earlier, 1.0 + TERM_EXPIRY_TIME + 0.1) == (TERM - 64, 1)


def test_restored_voted_term_expires_too() -> None:
    voter = Voter(mission())
    voter.state.voted_term = TERM + 20 * 3600 * 10**9
    run_agent(voter, 0.0, TERM_EXPIRY_TIME)
    assert voter.state.voted_term > TERM
    run_agent(voter, TERM_EXPIRY_TIME, TERM_EXPIRY_TIME + 0.2)
    assert voter.state.voted_term == 0


def test_ballot_of_another_mission_is_refused(voter: Voter) -> None:
    others = Ballot(term=TERM, number=6, candidacy="leader", mission="0123abcd")
    with pytest.raises(BadMessage, match=f"led runs mission 0123abcd, this process {TAG}"):
        deliver_at_once(voter, others, 1.0)
    assert (voter.state.last_ballot, voter.state.refused) == (5, 0)


def test_rising_beat_sets_voted_term_without_a_vote(voter: Voter) -> None:
    voter.follows(TERM + 1, 1.1)
    assert (voter.state.voted_term, voter.state.last_ballot) == (TERM + 1, 0)
    same = ballot(9, term=TERM + 1)
    assert deliver(voter, same, 1.5, "s0") == (TERM + 1, 0)
    voter.follows(TERM + 1, 1.5)
    assert deliver(voter, same, 1.0 + VOTE_BOUND_TIME, "s0") == (TERM + 1, 9)


def test_rising_beat_keeps_vote_bound(voter: Voter) -> None:
    voter.follows(TERM, 3.0)
    assert deliver(voter, LATER, 3.0 + VOTE_BOUND_TIME - 0.01, "s0") == (TERM, 5)
    assert deliver(voter, LATER, 3.01 + VOTE_BOUND_TIME, "s0") == (TERM + 1, 1)


@pytest.mark.parametrize(
    ("term", "candidate", "why"),
    [
        (TERM + 86_500 * 10**9 // 64 * 64, "led", "absurd term"),
        (TERM + 1, "led", "not led's"),
        (TERM + 3, "s1", "not s1's"),
    ],
)
def test_impossible_ballot_is_refused_with_its_reason(
    voter: Voter, term: int, candidate: str, why: str
) -> None:
    wrong = ballot(term=term, candidacy="candidate")
    with pytest.raises(BadMessage, match=why):
        deliver(voter, wrong, 5.0, candidate)
    with pytest.raises(BadMessage, match=why):
        Candidacy(mission(), "s0").receive_ballot(wrong, candidate, 5.0, Now(5.0, EPOCH + 5.0))


def test_candidacy_refuses_absurd_voted_term() -> None:
    one = Candidacy(mission(), "s0")
    absurd = PositionAttachment(publisher_id="", count=1, voted_term=2**62, mission=TAG)
    with pytest.raises(BadMessage, match="absurd term"):
        one.receive("f0", absurd, 5.0, Now(5.0, EPOCH + 5.0))
    assert one.known == 0


def test_refusal_of_non_candidate_names_candidates() -> None:
    with pytest.raises(ValueError, match="candidate 'f0': must be one of led, s0, s1"):
        Candidacy(mission(), "f0")


def test_voter_without_standbys_has_no_voted_term() -> None:
    voter = Voter(mission(standbys=0))
    voter.aware(0.0)
    voter.follows(TERM, 1.0)
    assert (voter.state.voted_term, voter.state.last_ballot) == (0, 0)
