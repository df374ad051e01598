"""Whether the formation has settled, and since when."""

from __future__ import annotations

import math

DWELL_TIME = 2.0
"""A formation has converged when its error has stayed under the threshold for this long [s]."""
MAX_UNKNOWN_TIME = 1.0
"""Longest stretch of unknown error after which staying under the threshold still counts [s]. It is longer for
slow robots: the longest silence of a robot that still counts as fresh."""


class Settling:
    """Follows the formation error; times are of one clock, any [s]."""

    def __init__(self, threshold: float, longest_silence: float = 0.0) -> None:
        """`threshold` [m]: errors under it count as settled. `longest_silence` [s] of a fresh robot."""
        self.start: float | None = None
        """Time of the first complete error."""
        self.last: float | None = None
        """Time of the newest complete error."""
        self.error: float | None = None
        """The newest complete error [m]."""
        self.wished = -math.inf
        """When the wish last changed."""
        self._threshold = threshold
        self._break = max(MAX_UNKNOWN_TIME, longest_silence)
        self._under_since: float | None = None

    @property
    def wished_at(self) -> float:
        """Seconds from the start to the newest wish; 0 if that was before."""
        return 0.0 if self.start is None else max(self.wished - self.start, 0.0)

    def restart(self, at: float) -> None:
        """Start again at `at`: the wish has changed and the formation has to settle again."""
        self.wished, self._under_since = at, None

    def observe(self, at: float, error: float, *, formed: bool = True) -> None:
        """Take the complete formation error [m] of a moment later than the one before.

        A shape that is still changing (not `formed`) is followed but never counts as settled.
        """
        if self.start is None:
            self.start = at
        if error >= self._threshold or (self.last is not None and at - self.last > self._break):
            self._under_since = None
        if not formed:
            self._under_since = None
        elif error < self._threshold and self._under_since is None and at >= self.wished:
            self._under_since = at
        self.last, self.error = at, error

    def settled_at(self, until: float) -> float | None:
        """Return the seconds from the start to the moment since which the error stays under the threshold.

        None if it does not, or if it was unknown shortly before `until`, when a position last arrived. So
        the verdict on a run remains after it, but a robot lost before its end counts.
        """
        if self._under_since is None or self.start is None or not self._known(until):
            return None
        return self._under_since - self.start

    def converged(self, until: float) -> bool:
        """Return whether the error has stayed under the threshold for DWELL_TIME, `until` as above."""
        return (
            self._under_since is not None
            and self.last is not None
            and self._known(until)
            and self.last - self._under_since >= DWELL_TIME
        )

    def final(self, until: float) -> float | None:
        """Return the newest complete error [m], if it is recent at `until`."""
        return self.error if self._known(until) else None

    def _known(self, until: float) -> bool:
        return self.last is not None and until - self.last <= max(DWELL_TIME, self._break)
