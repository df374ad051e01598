"""Who leads: terms, followers' voices, and leases that never overlap.

A candidate asks every follower for its voice in a term, again and again; a follower gives its voice to one
term at a time, and says in its positions to which, and which ballot of it was the newest that it heard. With
the voices of more than half of the followers a candidate leads, for as long as its lease.

**No two lead at once.** Let T be ``mission.takeover``. All times below are of one true time; a process reads
no clock but its own monotonic one, and takes differences of under T, so what is asked of clocks is that they
run equally fast within a tenth. What is asked of processes: one at a time speaks for each candidate.

1. A candidate's voice of robot v counts at a moment m if v echoed a ballot of its term that was sent at
   s > m − 0.5 T. So v heard that ballot at some h with s ≤ h ≤ m, having given its voice to that term.
2. Who leads at m in term t has voices that count of more than half. If two led at m, in terms t ≠ t' (terms
   are unique to a candidate, and a candidate has one at a time), both would have one of the same robot v: it
   heard a ballot of each, at h ≠ h', both after m − 0.5 T and not after m.
3. Between two ballots of different terms to which v gives its voice lie 0.55 T at least, if it heard the
   first of them as the same process (`Voter` refuses), and also if it has been started anew between them and
   has forgotten everything (its first step counts as such a ballot). So |h − h'| ≥ 0.55 T, against 2. Only
   ``leaving`` frees it earlier, and who says that leads no more in that term.

Delay, loss, repetition and reordering of messages do not enter: an old echo only says what was true. Neither
does a frozen process: it looks at its lease, by its clock, before it says anything. What it had said before
may still arrive late; orders of a term below its promise are refused by every robot that has promised.

A beat that rises says that somebody leads in its term, so a robot promises that term and refuses orders of
those before. Its voice it gives by rule 3 alone: the beat may have been long on its way.

**Somebody leads** once more than half of the followers, and one candidate, hear each other: within about T,
for the candidates wait for each other by rank.
"""

from __future__ import annotations

from typing import Literal

from formation.mission import Mission
from formation.order import Ballot
from formation.wire import BadMessage, Now

RENEWED = 0.1
"""A leader renews its lease about so often [s], or [T] where T is under 1 s."""
LEASE = 0.5
"""So long after it was sent a ballot that was echoed counts [T]."""
BOUND = 0.55
"""So long a robot's voice is given to one term [T]."""
SILENCE = 0.6
"""When no echo has risen for so long, nobody leads [T]."""
RANK = 0.1
"""Each candidate waits so much longer than the one before it [T]."""
CAMPAIGN = 0.7
"""A candidate gives up after so long; over BOUND, so that voices that were bound can become free [T]."""
LISTENING = 1.0
"""A leader that starts waits at most so long for robots to tell it how things stand [s]."""
ABSURD = 86_400.0
"""Nobody stands for a term that begins so far from now [s]."""
RANKS = 64
"""Terms of one candidate are this far apart, so that no two ever share one [ns]."""

Standing = Literal["listening", "standby", "candidate", "leader"]


def new_term(rank: int, now: Now, known: int) -> int:
    """A term of the candidate of this rank: its system clock, or a little above every term that is known.

    The little is of its other clock: a process whose system clock was set back, and which hears less than the
    one before it did, must not stand for the same term again.
    """
    base = max(int(now.wall * 1e9), known + 1 + int(now.mono * 1e9) % 10**9)
    return base + (rank - base) % RANKS


def rank_of(term: int) -> int:
    """Whose term it is: index in ``mission.candidates``."""
    return term % RANKS


def check_term(term: int, now: Now) -> None:
    """Raise BadMessage for a term that begins more than a day from now."""
    if term * 1e-9 - now.wall > ABSURD:
        raise BadMessage(f"absurd term: begins {term * 1e-9 - now.wall:.0f} s from now")


def check_ballot(ballot: Ballot, candidate: str, mission: Mission, now: Now) -> None:
    """Raise BadMessage for a ballot that `candidate` cannot have sent."""
    check_term(ballot.term, now)
    rank = rank_of(ballot.term)
    if mission.candidates[rank : rank + 1] != (candidate,):
        raise BadMessage(f"ballot of a term that is not {candidate}'s: {ballot.term}")


class Voter:
    """One follower's voice. Without standbys there is nothing to vote on, and it promises nothing."""

    def __init__(self, mission: Mission) -> None:
        self.promise = 0
        """The newest term that it has promised itself to; orders of earlier ones are refused."""
        self.echo = 0
        """The newest ballot of that term by which it has given its voice; 0 before the first."""
        self._mission, self._votes = mission, bool(mission.standbys)
        self._bound = mission.takeover * BOUND
        self._given = 0  # the term that has its voice, and since when it has not been renewed
        self._renewed: float | None = None  # [s, monotonic]; with its first step it may have forgotten one
        self._rose = float("-inf")  # when a beat of the promised term last rose here [s, monotonic]

    def aware(self, mono: float) -> None:
        """A step is taken [s, monotonic]; to be called before anything is heard in it."""
        if self._renewed is None:
            self._renewed = mono

    def hear(self, ballot: Ballot, candidate: str, arrived: float, now: Now) -> None:
        """Give its voice, renew it, or not. Raises BadMessage for what is no ballot of `candidate`."""
        check_ballot(ballot, candidate, self._mission, now)
        if ballot.standing == "leaving":
            self._free(ballot)
        elif ballot.term >= self.promise and self._may(ballot, arrived):
            self.promise, self.echo, self._given = ballot.term, ballot.number, ballot.term
            self._renewed = arrived

    def follows(self, term: int, mono: float) -> None:
        """A beat of this term, which is known not to be absurd, has risen here [s, monotonic]."""
        if not self._votes or term < self.promise:
            return
        if term > self.promise:
            self.promise, self.echo = term, 0
        self._rose = mono

    def _may(self, ballot: Ballot, arrived: float) -> bool:
        if ballot.term == self._given:
            return ballot.number > self.echo
        free = self._renewed is not None and arrived - self._renewed >= self._bound
        # of a term that is known to be in force by its beat, a ballot needs no silence of that beat
        return free and (ballot.term == self.promise or arrived - self._rose >= self._bound)

    def _free(self, ballot: Ballot) -> None:
        if ballot.term == self.promise:
            self._rose = float("-inf")
        if ballot.term == self._given:
            self._renewed = float("-inf")
            if ballot.term == self.promise:
                self.echo = max(self.echo, ballot.number)  # nothing that it said before counts any more
