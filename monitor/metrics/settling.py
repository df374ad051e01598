"""Whether the formation has settled, and since when: over all edges, and over those that are known.

A sum over some edges is less than the sum over all, so it has its own type: a `KnownError` always has the
number of edges in the sum.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Self

from formation.monitor.metrics.feed import rounded

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
        self.ordered = -math.inf
        """When what is ordered last changed."""
        self._threshold = threshold
        self._max_gap = max(MAX_UNKNOWN_TIME, longest_silence)
        self._under_since: float | None = None

    @property
    def ordered_at(self) -> float:
        """Seconds from the start to the newest order; 0 if that was before."""
        return 0.0 if self.start is None else max(self.ordered - self.start, 0.0)

    def restart(self, at: float) -> None:
        """Start again at `at`: what is ordered has changed and the formation has to settle again."""
        self.ordered, self._under_since = at, None

    def observe(self, at: float, error: float, *, formed: bool = True) -> None:
        """Take the complete formation error [m] of a moment later than the one before.

        A shape that is still changing (not `formed`) is followed but never counts as settled.
        """
        if self.start is None:
            self.start = at
        if error >= self._threshold or (self.last is not None and at - self.last > self._max_gap):
            self._under_since = None
        if not formed:
            self._under_since = None
        elif error < self._threshold and self._under_since is None and at >= self.ordered:
            self._under_since = at
        self.last, self.error = at, error

    def settled_at(self, until: float) -> float | None:
        """Return the seconds from the start to the moment since which the error stays under the threshold.

        None if it does not, or if it was unknown shortly before `until`, when a position last arrived. So the
        verdict remains after the end of a run, unless a robot was lost before it.
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
        return self.last is not None and until - self.last <= max(DWELL_TIME, self._max_gap)


class KnownError(NamedTuple):
    """Σ |z_ij - z*_ij| over the edges that are known."""

    error: float | None
    """[m]; None if no edge is known."""
    known_edges: int
    edges: int
    """Number of all edges, known or not."""
    silent: Mapping[str, float | None] = MappingProxyType({})
    """Robots without a position, and for how long [s]; None for never received. They make edges unknown."""

    @classmethod
    def of(cls, errors: Iterable[float | None], silent: Mapping[str, float | None] | None = None) -> Self:
        """Sum the known ones of these edges' errors [m]."""
        each = list(errors)
        known = [error for error in each if error is not None]
        return cls(math.fsum(known) if known else None, len(known), len(each), silent or {})

    @property
    def complete(self) -> bool:
        """Whether every edge is known and there is at least one."""
        return 0 < self.known_edges == self.edges

    @property
    def words(self) -> str:
        """``8 of 11 edges; 3 unknown (robot4 silent for 12 s)``."""
        if self.complete:
            return f"{self.edges} edges"
        why = ", ".join(
            f"nothing from {name} yet" if age is None else f"{name} silent for {age:.0f} s"
            for name, age in self.silent.items()
        )
        unknown = f"{self.edges - self.known_edges} unknown{f' ({why})' if why else ''}"
        return f"{self.known_edges} of {self.edges} edges; {unknown}"


NOTHING = KnownError(None, 0, 0)
"""Nothing is known, and no robot is watched."""


class KnownVerdict(NamedTuple):
    """Whether the known edges have settled."""

    settled_at: float | None
    """When their error fell below the mission's bound for good, in time of the run [s]."""
    converged: bool
    """Whether it has stayed there for the dwell time."""
    final: KnownError | None
    """The newest error over the edges known lately; None if there were none."""

    @classmethod
    def of_json(cls, data: Mapping[str, Any]) -> Self:
        """Return the verdict that `as_json` gave."""
        final = KnownError(data["error"], data["known_edges"], data["edges"], data["silent"])
        return cls(data["settled_at"], data["converged"], final)

    def as_json(self) -> dict[str, Any]:
        """Return it for programs, under the name ``known``."""
        final = self.final or NOTHING
        return {
            "error": rounded(final.error, 6),
            "known_edges": final.known_edges,
            "edges": final.edges,
            "silent": {name: rounded(age, 1) for name, age in final.silent.items()},
            "settled_at": rounded(self.settled_at),
            "converged": self.converged,
        }


class KnownSettling:
    """Judge the known edges as `Settling` judges all; times are on any one clock [s]."""

    def __init__(self, threshold: float, longest_silence: float) -> None:
        self._settling = Settling(threshold, longest_silence)
        self._recent: deque[tuple[float, KnownError]] = deque()

    def restart(self, at: float) -> None:
        """Start again at `at`: what is ordered has changed."""
        self._settling.restart(at)

    def observe(self, at: float, known: KnownError, *, formed: bool) -> None:
        """Take the error of a moment; ignore one that is not later than the last."""
        last = self._settling.last
        if known.error is None or (last is not None and at <= last):
            return
        self._settling.observe(at, known.error, formed=formed)
        self._recent.append((at, known))
        while at - self._recent[0][0] > DWELL_TIME:
            self._recent.popleft()

    def verdict(self, until: float, start: float | None) -> KnownVerdict:
        """Return the verdict as of `until`, when a position last arrived; `start`: all edges first known.

        Robots do not all end at once, so it is over the most edges that were known in the last `DWELL_TIME`.
        """
        settled = self._settling.settled_at(until)
        if settled is not None and start is not None and self._settling.start is not None:
            settled = max(self._settling.start + settled - start, 0.0)
        final = None
        if self._settling.final(until) is not None:
            final = max(self._recent, key=lambda one: (one[1].known_edges, one[0]))[1]
        return KnownVerdict(settled, self._settling.converged(until), final)
