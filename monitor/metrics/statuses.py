"""The statuses of one process."""

from __future__ import annotations

from collections.abc import Callable

from formation.monitor.metrics.feed import Feed
from formation.protocol import status_codec
from formation.protocol.status import AgentStatus, LeaderStatus
from formation.ros2.messages import Diagnostics, decode
from formation.wire import Now, Sample

UNSEEN, SILENT = "unseen", "silent"
"""States of a process before its first status, and after its last."""
MAX_REASON_CHARS = 200
"""Longest reason [characters]."""
Handler = Callable[[Sample, float], None]
"""Handle a message and its arrival [s, our system clock]. Raises BadMessage."""
Spoken = AgentStatus | LeaderStatus


class Statuses:
    """The newest status on one key."""

    def __init__(
        self, kind: type[Spoken], feed: Feed, heed: Callable[[Spoken], None] = lambda _: None
    ) -> None:
        """`heed` is called with each status."""
        self.feed = feed
        self._kind, self._heed = kind, heed
        self._newest: Spoken | None = None

    def process_status(self, sample: Sample, wall: float) -> None:
        """Take in one more status. Raises BadMessage."""
        message = decode(Diagnostics, sample.payload)
        self.feed.stamped(message.stamp, wall)
        status = status_codec.from_message(self._kind, message)
        if status is not None:
            self._newest = status
            self._heed(status)

    def state(self, now: Now) -> tuple[str, str]:
        """Return state and reason; ``unseen`` before the first, ``silent`` when none has come for a while."""
        if self._newest is None:
            return UNSEEN, "no status yet"
        if not self.feed.fresh(now.mono):
            return SILENT, f"no status for {self.feed.silence(now.mono):.1f} s"
        reason = self._newest.reason
        return str(self._newest.state), "" if reason is None else str(reason)[:MAX_REASON_CHARS]

    def newest(self, now: Now) -> Spoken | None:
        """Return the newest status; None if it is not fresh."""
        return self._newest if self.feed.fresh(now.mono) else None
