"""Leader election: terms, followers' votes, and leases that never overlap.

A candidate asks every follower for its vote in a term, again and again, by ballots; a follower votes for one
term at a time, and its positions say for which, and which ballot of that term was the newest that it heard.
With the votes of more than half of the followers a candidate leads, for as long as its lease.

**No two lead at once.** Let T be ``mission.takeover`` and p the period of the slowest follower. All times
below are of one true time; a process reads no clock but its own monotonic one, and takes differences of
under 2 T, so what is asked of clocks is that they run equally fast within a tenth.

1. A candidate's vote of robot v counts at a moment m if v echoed a ballot of its term that was sent at s > m
   - 0.5 T. So an agent of v heard that ballot at some h with s ≤ h ≤ m, having voted for that term.
2. A candidate that leads at m in term t has votes that count of more than half. If two led at m, in terms t
   ≠ t' (terms are unique to a candidate, and a candidate has one at a time), both would have one of the same
   robot v: a ballot of each was heard, at h ≠ h', both after m - 0.5 T and not after m.
3. Between two ballots of different terms for which *one process* votes lie 0.55 T at least (`Voter`
   refuses). Only ``leaving`` frees it earlier, and the candidate that says it leads no more in that term.
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
other agent within D of when it was sent or, if that agent was frozen, of when it goes on; links with the
robot may break, one at a time. The network between robots may be cut, late or lossy: it does not enter. (b)
An agent that sends its robot nothing (``--readonly``) does not vote. (c) Agents do not lie: a robot's
certificate that votes in two terms at once has two leaders elected where its vote decides. (d) One process
at a time for each candidate.

*What no rule can give:* two agents of one name on two robots, in two halves of a cut network. Each half sees
one healthy agent, as after a restart. Where a candidate hears both, `Candidacy` counts neither: a robot's
vote counts only 0.55 T after its publisher changed, so two that alternate never count.

Delay, loss, repetition and reordering of messages between robots do not enter: an old echo only says what
was true. Neither does a frozen process: it looks at its lease, by its clock, before it says anything.

**Terms only order leaders**; nothing above needs them to rise. A beat that rises says that a leader lives in
its term, so a robot promises that term and refuses orders of those before. It votes by rules 3 and 4 alone:
the beat may have been long on its way.

**No robot is held for ever by a term.** Robots forget a term that has been silent (neither beat nor ballot)
for `EXPIRY`. A candidate never draws a term over half a day ahead of its clock, and robots
refuse what is over a day ahead of theirs. So where clocks agree within half a day, whatever terms were
believed before (by a wrong clock, by a lie), a term that a candidate draws is accepted `EXPIRY` after the
others fell silent.

**A leader is found** once more than half of the followers, and one candidate, hear each other: within about
T for robots that have been alone for Q, for the candidates wait for each other by rank.
"""

from __future__ import annotations

from typing import Literal

from formation.mission import Mission
from formation.neighbour import FRESH_PERIODS
from formation.order import Ballot, Refusal, Told, check_mission
from formation.wire import BadMessage, Now

RENEWED = 0.1
"""A leader renews its lease about so often [s], or [T] where T is under 1 s."""
LEASE = 0.5
"""So long after it was sent a ballot that was echoed counts [T]."""
BOUND = 0.55
"""So long a robot's vote is bound to one term, and a new publisher of a robot does not count [T]."""
GAP = 0.4
"""An agent that has not commanded its robot for longer is not alone with it; at least 3 periods [T]."""
REACH = 0.1
"""A sign of life reaches another agent of the same robot within this; at least 2 periods [T]."""
SILENCE = 0.6
"""When no echo has risen for so long, nobody leads [T]."""
RANK = 0.1
"""Each candidate waits so much longer than the one before it [T]."""
CAMPAIGN = 0.7
"""A candidate gives up after so long; over BOUND, so that votes that were bound can become free [T]."""
LISTENING = 1.0
"""A leader that starts waits at most so long for robots to tell it how things stand [s]."""
ABSURD = 86_400.0
"""A term that begins so far from now is refused [s]."""
FURTHEST = 43_200.0
"""A candidate draws no term so far ahead of its clock [s]: clocks that differ by as much accept it."""
EXPIRY = 5.0
"""Robots forget a term without beat or ballot for so long [s]; in units of T where T is over 1 s."""
TOLD_FOR = 2.0
"""A robot tells for so long that it has refused a term [s]."""
RANKS = 64
"""Terms of one candidate are this far apart, so that no two ever share one [ns]."""

Standing = Literal["listening", "standby", "candidate", "leader"]


def new_term(rank: int, now: Now, known: int) -> int:
    """A term of the candidate of this rank: its system clock, or a little above every term that is known.

    The little is of its other clock: a process whose system clock was set back, and which hears less than the
    one before it did, must not stand for the same term again. A known term too far ahead does not count:
    above it others would refuse ours, and it is forgotten once it is silent.
    """
    base = int(now.wall * 1e9)
    if not too_far(known, now):
        base = max(base, known + 1 + int(now.mono * 1e9) % 10**9)
    return base + (rank - base) % RANKS


def too_far(term: int, now: Now) -> bool:
    """Whether a term is so far ahead of this clock that a candidate neither draws nor keeps it."""
    return term * 1e-9 - now.wall > FURTHEST


def expiry(mission: Mission) -> float:
    """Silence of a term after which robots forget it [s]."""
    return EXPIRY * max(1.0, mission.takeover)


def longest_gap(mission: Mission) -> float:
    """G: time without a command after which an agent is not alone with its robot [s]."""
    return max(mission.takeover * GAP, FRESH_PERIODS * _slowest_period(mission))


def reach(mission: Mission) -> float:
    """D: a sign of life reaches another agent of the same robot within this [s]."""
    return max(mission.takeover * REACH, 2.0 * _slowest_period(mission))


def quarantine(mission: Mission) -> float:
    """Q: an agent votes after it has been alone with its robot for so long [s]."""
    return mission.takeover * BOUND + longest_gap(mission) + reach(mission)


def _slowest_period(mission: Mission) -> float:
    return max(1.0 / mission.robots[name].rate for name in mission.followers)


def rank_of(term: int) -> int:
    """Whose term it is: index in ``mission.candidates``."""
    return term % RANKS


def check_term(term: int, now: Now) -> None:
    """Raise BadMessage for a term that begins more than a day from now."""
    if term * 1e-9 - now.wall > ABSURD:
        raise BadMessage(f"absurd term: begins {term * 1e-9 - now.wall:.0f} s from now")


def without_absurd_terms(told: Told, now: Now) -> Told:
    """`told` without an order, or a promise, of a term that begins more than a day from now.

    Robots relay the order of a leader that died until another leads; its term must not make them unheard.
    """
    limit = (now.wall + ABSURD) * 1e9
    if told.order is not None and told.order.term > limit:
        told = told.model_copy(update={"order": None})
    return told if told.promise <= limit else told.model_copy(update={"promise": 0, "echo": 0})


def check_ballot(ballot: Ballot, candidate: str, mission: Mission, now: Now) -> None:
    """Raise BadMessage for a ballot that `candidate` cannot have sent, or of another mission."""
    check_mission(candidate, ballot.mission, mission.tag)
    check_term(ballot.term, now)
    rank = rank_of(ballot.term)
    if mission.candidates[rank : rank + 1] != (candidate,):
        raise BadMessage(f"ballot of a term that is not {candidate}'s: {ballot.term}")


class Voter:
    """One follower's vote. Without standbys there is nothing to vote on, and it promises nothing.

    Each step: `aware`, then `hear` what has arrived, then `commanded` if the robot was heard and commanded.
    """

    def __init__(self, mission: Mission, *, votes: bool = True) -> None:
        """`votes`: whether the agent commands its robot; one that does not has no vote."""
        self.promise = 0
        """The newest term that it has promised itself to; orders of earlier ones are refused."""
        self.echo = 0
        """The newest ballot of that term by which it has voted; 0 before the first."""
        self.refused = 0
        """The newest term that it has refused lately; 0 for none."""
        self.because: Refusal | None = None
        """Why it has."""
        self._mission, self._votes = mission, votes and bool(mission.standbys)
        self._bound, self._expiry = mission.takeover * BOUND, expiry(mission)
        self._longest_gap, self._reach = longest_gap(mission), reach(mission)
        self._quarantine = quarantine(mission)
        self._given = 0  # the term that it votes for, and since when that has not been renewed
        self._renewed = float("-inf")  # [s, monotonic]
        self._rose = float("-inf")  # when a beat of the promised term last rose here [s, monotonic]
        self._lived = float("-inf")  # when the promised term last gave a beat or a ballot [s, monotonic]
        self._commanded = float("-inf")  # when the robot was last heard and commanded [s, monotonic]
        self._alone: float | None = None  # since when it is alone with its robot [s, monotonic]
        self._stepped = float("-inf")  # newest step,
        self._stalled = float("-inf")  # and newest step after a gap over `_reach` [s, monotonic]
        self._refused_at = float("-inf")  # [s, monotonic]

    def aware(self, mono: float, *, rival: bool = False) -> None:
        """A step is taken [s, monotonic]; to be called before anything is heard in it.

        `rival`: another agent's sign of life was received since the step before.
        """
        if rival or mono - self._commanded > self._longest_gap:
            self._alone = None
        if mono - self._stepped > self._reach:
            self._stalled = mono
        if self._longest_gap < mono - self._stepped < float("inf"):
            self._lived += mono - self._stepped  # what a frozen process did not hear was no silence
        self._stepped = mono
        if self.refused and mono - self._refused_at > TOLD_FOR:
            self.refused, self.because = 0, None
        if not self.promise:
            return
        if self._lived == float("-inf"):  # taken over from the process before it
            self._lived = mono
        if mono - self._lived > self._expiry:
            self.promise, self._lived = 0, float("-inf")  # what was echoed stays: its repetition is refused

    def commanded(self, mono: float) -> None:
        """The robot was heard, and commanded, in this step [s, monotonic]."""
        self._commanded = mono
        if self._alone is None:
            self._alone = mono

    def hear(self, ballot: Ballot, candidate: str, arrived: float, now: Now) -> None:
        """Vote, renew it, or not. Raises BadMessage for what is no ballot of `candidate`."""
        try:
            check_ballot(ballot, candidate, self._mission, now)
        except BadMessage:
            if ballot.mission == self._mission.tag and ballot.term * 1e-9 - now.wall > ABSURD:
                self.refuse(ballot.term, "ahead", arrived)
            raise
        if not self._votes:
            return
        if ballot.standing == "leaving":
            self._free(ballot)
        elif ballot.term < self.promise:
            self.refuse(ballot.term, "earlier", arrived)
        elif self._may(ballot, arrived):
            self.promise, self.echo, self._given = ballot.term, ballot.number, ballot.term
            self._renewed = self._lived = arrived

    def follows(self, term: int, mono: float) -> None:
        """A beat of this term, which is known not to be absurd, has risen here [s, monotonic]."""
        if not self._votes or term < self.promise:
            return
        if term > self.promise:
            self.promise, self.echo = term, 0
        self._rose = self._lived = mono

    def refuse(self, term: int, because: Refusal, mono: float) -> None:
        """An order or a ballot of this term was refused [s, monotonic]; the newest such term is told."""
        if term >= self.refused:
            self.refused, self.because, self._refused_at = term, because, mono

    def _may(self, ballot: Ballot, arrived: float) -> bool:
        if self._alone is None or arrived - self._alone < self._quarantine:
            return False
        if arrived - self._stalled < self._reach:  # signs of life that waited may come after this ballot
            return False
        if ballot.term == self._given:
            return ballot.number > self.echo
        free = arrived - self._renewed >= self._bound
        # of a term that is known to be in force by its beat, a ballot needs no silence of that beat
        return free and (ballot.term == self.promise or arrived - self._rose >= self._bound)

    def _free(self, ballot: Ballot) -> None:
        if ballot.term == self.promise:
            self._rose = float("-inf")
        if ballot.term == self._given:
            self._renewed = float("-inf")
            if ballot.term == self.promise:
                self.echo = max(self.echo, ballot.number)  # nothing that it said before counts any more
