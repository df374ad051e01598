"""One candidate's standing: whether it leads, and the ballots by which it comes to that and stays.

What makes sure that no two lead at once stands in `formation.election`.
"""

from __future__ import annotations

from formation.election import (
    CAMPAIGN,
    LEASE,
    LISTENING,
    RANK,
    RENEWED,
    SILENCE,
    Standing,
    check_ballot,
    check_term,
    new_term,
)
from formation.mission import Mission
from formation.order import LEADER_LOST, Ballot, Order, Told
from formation.wire import Now


class Candidacy:
    """One candidate's standing. Each step: `hear` what has arrived, then `step`, and only then speak."""

    def __init__(self, mission: Mission, name: str) -> None:
        """Raises ValueError for who is no candidate of the mission."""
        if name not in mission.candidates:
            legal = ", ".join(mission.candidates)
            raise ValueError(f"candidate {name!r}: must be one of {legal}")
        self.standing: Standing = "listening"
        self.term = 0
        """The newest term that it stood for; 0 before the first."""
        self.known = 0
        """The highest term that it has heard of."""
        self._mission, self._rank = mission, mission.candidates.index(name)
        self._votes = bool(mission.standbys)
        self._majority = len(mission.followers) // 2 + 1
        self._awaited = linked(mission)
        self._period = RENEWED * min(1.0, mission.takeover)
        self._began: float | None = None
        self._listened = float("inf")  # until when it listened before it stood by
        self._risen = float("-inf")  # when there was last a sign of somebody who leads or stands
        self._left = 0  # the newest term that has been left: its echoes are no such sign
        self._turn = self._rank  # how many wait for less long than it does
        self._heard: dict[str, float] = {}  # when each robot was
        self._echoes: dict[str, tuple[int, int]] = {}  # its highest promise and echo
        self._beat = 0, 0  # highest term and beat that were relayed
        self._outbid: float | None = (
            None  # since when a robot is known to have promised itself to a later term
        )
        self._sent: dict[int, float] = {}  # when each ballot of this term was; those that still count
        self._voices: dict[str, float] = {}  # when the newest ballot that a robot has echoed was sent
        self._number = 0
        self._next = self._stood = 0.0

    @property
    def leading(self) -> bool:
        """Whether it led when it took its newest step, and may speak in it."""
        return self.standing == "leader"

    @property
    def due(self) -> float:
        """When a step is wanted though nothing arrives [s, monotonic]."""
        if self._began is None:
            return float("-inf")
        if self.standing == "listening":
            return self._began + LISTENING
        if not self._votes:
            return float("inf") if self.leading else self._risen + LEADER_LOST
        if self.standing == "standby":
            return self._stands_at
        return min(self._next, self._ends_at)

    def hear(self, robot: str, told: Told, arrived: float, now: Now) -> None:
        """Learn from what came with a follower's position. Raises BadMessage for an absurd term."""
        check_term(max(told.promise, told.order.term if told.order else 0), now)
        if self._votes:
            self._count(robot, told, arrived)
        if told.order is not None:
            self._relayed(told.order, arrived)
        self.known = max(self.known, told.promise)
        self._heard[robot] = arrived

    def hear_ballot(self, ballot: Ballot, other: str, arrived: float, now: Now) -> None:
        """Learn from another candidate's ballot. Raises BadMessage for what is no ballot of `other`."""
        check_ballot(ballot, other, self._mission, now)
        if ballot.standing != "leaving":
            self._risen = max(self._risen, arrived)
        elif ballot.term >= self.known:  # nobody leads, and everybody is free
            self._risen, self._left = arrived - self._in_takeovers(SILENCE), ballot.term
        self.known = max(self.known, ballot.term)

    def step(self, now: Now) -> Ballot | None:
        """How it stands from now on, and what it is to tell everybody of that."""
        if self._began is None:
            self._began = self._risen = now.mono
        self._listen(now)
        if not self._votes:
            self._lead_alone(now)
            return None
        if self.leading and now.mono >= self._ends_at:
            self._stand_by(self._rank)
        elif self.leading and self._outbid is not None and self._over(self._outbid, SILENCE, now):
            self._risen, self._turn = now.mono - self._in_takeovers(SILENCE), 0  # to stand anew at once
            return self.leave(now)
        elif self.standing == "candidate":
            self._campaign(now)
        elif self.standing == "standby" and now.mono >= self._stands_at:
            self._stand(now)
        if self.standing not in {"candidate", "leader"} or now.mono < self._next:
            return None
        self._next = now.mono + self._period
        return self._ballot(now)

    def leave(self, now: Now) -> Ballot | None:
        """Give up what it stands for; everybody is to know of it at once."""
        if self.standing not in {"candidate", "leader"}:
            return None
        self.standing, self._left = "standby", self.term
        return self._ballot(now) if self._votes else None

    def _count(self, robot: str, told: Told, arrived: float) -> None:
        seen, before = (told.promise, told.echo), self._echoes.get(robot)
        if before is None or seen > before:
            self._echoes[robot] = seen
            # the first proves nothing: a robot repeats the echo of a leader that died
            if before is not None and told.promise > self._left:
                self._risen = max(self._risen, arrived)
                self._turn = self._turn if told.promise == self.term else self._rank
        sent = self._sent.get(told.echo) if told.promise == self.term else None
        if sent is not None:
            self._voices[robot] = max(sent, self._voices.get(robot, sent))
        if told.promise > self.term and self._outbid is None:
            self._outbid = arrived

    def _relayed(self, order: Order, arrived: float) -> None:
        """A beat that rises, which is not its own, is a sign of another leader."""
        self.known = max(self.known, order.term)
        if (order.term, order.beat) > self._beat:
            self._beat = order.term, order.beat
            if order.term > self._left and not (self.leading and order.term == self.term):
                self._risen = max(self._risen, arrived)

    def _listen(self, now: Now) -> None:
        if self.standing != "listening":
            return
        begun = now.mono if self._began is None else self._began
        if self._awaited <= self._heard.keys() or now.mono - begun >= LISTENING:
            self.standing, self._listened = "standby", now.mono

    def _lead_alone(self, now: Now) -> None:
        """Without voters: it leads, unless somebody of a later term does."""
        if self.leading and self._beat[0] > self.term:
            self.standing, self._risen = "standby", now.mono
        first = self.standing == "standby" and self.term == 0
        silent = now.mono - self._risen > LEADER_LOST
        if self.standing == "standby" and (first or silent):
            self.term, self.standing = new_term(self._rank, now, self.known), "leader"

    def _campaign(self, now: Now) -> None:
        if now.mono < self._lease:
            self.standing, self._turn = "leader", self._rank
        elif self.known > self.term:
            self._stand_by(self._rank)
        elif self._over(self._stood, CAMPAIGN, now):  # whom it cannot reach, another may
            self._risen = now.mono  # the others have heard it until now, and are to wait for less long
            self._stand_by(self._rank + len(self._mission.candidates))

    def _stand(self, now: Now) -> None:
        """For a new term, if robots enough are heard that could give it their voices."""
        lately = sum(not self._over(arrived, SILENCE, now) for arrived in self._heard.values())
        if lately < self._majority:
            self._listened = now.mono + self._in_takeovers(RANK * (1 - self._turn))  # to look again soon
            return
        self.standing, self.term = "candidate", new_term(self._rank, now, self.known)
        self.known, self._stood, self._next, self._outbid = self.term, now.mono, now.mono, None
        self._sent.clear()
        self._voices.clear()

    def _stand_by(self, turn: int) -> None:
        self.standing, self._turn = "standby", turn

    def _ballot(self, now: Now) -> Ballot:
        """The next one. Numbers are moments, so that of two processes in a row none counts as the other's."""
        self._number = max(self._number + 1, int(now.mono * 1e6))
        counting = now.mono - self._in_takeovers(LEASE)
        self._sent = {number: sent for number, sent in self._sent.items() if sent > counting}
        self._sent[self._number] = now.mono
        standing = self.standing if self.standing in {"candidate", "leader"} else "leaving"
        return Ballot(term=self.term, number=self._number, standing=standing)

    @property
    def _lease(self) -> float:
        """Until when more than half of the followers' voices count [s, monotonic]."""
        if len(self._voices) < self._majority:
            return float("-inf")
        newest = sorted(self._voices.values(), reverse=True)
        return newest[self._majority - 1] + self._in_takeovers(LEASE)

    @property
    def _ends_at(self) -> float:
        """When its standing ends if it hears nothing."""
        return self._lease if self.leading else self._stood + self._in_takeovers(CAMPAIGN)

    @property
    def _stands_at(self) -> float:
        """When a standby stands, if nothing else happens."""
        quiet = max(self._risen + self._in_takeovers(SILENCE), self._listened)
        if not self.known and self._rank:
            quiet += LISTENING  # of a team that has just been started the leader itself leads, if it is there
        return quiet + self._in_takeovers(RANK * self._turn)

    def _in_takeovers(self, share: float) -> float:
        return share * self._mission.takeover

    def _over(self, since: float, share: float, now: Now) -> bool:
        return now.mono - since >= self._in_takeovers(share)


def linked(mission: Mission) -> frozenset[str]:
    """The followers that a candidate hears: all where there are standbys, else those that may measure it."""
    return frozenset(
        name
        for name in mission.followers
        if mission.standbys or mission.leader in mission.robots[name].measurable
    )
