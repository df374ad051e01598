"""Leader election: terms, followers' votes, and leases that never overlap.

A candidate asks every follower for its vote in a term, repeatedly, by ballots; a follower votes for one
term at a time, and its positions name that term and the newest ballot of it that it received. With the
votes of more than half of the followers a candidate leads, for as long as its lease.

**No two lead at once.** Let T be ``mission.takeover`` and p the period of the slowest follower. All times
below are of one true time; a process reads only its own monotonic clock, and takes differences of under 2
T, so clocks need only run equally fast within a tenth.

1. A candidate's vote of robot v counts at a moment m if v named a ballot of its term that was sent at s > m
   - 0.5 T. So an agent of v received that ballot at some h with s ≤ h ≤ m, having voted for that term.
2. A candidate that leads at m in term t has votes that count of more than half. If two led at m, in terms t
   ≠ t' (terms are unique to a candidate, and a candidate has one at a time), both would have one of the same
   robot v: a ballot of each was received, at h ≠ h', both after m - 0.5 T and not after m.
3. Between two ballots of different terms for which *one process* votes lie 0.55 T at least (`Voter`
   refuses). Only ``leaving`` frees it earlier, and the candidate that sends it leads no more in that term.
4. Two *processes* of robot v, one after the other or both at once, vote at least 0.55 T apart. A process
   votes at h only if it has been **alone with its robot** since h - Q: in that time it has commanded the
   robot at gaps of at most G, each command with a sign of life on the robot's own side, and it has received
   no sign of life of another agent there; nor does it vote within D after a gap over D between two steps of
   its own. Q = 0.55 T + G + D, G = max(0.4 T, 3 p), D = max(0.1 T, 2 p). Assume h ≤ h' < h + 0.55 T for the
   processes A and B. B gave a sign of life in [h' - Q, h' - Q + G]. It reached A by h' - Q + G + D < h, and
   not before h - Q, so A was not alone at h: a contradiction. If it did not reach A because A had lost its
   link with the robot, A had commanded the robot at h - G or later; that sign reached B, so h' ≥ h - G + Q >
   h + 0.55 T: again a contradiction. With B before A the same holds, names exchanged. If A had ended before
   B began, B is alone Q after its first command.

With 3 and 4, |h - h'| ≥ 0.55 T, against 2. ∎

**Assumptions of 4.** (a) Both agents are linked with the same robot, and a sign of life there reaches the
other agent within D of when it was sent or, if that agent was frozen, of when it continues; links with the
robot may break, one at a time. The network between robots may be cut, late or lossy without effect. (b) An
agent that sends its robot nothing (``--readonly``) does not vote. (c) Agents do not lie: if a robot with a
valid certificate votes in two terms at once, two leaders may be elected. (d) One process at a time for
each candidate.

*What no rule can prevent:* two agents of one name on two robots, in two halves of a cut network. Each half
sees one healthy agent, as after a restart. If a candidate receives both, `Candidacy` counts neither: a
robot's vote counts only 0.55 T after its publisher changed, so two that alternate never count.

Delay, loss, repetition and reordering of messages between robots have no effect: an old position only reports
what was true. Neither has a frozen process: it checks its lease, by its clock, before it sends anything.

**Terms only order leaders**; nothing above needs them to rise. A rising beat shows that a leader is alive
in its term, so a robot adopts that term and refuses orders of earlier ones. It votes by rules 3 and 4
alone: the beat may have been delayed.

**No robot is held for ever by a term.** Robots forget a term that has been silent (neither beat nor
ballot) for `TERM_EXPIRY_TIME`. A candidate never draws a term over half a day ahead of its clock, and robots
refuse terms over a day ahead of theirs. So where clocks agree within half a day, whatever terms were believed
before (due to a wrong clock or a lie), a term that a candidate draws is accepted `TERM_EXPIRY_TIME` after the
others fell silent. Where orders are signed, a robot that has obeyed a term which begins in the past of its
clock obeys no earlier one, because that may be recorded. A candidate draws a later term: it knows every term
that robots relay, but for those over half a day ahead, which no robot takes for past.

**A leader is found** once more than half of the followers, and one candidate, receive each other: within
about T for robots that have been alone for Q, because the candidates wait for each other by rank.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from formation.control.tracker import FRESH_PERIODS
from formation.mission.model import Mission
from formation.protocol.attachment import Ballot, PositionAttachment, Refusal, check_mission
from formation.wire import BadMessage, Now

RENEWAL_PERIOD = 0.1
"""Approximate period at which a leader renews its lease [s], or [T] where T is under 1 s."""
LEASE_TIME = 0.5
"""Time for which a vote counts after its ballot was sent [T]."""
VOTE_BOUND_TIME = 0.55
"""Time for which a robot's vote is bound to one term, and a new publisher of a robot does not count [T]."""
COMMAND_GAP = 0.4
"""Time without a command after which an agent is not alone with its robot [T]; at least 3 periods."""
MAX_SIGN_DELAY = 0.1
"""Longest time in which a sign of life reaches another agent of the same robot [T]; at least 2 periods."""
LEADERLESS_TIME = 0.6
"""Time without a renewed vote after which there is no leader [T]."""
RANK_WAIT = 0.1
"""Additional wait of each candidate after the one before it [T]."""
CAMPAIGN_TIME = 0.7
"""Time after which a candidate gives up; over VOTE_BOUND_TIME, so that bound votes can become free [T]."""
LISTENING_TIME = 1.0
"""Longest time that a starting leader waits for the other robots' reports after the first [s]."""
READING_TIME = 2.5
"""The same if it cannot read the order that they relay: its key's certificate comes once a second [s]."""
MAX_TERM_OFFSET = 86_400.0
"""Difference from now beyond which a term is refused [s]."""
MAX_TERM_LEAD = 43_200.0
"""Greatest lead of a drawn term over its candidate's clock [s]: clocks that differ by as much accept it."""
TERM_EXPIRY_TIME = 5.0
"""Silence (neither beat nor ballot) after which robots forget a term [s]; in units of T where T is over 1
s."""
MIN_CLOCK_STEP = 1.0
"""Step of a clock from which a single leader draws a new term [s]."""
REPORT_TIME = 2.0
"""Time for which a robot reports that it has refused a term [s]."""
TERM_STEP_NANOSECONDS = 64
"""Distance between terms of one candidate, so that no two candidates share one [ns]."""

CandidacyState = Literal["listening", "standby", "candidate", "leader"]


def new_term(rank: int, now: Now, known: int) -> int:
    """Draw a term for the candidate of this rank: its system clock, or a little above every known term.

    The little is of its other clock: a process with a system clock that was set back, and that receives less
    than the one before it did, must not draw the same term again. A known term too far ahead does not
    count: others would refuse one above it, and it is forgotten once it is silent.
    """
    base = int(now.wall * 1e9)
    if not too_far(known, now):
        base = max(base, known + 1 + int(now.mono * 1e9) % 10**9)
    return base + (rank - base) % TERM_STEP_NANOSECONDS


def too_far(term: int, now: Now) -> bool:
    """Whether a term is too far ahead of this clock for a candidate to draw or keep."""
    return term * 1e-9 - now.wall > MAX_TERM_LEAD


def set_forward(since: Now, now: Now) -> bool:
    """Whether the system clock was set forward between the two moments, or the process was suspended."""
    return (now.wall - since.wall) - (now.mono - since.mono) > MIN_CLOCK_STEP


def begun(term: int, now: Now) -> bool:
    """Whether a term begins in the past of this clock, so that no clock set ahead can have drawn it."""
    return term * 1e-9 <= now.wall


def expiry(mission: Mission) -> float:
    """Silence of a term after which robots forget it [s]."""
    return TERM_EXPIRY_TIME * max(1.0, mission.takeover)


def longest_gap(mission: Mission) -> float:
    """G: time without a command after which an agent is not alone with its robot [s]."""
    return max(mission.takeover * COMMAND_GAP, FRESH_PERIODS * _slowest_period(mission))


def reach(mission: Mission) -> float:
    """D: longest time in which a sign of life reaches another agent of the same robot [s]."""
    return max(mission.takeover * MAX_SIGN_DELAY, 2.0 * _slowest_period(mission))


def quarantine(mission: Mission) -> float:
    """Q: time alone with its robot after which an agent votes [s]."""
    return mission.takeover * VOTE_BOUND_TIME + longest_gap(mission) + reach(mission)


def _slowest_period(mission: Mission) -> float:
    return max(1.0 / mission.robots[name].rate for name in mission.followers)


def rank_of(term: int) -> int:
    """Index in ``mission.candidates`` of the candidate of a term."""
    return term % TERM_STEP_NANOSECONDS


def check_term(term: int, now: Now) -> None:
    """Raise BadMessage for a term that begins more than a day from now."""
    if term * 1e-9 - now.wall > MAX_TERM_OFFSET:
        raise BadMessage(absurd(term, now))


def absurd(term: int, now: Now) -> str:
    """Return what is wrong with a term that begins more than a day from now, in words."""
    begins, limit = term * 1e-9 - now.wall, MAX_TERM_OFFSET
    return (
        f"absurd term: begins {begins:.0f} s from now, limit {limit:.0f} s; set the clocks (chronyc tracking)"
    )


def without_absurd_terms(attachment: PositionAttachment, now: Now) -> PositionAttachment:
    """`attachment` without an order, its term, or a vote, of a term that begins more than a day from now.

    Robots relay the order of a dead leader until another leads; its term must not make their messages
    invalid.
    """
    limit = (now.wall + MAX_TERM_OFFSET) * 1e9
    if attachment.order is not None and attachment.order.term > limit:
        attachment = attachment.model_copy(update={"order": None})
    if attachment.term > limit:
        attachment = attachment.model_copy(update={"term": 0})
    return (
        attachment
        if attachment.voted_term <= limit
        else attachment.model_copy(update={"voted_term": 0, "last_ballot": 0})
    )


def check_ballot(ballot: Ballot, candidate: str, mission: Mission, now: Now) -> None:
    """Raise BadMessage for a ballot that `candidate` cannot have sent, or of another mission."""
    check_mission(candidate, ballot.mission, mission.tag)
    check_term(ballot.term, now)
    rank = rank_of(ballot.term)
    if mission.candidates[rank : rank + 1] != (candidate,):
        raise BadMessage(f"ballot of a term that is not {candidate}'s: {ballot.term}")


@dataclass(slots=True, kw_only=True)
class VoterState:
    """A follower's vote; all times are [s, monotonic]."""

    voted_term: int = 0
    """The voted term: orders of earlier terms are refused."""
    last_ballot: int = 0
    """The newest ballot of that term by which it has voted; 0 before the first."""
    refused: int = 0
    """The newest term that it has refused recently; 0 for none."""
    because: Refusal | None = None
    """Why it refused that term."""
    given: int = 0
    """The term that it votes for."""
    renewed: float = float("-inf")
    """When that vote was last renewed."""
    rose: float = float("-inf")
    """When a beat of the voted term last rose here."""
    lived: float = float("-inf")
    """When the voted term last gave a beat or a ballot."""
    commanded: float = float("-inf")
    """When the robot was last received and commanded."""
    alone: float | None = None
    """Since when it is alone with its robot."""
    stepped: float = float("-inf")
    """Newest step."""
    stalled: float = float("-inf")
    """Newest step after a gap over `reach`."""
    refused_at: float = float("-inf")


class Voter:
    """One follower's vote. Without standbys there is no election, and it votes for no term.

    Each step: `aware`, then `receive` for each message, then `commanded` if the robot was received and
    commanded.
    """

    def __init__(self, mission: Mission, *, votes: bool = True) -> None:
        """`votes`: whether the agent commands its robot; one that does not has no vote."""
        self.state = VoterState()
        self._mission, self._votes = mission, votes and bool(mission.standbys)
        self._bound, self._expiry = mission.takeover * VOTE_BOUND_TIME, expiry(mission)
        self._longest_gap, self._reach = longest_gap(mission), reach(mission)
        self._quarantine = quarantine(mission)

    def aware(self, mono: float, *, rival: bool = False) -> None:
        """Begin a step [s, monotonic]; call this before the step's messages are processed.

        `rival`: another agent's sign of life was received since the step before.
        """
        state = self.state
        if rival or mono - state.commanded > self._longest_gap:
            state.alone = None
        if mono - state.stepped > self._reach:
            state.stalled = mono
        if self._longest_gap < mono - state.stepped < float("inf"):
            state.lived += mono - state.stepped  # messages that a frozen process missed were no silence
        state.stepped = mono
        if state.refused and mono - state.refused_at > REPORT_TIME:
            state.refused, state.because = 0, None
        if not state.voted_term:
            return
        if state.lived == float("-inf"):  # restored from the process before it
            state.lived = mono
        if mono - state.lived > self._expiry:
            state.voted_term, state.lived = 0, float("-inf")  # the last ballot stays: no repetition counts

    def commanded(self, mono: float) -> None:
        """Record that the robot was received and commanded in this step [s, monotonic]."""
        self.state.commanded = mono
        if self.state.alone is None:
            self.state.alone = mono

    def receive(self, ballot: Ballot, candidate: str, arrived: float, now: Now) -> None:
        """Vote, renew the vote, or refuse. Raises BadMessage for an invalid ballot of `candidate`."""
        state = self.state
        try:
            check_ballot(ballot, candidate, self._mission, now)
        except BadMessage:
            if ballot.mission == self._mission.tag and ballot.term * 1e-9 - now.wall > MAX_TERM_OFFSET:
                self.refuse(ballot.term, "ahead", arrived)
            raise
        if not self._votes:
            return
        if ballot.candidacy == "leaving":
            self._free(ballot)
        elif ballot.term < state.voted_term:
            self.refuse(ballot.term, "earlier", arrived)
        elif self._may(ballot, arrived):
            state.voted_term, state.last_ballot, state.given = ballot.term, ballot.number, ballot.term
            state.renewed = state.lived = arrived

    def follows(self, term: int, mono: float) -> None:
        """Record that a beat of this term, which was checked, has risen [s, monotonic]."""
        state = self.state
        if not self._votes or term < state.voted_term:
            return
        if term > state.voted_term:
            state.voted_term, state.last_ballot = term, 0
        state.rose = state.lived = mono

    def refuse(self, term: int, because: Refusal, mono: float) -> None:
        """Record that an order or a ballot of this term was refused [s, monotonic]."""
        state = self.state
        if term >= state.refused:
            state.refused, state.because, state.refused_at = term, because, mono

    def _may(self, ballot: Ballot, arrived: float) -> bool:
        state = self.state
        if state.alone is None or arrived - state.alone < self._quarantine:
            return False
        if arrived - state.stalled < self._reach:  # signs of life that waited may arrive after this ballot
            return False
        if ballot.term == state.given:
            return ballot.number > state.last_ballot
        free = arrived - state.renewed >= self._bound
        # if the beat shows that this term is in force, its ballot needs no silence of that beat
        return free and (ballot.term == state.voted_term or arrived - state.rose >= self._bound)

    def _free(self, ballot: Ballot) -> None:
        state = self.state
        if ballot.term == state.voted_term:
            state.rose = float("-inf")
        if ballot.term == state.given:
            state.renewed = float("-inf")
            if ballot.term == state.voted_term:
                # none of its earlier ballots counts any more
                state.last_ballot = max(state.last_ballot, ballot.number)
