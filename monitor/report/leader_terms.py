"""Leader terms from the messages in a recording, and whether two leaders ever overlapped.

A leader identifies itself with every position on the leader's key, by its order's term and its publisher id,
and, if there are standbys, with every ballot. A candidate that does not lead sends neither. Pure: messages
in, leader terms out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

from formation.mission.model import Mission
from formation.monitor.metrics.orders import leader_of
from formation.protocol import json_message
from formation.protocol.attachment import Ballot, PositionAttachment
from formation.ros2.messages import Pose, Text, decode
from formation.topics import BALLOT, POSITION
from formation.wire import BadMessage, Sample

MAX_TERMS = 2000
"""Largest number of leader terms kept; a faulty sender could cause any number."""


class Span(NamedTuple):
    """A time span [s]."""

    begin: float
    end: float


NEVER = Span(math.inf, -math.inf)


@dataclass(slots=True)
class LeaderTerm:
    """One process leading in one term."""

    name: str
    """Name of the candidate; empty if it is not in the mission."""
    term: int
    publisher_id: str
    """Publisher id, new each time that a process begins to lead; empty while only ballots were received."""
    published: Span = NEVER
    """From the first of its positions to the last, by their stamps: its own system clock."""
    received: Span = NEVER
    """From the first of its positions and ballots to the last, by the recorder's clock."""
    positions: int = 0
    ballots: int = 0


class Overlap(NamedTuple):
    """Two overlapping leaders."""

    former: LeaderTerm
    latter: LeaderTerm
    span: Span


class LeaderTerms:
    """Collect the leader terms. Call `process_sample` with a recording's messages in order."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._leader_terms: dict[tuple[int, str], LeaderTerm] = {}
        self._leads = POSITION.key(mission.leader)
        self._ballots = {BALLOT.key(name) for name in mission.candidates} if mission.standbys else set()
        self._publisher_ids: dict[int, str] = {}  # the newest of each term

    @property
    def all(self) -> list[LeaderTerm]:
        """Return all, in the order in which they began."""
        return sorted(self._leader_terms.values(), key=lambda one: (one.received.begin, one.term))

    def process_sample(self, sample: Sample, wall: float) -> None:
        """Take one message, which arrived at `wall` [s, the recorder's clock]."""
        try:
            if sample.key == self._leads and sample.attachment is not None:
                self._take_position(sample.payload, sample.attachment, wall)
            elif sample.key in self._ballots:
                self._take_ballot(sample.payload, wall)
        except BadMessage:
            return  # the monitor has reported it

    def _take_position(self, payload: bytes, attachment: bytes, wall: float) -> None:
        decoded = json_message.decode(PositionAttachment, attachment)
        if decoded.order is None:
            return
        stamp = decode(Pose, payload).stamp
        self._publisher_ids[decoded.order.term] = decoded.publisher_id
        leader_term = self._leader_term(decoded.order.term, decoded.publisher_id)
        leader_term.published = _widened(leader_term.published, stamp)
        leader_term.received = _widened(leader_term.received, wall)
        leader_term.positions += 1

    def _take_ballot(self, payload: bytes, wall: float) -> None:
        ballot = json_message.decode(Ballot, decode(Text, payload).text.encode())
        if ballot.candidacy != "leader":
            return
        leader_term = self._leader_term(ballot.term, self._publisher_ids.get(ballot.term, ""))
        leader_term.received = _widened(leader_term.received, wall)
        leader_term.ballots += 1

    def _leader_term(self, term: int, publisher_id: str) -> LeaderTerm:
        nameless = self._leader_terms.pop((term, ""), None)
        if nameless is not None:  # so far only its ballots were received
            nameless.publisher_id = publisher_id
            self._leader_terms[term, publisher_id] = nameless
        if (term, publisher_id) not in self._leader_terms:
            if len(self._leader_terms) >= MAX_TERMS:
                raise BadMessage("too many leaders")
            name = leader_of(self._mission, term)
            self._leader_terms[term, publisher_id] = LeaderTerm(name, term, publisher_id)
        return self._leader_terms[term, publisher_id]


def overlaps(leader_terms: Sequence[LeaderTerm]) -> list[Overlap]:
    """Return every two leaders that overlapped by their stamps, which is exact on machines with one clock."""
    found = []
    for one, other in combinations(sorted(leader_terms, key=lambda one: one.published.begin), 2):
        begin = max(one.published.begin, other.published.begin)
        end = min(one.published.end, other.published.end)
        if begin <= end:
            found.append(Overlap(one, other, Span(begin, end)))
    return found


def _widened(span: Span, moment: float) -> Span:
    return Span(min(span.begin, moment), max(span.end, moment))
