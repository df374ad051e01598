"""Who led when, by what a recording has of leaders' words; and whether there were ever two at once.

Who leads says so with every position on the leader's key, by the term of its order and by its voice, and,
where there are standbys, with every ballot. One that does not lead says neither. Pure: messages in, reigns
out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, NamedTuple

from formation import order
from formation.mission import Mission
from formation.order import Ballot, Told
from formation.ros2.messages import Pose, Text, decode
from formation.topics import BALLOT, POSITION
from formation.wire import BadMessage, Sample
from monitor.figures.terms import leader_of
from monitor.recording.reader import Recorded

MOST = 2000
"""Reigns that are told apart; whoever sends rubbish could make up any number."""
Clock = Literal["said", "heard"]


class Span(NamedTuple):
    """From one moment to another [s]."""

    begin: float
    end: float


NEVER = Span(math.inf, -math.inf)


@dataclass(slots=True)
class Reign:
    """One process that led in one term."""

    name: str
    """Of the candidate; empty for one that the mission does not know."""
    term: int
    voice: str
    """Another one each time that a process begins to lead; empty while only its ballots were heard."""
    said: Span = NEVER
    """From the first of its positions to the last, by their stamps: its own system clock."""
    heard: Span = NEVER
    """From the first of its positions and ballots to the last, by the recorder's clock."""
    positions: int = 0
    ballots: int = 0

    def span(self, clock: Clock) -> Span:
        """By one clock or the other."""
        return self.said if clock == "said" else self.heard


class Overlap(NamedTuple):
    """Two that led at once."""

    former: Reign
    latter: Reign
    span: Span


class Reigns:
    """Collects who leads. Take a recording's messages in their order."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._reigns: dict[tuple[int, str], Reign] = {}
        self._leads = POSITION.key(mission.leader)
        self._ballots = {BALLOT.key(name) for name in mission.candidates} if mission.standbys else set()
        self._voices: dict[int, str] = {}  # the newest of each term

    @property
    def all(self) -> list[Reign]:
        """In the order in which they began."""
        return sorted(self._reigns.values(), key=lambda one: (one.heard.begin, one.term))

    def take(self, sample: Sample, wall: float) -> None:
        """Take one message, which arrived at `wall` [s, the recorder's clock]."""
        try:
            if sample.key == self._leads and sample.attachment is not None:
                self._take_position(sample.payload, sample.attachment, wall)
            elif sample.key in self._ballots:
                self._take_ballot(sample.payload, wall)
        except BadMessage:
            return  # the monitor has told of it

    def _take_position(self, payload: bytes, attachment: bytes, wall: float) -> None:
        told = order.decode(Told, attachment)
        if told.order is None:
            return
        stamp = decode(Pose, payload).stamp
        self._voices[told.order.term] = told.voice
        reign = self._reign(told.order.term, told.voice)
        reign.said, reign.heard = _widened(reign.said, stamp), _widened(reign.heard, wall)
        reign.positions += 1

    def _take_ballot(self, payload: bytes, wall: float) -> None:
        ballot = order.decode(Ballot, decode(Text, payload).text.encode())
        if ballot.standing != "leader":
            return
        reign = self._reign(ballot.term, self._voices.get(ballot.term, ""))
        reign.heard = _widened(reign.heard, wall)
        reign.ballots += 1

    def _reign(self, term: int, voice: str) -> Reign:
        nameless = self._reigns.pop((term, ""), None)
        if nameless is not None:  # so far only its ballots were heard
            nameless.voice = voice
            self._reigns[term, voice] = nameless
        if (term, voice) not in self._reigns:
            if len(self._reigns) >= MOST:
                raise BadMessage("too many leaders")
            self._reigns[term, voice] = Reign(leader_of(self._mission, term), term, voice)
        return self._reigns[term, voice]


def who_led(mission: Mission, messages: Iterable[Recorded]) -> list[Reign]:
    """Everybody who led in a recording, in the order in which they began."""
    one = Reigns(mission)
    for message in messages:
        one.take(message.sample, message.wall)
    return one.all


def at(reigns: Sequence[Reign], moment: float, clock: Clock = "said") -> list[Reign]:
    """Who led at `moment` [s, of that clock]: nobody, one, or more than there may be."""
    return [one for one in reigns if one.span(clock).begin <= moment <= one.span(clock).end]


def overlaps(reigns: Sequence[Reign], clock: Clock = "said") -> list[Overlap]:
    """Every two that led at once.

    By stamps, on machines with one clock, that is exact; on the recorder's clock a word that was long on its
    way may seem to come after another's first.
    """
    found = []
    for one, other in combinations(sorted(reigns, key=lambda one: one.span(clock).begin), 2):
        begin = max(one.span(clock).begin, other.span(clock).begin)
        end = min(one.span(clock).end, other.span(clock).end)
        if begin <= end:
            found.append(Overlap(one, other, Span(begin, end)))
    return found


def gaps(reigns: Sequence[Reign], clock: Clock = "said") -> Iterator[Span]:
    """When nobody led, between the first word of all and the last."""
    until = math.nan
    for one in sorted(reigns, key=lambda one: one.span(clock).begin):
        begin, end = one.span(clock)
        if end < begin:
            continue  # of whom that clock knows nothing
        if begin > until:
            yield Span(until, begin)
        until = end if math.isnan(until) else max(until, end)


def _widened(span: Span, moment: float) -> Span:
    return Span(min(span.begin, moment), max(span.end, moment))
