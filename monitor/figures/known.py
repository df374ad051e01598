"""The formation error as far as it is known: the sum over the edges that are, and how many are not.

A partial sum is less than the whole one, so it has a type of its own, and wherever it is said a name of its
own: what is called `known` comes with the number of edges that it is over.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Self

from monitor.figures.settling import DWELL, Settling


class KnownError(NamedTuple):
    """Σ |z_ij - z*_ij| over the edges that are known."""

    error: float | None
    """[m]; None if no edge is known."""
    known_edges: int
    edges: int
    """All of them, known or not."""
    silent: Mapping[str, float | None] = MappingProxyType({})
    """Why edges are unknown: robots without a position, and for how long [s]; None for never heard."""

    @classmethod
    def of(cls, errors: Iterable[float | None], silent: Mapping[str, float | None] | None = None) -> Self:
        """Sum what is known of these edges' errors [m]."""
        each = list(errors)
        known = [error for error in each if error is not None]
        return cls(math.fsum(known) if known else None, len(known), len(each), silent or {})

    @property
    def complete(self) -> bool:
        """Whether every edge is known, and there is one."""
        return 0 < self.known_edges == self.edges

    @property
    def words(self) -> str:
        """``8 of 11 edges; 3 unknown (robot4 silent for 12 s)``."""
        if self.complete:
            return f"{self.edges} edges"
        why = ", ".join(
            f"{name} never heard" if age is None else f"{name} silent for {age:.0f} s"
            for name, age in self.silent.items()
        )
        unknown = f"{self.edges - self.known_edges} unknown{f' ({why})' if why else ''}"
        return f"{self.known_edges} of {self.edges} edges; {unknown}"


NOTHING = KnownError(None, 0, 0)
"""Nothing is known, and nobody is watched."""


class KnownVerdict(NamedTuple):
    """Whether the edges that are known stand."""

    settled_at: float | None = None
    """When their error fell under the mission's bound for good, on the scale of the run [s]."""
    converged: bool = False
    """Whether it has stayed there for the dwell time."""
    final: KnownError | None = None
    """The newest error, over as many edges as were known lately; None if none was."""

    @classmethod
    def of_json(cls, said: Mapping[str, Any]) -> Self:
        """What `as_json` gave."""
        silent = said.get("silent") or {}
        final = KnownError(said.get("error"), said.get("known_edges", 0), said.get("edges", 0), silent)
        return cls(said.get("settled_at"), said.get("converged") is True, final)

    def as_json(self) -> dict[str, Any]:
        """For a program, under the name ``known``."""
        final = self.final or NOTHING
        return {
            "error": None if final.error is None else round(final.error, 6),
            "known_edges": final.known_edges,
            "edges": final.edges,
            "silent": {name: None if age is None else round(age, 1) for name, age in final.silent.items()},
            "settled_at": None if self.settled_at is None else round(self.settled_at, 3),
            "converged": self.converged,
        }


UNJUDGED = KnownVerdict()
"""Before the first edge is known."""


class KnownSettling:
    """Judges the known edges as `Settling` judges all of them; times are of one clock, any [s]."""

    def __init__(self, threshold: float, longest_silence: float) -> None:
        self._settling = Settling(threshold, longest_silence)
        self._recent: deque[tuple[float, KnownError]] = deque()

    def restart(self, at: float) -> None:
        """Something else is asked of the formation from `at` on."""
        self._settling.restart(at)

    def observe(self, at: float, known: KnownError, *, formed: bool) -> None:
        """Take the error of a moment; one that is not later than the one before is left out."""
        last = self._settling.last
        if known.error is None or (last is not None and at <= last):
            return
        self._settling.observe(at, known.error, formed=formed)
        self._recent.append((at, known))
        while at - self._recent[0][0] > DWELL:
            self._recent.popleft()

    def verdict(self, until: float, start: float | None) -> KnownVerdict:
        """As of `until`, when the fleet was last heard; `start` is when all edges were first known.

        Robots that end do not end at once. So it is over the most edges that were known in the last `DWELL`.
        """
        settled = self._settling.settled_at(until)
        if settled is not None and start is not None and self._settling.start is not None:
            settled = max(self._settling.start + settled - start, 0.0)
        final = None
        if self._settling.final(until) is not None:
            final = max(self._recent, key=lambda one: (one[1].known_edges, one[0]))[1]
        return KnownVerdict(settled, self._settling.converged(until), final)
