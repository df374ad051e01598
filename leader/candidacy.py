"""One candidate's standing: whether it leads, and the ballots by which it comes to that and stays.

What makes sure that no two lead at once stands in `formation.election`.
"""

from __future__ import annotations

from typing import NamedTuple

from formation.election import (
    BOUND,
    CAMPAIGN,
    LEASE,
    LISTENING,
    RANK,
    RENEWED,
    SILENCE,
    TOLD_FOR,
    Standing,
    check_ballot,
    check_term,
    new_term,
    quarantine,
    too_far,
)
from formation.lateness import MAX_BEAT_LATENESS, Count, counted
from formation.mission import Mission
from formation.order import LEADER_LOST, Ballot, Order, Refusal, Told, check_mission
from formation.wire import BadMessage, Now


class Publisher(NamedTuple):
    """The process that sends a robot's positions."""

    id: str
    number: int
    """Of its newest position."""
    since: float
    """When it was first heard, or heard again after another one [s, monotonic]."""


class Candidacy:
    """One candidate's standing. Each step: `hear` what has arrived, then `step`, and only then speak."""

    def __init__(self, mission: Mission, name: str, known: int = 0) -> None:
        """`known`: the newest term that the process before it knew. ValueError for no candidate."""
        if name not in mission.candidates:
            legal = ", ".join(mission.candidates)
            raise ValueError(f"candidate {name!r}: must be one of {legal}")
        self.standing: Standing = "listening"
        self.term = 0
        """The newest term that it stood for; 0 before the first."""
        self.known = known
        """The highest term that it has heard of."""
        self._publishers: dict[str, Publisher] = {}  # of each robot's positions
        self._refusals: dict[str, tuple[int, Refusal, float]] = {}  # which term each robot refuses, and when
        self._mission, self._rank = mission, mission.candidates.index(name)
        self._votes = bool(mission.standbys)
        self._majority = len(mission.followers) // 2 + 1
        self._awaited = linked(mission)
        self._quarantine = quarantine(mission)
        self._period = RENEWED * min(1.0, mission.takeover)
        self._began: float | None = None
        self._led = False  # whether a term was heard of, so that the team is not just being started
        self._listened = float("inf")  # until when it listened before it stood by
        self._risen = float("-inf")  # when there was last a sign of somebody who leads or stands
        self._left = 0  # the newest term that has been left: its echoes are no such sign
        self._turn = self._rank  # how many wait for less long than it does
        self._heard: dict[str, float] = {}  # when each robot was
        self._echoes: dict[str, tuple[int, int]] = {}  # its highest promise and echo
        self._relays: dict[str, tuple[int, int]] = {}  # term and beat that each robot relays
        self._beat = 0, 0  # the newest that has risen at one of them
        self._later = False  # whether a beat of a later term than its own has risen
        self._beats: Count | None = None
        self._beat_period = 1.0 / mission.robots[mission.leader].rate
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
        """Learn from what came with a follower's position.

        Raises BadMessage for an absurd term, another mission, and what its publisher has said before.
        """
        check_mission(robot, told.mission, self._mission.tag)
        check_term(max(told.promise, told.order.term if told.order else 0), now)
        counts = self._publisher(robot, told, arrived)
        if told.because is not None:
            self._refusals[robot] = told.refused, told.because, arrived
            if not self._votes and told.refused == self.term and told.because == "earlier":
                self._outbid = arrived if self._outbid is None else self._outbid
        if self._votes and counts:
            self._count(robot, told, arrived)
        if told.order is not None:
            self._relayed(robot, told.order, arrived)
        self.known = max(self.known, told.promise)
        self._led = self._led or bool(told.promise or told.order)
        self._heard[robot] = arrived

    def hear_ballot(self, ballot: Ballot, other: str, arrived: float, now: Now) -> None:
        """Learn from another candidate's ballot. Raises BadMessage for what is no ballot of `other`."""
        check_ballot(ballot, other, self._mission, now)
        if ballot.standing != "leaving":
            self._risen = max(self._risen, arrived)
        elif ballot.term >= self.known:  # nobody leads, and everybody is free
            self._risen, self._left = arrived - self._in_takeovers(SILENCE), ballot.term
        self.known, self._led = max(self.known, ballot.term), True

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
        elif self.leading and (
            (self._outbid is not None and self._over(self._outbid, SILENCE, now))
            or (too_far(self.term, now) and "ahead" in self.refusals(now.mono).values())
        ):
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

    def refusals(self, mono: float) -> dict[str, Refusal]:
        """Robots that lately refused the term that it stands for or leads in, and why [s, monotonic]."""
        return {
            robot: because
            for robot, (term, because, when) in self._refusals.items()
            if term == self.term and mono - when <= TOLD_FOR
        }

    def _publisher(self, robot: str, told: Told, arrived: float) -> bool:
        """Whether the publisher's votes for its robot count: none does just after it changed."""
        known = self._publishers.get(robot)
        if known is None or known.id != told.voice:
            known = Publisher(told.voice, told.count, arrived)
            self._voices.pop(robot, None)
            self._echoes.pop(robot, None)
            self._relays.pop(robot, None)
        elif told.count <= known.number:
            raise BadMessage(f"said before: position {told.count} of {robot}, now at {known.number}")
        self._publishers[robot] = known._replace(number=told.count)
        return arrived - known.since >= self._in_takeovers(BOUND)

    def _count(self, robot: str, told: Told, arrived: float) -> None:
        seen, before = (told.promise, told.echo), self._echoes.get(robot)
        # the first proves nothing: a robot repeats the echo of a leader that died
        risen = before is not None and (told.promise != before[0] or told.echo > before[1])
        if before is None or seen != before:
            self._echoes[robot] = seen
            if risen and told.promise not in {0, self._left}:
                self._risen = max(self._risen, arrived)
                self._turn = self._turn if told.promise == self.term else self._rank
        sent = self._sent.get(told.echo) if told.promise == self.term else None
        if sent is not None:
            self._voices[robot] = max(sent, self._voices.get(robot, sent))
        if told.promise > self.term and self._outbid is None:
            self._outbid = arrived

    def _relayed(self, robot: str, order: Order, arrived: float) -> None:
        """A beat that rises at a robot, and is not its own, is a sign of another leader."""
        self.known = max(self.known, order.term)
        beat, before = (order.term, order.beat), self._relays.get(robot)
        self._relays[robot] = beat
        if before in {None, beat} or order.term == self._left:
            return  # the first proves nothing: robots go on relaying the order of a leader that died
        if order.term == self._beat[0] and beat <= self._beat:
            return  # it has been known from a robot that is nearer to that leader
        if not self._in_time(order, arrived):
            return
        self._beat = beat
        if not (self.leading and order.term == self.term):
            self._risen = max(self._risen, arrived)
        self._later = self._later or order.term > self.term

    def _in_time(self, order: Order, arrived: float) -> bool:
        """Whether a beat is not much later than the quickest of its term: else its leader may be dead."""
        if self._beats is not None and order.term < self._beats.term:
            return True
        stamp = order.beat * self._beat_period
        self._beats, late = counted(self._beats, order.term, stamp, arrived, MAX_BEAT_LATENESS)
        return late <= MAX_BEAT_LATENESS

    def _listen(self, now: Now) -> None:
        if self.standing != "listening":
            return
        begun = now.mono if self._began is None else self._began
        if self._awaited <= self._heard.keys() or now.mono - begun >= LISTENING:
            self.standing, self._listened = "standby", now.mono

    def _lead_alone(self, now: Now) -> None:
        """Without voters: it leads, unless a leader of a later term lives."""
        if self.leading and (self._later or self._outbid is not None):
            self.standing, self._risen = "standby", now.mono
        first = self.standing == "standby" and self.term == 0
        silent = self.standing == "standby" and now.mono - self._risen > LEADER_LOST
        if first or silent or (self.leading and too_far(self.term, now)):  # its clock has been set since
            self._left, self.standing = self.term, "leader"
            self.term = self.known = new_term(self._rank, now, self.known)
            self._outbid, self._later = None, False

    def _campaign(self, now: Now) -> None:
        if now.mono < self._lease:
            self.standing, self._turn = "leader", self._rank
        elif self.known > self.term:
            self._stand_by(self._rank)
        elif self._over(self._stood, CAMPAIGN, now):  # whom it cannot reach, another may
            self._risen = now.mono  # the others have heard it until now, and are to wait for less long
            self._stand_by(self._rank + len(self._mission.candidates))

    def _stand(self, now: Now) -> None:
        """For a new term, if enough robots are heard whose agents may vote by now."""
        lately = [robot for robot, arrived in self._heard.items() if not self._over(arrived, SILENCE, now)]
        known = [now.mono - self._publishers[robot].since for robot in lately]
        if sum(since >= self._quarantine for since in known) < self._majority:
            self._listened = now.mono + self._in_takeovers(RANK * (1 - self._turn))  # to look again soon
            return
        self._begin(now)

    def _begin(self, now: Now) -> None:
        """Stand for a new term."""
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
        return Ballot(term=self.term, number=self._number, standing=standing, mission=self._mission.tag)

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
        if not self._led and self._rank:
            # the leader itself leads a team that has just been started, if it is there
            quiet += LISTENING + self._quarantine
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
