"""The newest status of a process, and the operator requests in the statuses of candidates."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable

from formation.monitor.metrics.feed import Feed, finite
from formation.monitor.metrics.snapshot import CandidateMetrics, ReportedRequest
from formation.protocol import status_codec
from formation.protocol.outcome import called
from formation.protocol.status import AgentStatus, AnsweredRequest, LeaderStatus
from formation.ros2.messages import Diagnostics, decode
from formation.wire import BadMessage, Now, Sample

MAX_REMEMBERED_REQUESTS = 256
"""Number of requests recognised when repeated."""
MAX_TEXT_CHARS = 200
"""Longest text of a request, and longest reason [characters]."""
UNSEEN, SILENT, LEADS = "unseen", "silent", "leads"
"""States of a process before its first status, and after its last; and of the candidate that leads."""
Handler = Callable[[Sample, float], None]
"""Handle a message and its arrival [s, our system clock]. Raises BadMessage."""


class Requests:
    """All operator requests to candidates, which repeat them in their statuses; each once."""

    def __init__(self) -> None:
        self.newest: deque[ReportedRequest] = deque(maxlen=64)
        self._known: dict[tuple[str, str, str], None] = {}  # candidate and request, by its id
        self._count = 0

    def add(self, name: str, answered: Iterable[AnsweredRequest]) -> None:
        """Take in the requests in a status of candidate `name`."""
        for one in answered:
            known = name, one.request.do, one.request.id
            if not one.request.id or known in self._known:
                continue
            self._known[known] = None
            if len(self._known) > MAX_REMEMBERED_REQUESTS:
                self._known.pop(next(iter(self._known)))
            self._count += 1
            text, reason = called(one.request), one.reason[:MAX_TEXT_CHARS]
            self.newest.append(ReportedRequest(self._count, name, text, one.ok, reason))


class Statuses:
    """The newest status on one key."""

    def __init__(
        self, kind: type[AgentStatus | LeaderStatus], feed: Feed, name: str, requests: Requests
    ) -> None:
        """`requests` takes the operator requests in the statuses, as those of `name`."""
        self._kind, self._feed, self._name, self._requests = kind, feed, name, requests
        self._newest: AgentStatus | LeaderStatus | None = None
        self._payload, self._stamp = b"", -math.inf

    def process_status(self, sample: Sample, wall: float) -> None:
        """Take in one more status. Raises BadMessage, also if it is repeated: it shows no process alive."""
        if sample.payload == self._payload:
            raise BadMessage("status is the one before")
        message = decode(Diagnostics, sample.payload)
        if message.stamp <= self._stamp and self._feed.fresh(sample.arrived):
            raise BadMessage("stamp is not later than that of the status before")
        self._stamp = message.stamp
        age = wall - self._feed.stamped(message.stamp, wall)
        if age > self._feed.limit:
            raise BadMessage(f"status is {age:.1f} s old, by its usual delay")
        status = status_codec.from_message(self._kind, message)
        self._payload = sample.payload
        if status is not None:
            self._newest = status
            if isinstance(status, LeaderStatus):
                self._requests.add(self._name, status.requests)

    def state(self, now: Now) -> tuple[str, str]:
        """Return state and reason; ``unseen`` before the first, ``silent`` when none has come for a while."""
        if self._newest is None:
            return UNSEEN, "no status yet"
        if not self._feed.fresh(now.mono):
            return SILENT, f"no status for {self._feed.silence(now.mono):.1f} s"
        reason = self._newest.reason
        return str(self._newest.state), "" if reason is None else str(reason)[:MAX_TEXT_CHARS]

    def newest(self, now: Now) -> AgentStatus | LeaderStatus | None:
        """Return the newest status; None if it is not fresh."""
        return self._newest if self._feed.fresh(now.mono) else None

    def candidate(self, now: Now, *, leads: bool) -> CandidateMetrics:
        """Return the metrics of a candidate."""
        state, reason = self.state(now)
        return CandidateMetrics(LEADS if leads else state, reason, finite(self._feed.silence(now.mono)))
