"""Operators' requests to the candidates, which repeat them in their statuses."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from formation.protocol import status
from formation.protocol.outcome import called
from formation.protocol.status import AgentStatus, LeaderStatus

MAX_REMEMBERED_REQUESTS = 256
"""Number of requests recognised when repeated."""
MAX_TEXT_CHARS = 200
"""Longest text of a request [characters]."""


class ReportedRequest(NamedTuple):
    """One request and its answer."""

    number: int
    """Its number, from 1."""
    name: str
    """The candidate asked."""
    what: str
    """The request as typed."""
    ok: bool
    reason: str


class Requests:
    """All requests, each once."""

    def __init__(self) -> None:
        self.newest: deque[ReportedRequest] = deque(maxlen=64)
        self._known: dict[tuple[str, str, str], None] = {}  # candidate and request, by its id
        self._count = 0

    def add_from_status(self, name: str, newest_status: AgentStatus | LeaderStatus) -> None:
        """Take in the status of `name`, if it is a candidate."""
        for one in newest_status.requests if isinstance(newest_status, LeaderStatus) else ():
            self._add(name, one)

    def _add(self, name: str, one: status.AnsweredRequest) -> None:
        request = one.request
        known = name, request.do, request.id
        if not request.id or known in self._known:
            return
        self._known[known] = None
        if len(self._known) > MAX_REMEMBERED_REQUESTS:
            self._known.pop(next(iter(self._known)))
        self._count += 1
        self.newest.append(
            ReportedRequest(self._count, name, called(request), one.ok, one.reason[:MAX_TEXT_CHARS])
        )
