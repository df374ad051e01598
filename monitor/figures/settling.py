"""Since when, and whether, the formation stands."""

from __future__ import annotations

import math

DWELL = 2.0
"""A formation has converged when its error has stayed under the threshold for this long [s]."""
BREAK = 1.0
"""After a longer stretch in which the error was not known, staying under the threshold begins anew [s]. A
fleet of slow robots has a longer one: the longest silence of a robot that still counts as heard."""


class Settling:
    """Follows the formation error; times are of one clock, any [s]."""

    def __init__(self, threshold: float, longest_silence: float = 0.0) -> None:
        """`threshold` [m]: errors under it count as settled. `longest_silence` [s] of a robot still heard."""
        self.start: float | None = None
        """Of the first complete error."""
        self.last: float | None = None
        """Of the newest complete error."""
        self.error: float | None = None
        """The newest complete error [m]."""
        self.wished = -math.inf
        """When something else was last asked of the formation."""
        self._threshold = threshold
        self._break = max(BREAK, longest_silence)
        self._under_since: float | None = None

    @property
    def wished_at(self) -> float:
        """Seconds from the start to the newest wish; 0 if that was before."""
        return 0.0 if self.start is None else max(self.wished - self.start, 0.0)

    def restart(self, at: float) -> None:
        """Something else is asked of the formation from `at` on: it has to settle anew."""
        self.wished, self._under_since = at, None

    def observe(self, at: float, error: float, *, formed: bool = True) -> None:
        """Take the complete formation error [m] of a moment later than the one before.

        A figure that is still on its way (not `formed`) is followed, but nothing has settled in it.
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
        """Seconds from the start to the moment since which the error stays under the threshold.

        None if it does not, or if it was not known shortly before `until`, when the fleet was last heard. So
        the verdict on a run outlives the run, but a robot that was lost before its end counts.
        """
        if self._under_since is None or self.start is None or not self._known(until):
            return None
        return self._under_since - self.start

    def converged(self, until: float) -> bool:
        """Whether the error has stayed under the threshold for DWELL, `until` as above."""
        return (
            self._under_since is not None
            and self.last is not None
            and self._known(until)
            and self.last - self._under_since >= DWELL
        )

    def final(self, until: float) -> float | None:
        """The newest complete error [m], if it is as new as `until` demands."""
        return self.error if self._known(until) else None

    def _known(self, until: float) -> bool:
        return self.last is not None and until - self.last <= max(DWELL, self._break)
