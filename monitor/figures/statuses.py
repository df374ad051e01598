"""What one process says of itself, in its status."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from formation.ros2.messages import Diagnostics, Status, decode
from formation.wire import Now, Sample
from monitor.figures.feed import Feed

UNSEEN, SILENT = "unseen", "silent"
LONGEST_STATE, LONGEST_REASON = 40, 200
"""[letters]"""
Handler = Callable[[Sample, float], None]
"""Takes in a message that arrived at that moment [s, our system clock]. Raises BadMessage."""
_NOTHING: Mapping[str, str] = MappingProxyType({})


class Statuses:
    """The newest status on one key."""

    def __init__(self, feed: Feed, heed: Callable[[Mapping[str, str]], None] = lambda _: None) -> None:
        """`heed` is told what each says."""
        self.feed = feed
        self._heed = heed
        self._newest: Status | None = None

    def take(self, sample: Sample, wall: float) -> None:
        """Take one more. Raises BadMessage."""
        message = decode(Diagnostics, sample.payload)
        self.feed.stamped(message.stamp, wall)
        if message.statuses:
            self._newest = message.statuses[0]
            self._heed(self._newest.values)

    def state(self, now: Now) -> tuple[str, str]:
        """State and reason; ``unseen`` before the first, ``silent`` when none has come for a while."""
        if self._newest is None:
            return UNSEEN, "no status yet"
        if not self.feed.fresh(now.mono):
            return SILENT, f"no status for {self.feed.silence(now.mono):.1f} s"
        values = self._newest.values
        state = values.get("state", self._newest.message)
        return state[:LONGEST_STATE], values.get("reason", "")[:LONGEST_REASON]

    def values(self, now: Now) -> Mapping[str, str]:
        """All that it says; nothing where that is not news."""
        if self._newest is None or not self.feed.fresh(now.mono):
            return _NOTHING
        return self._newest.values
