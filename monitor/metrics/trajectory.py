"""One robot's interpolated positions, so that robots sampled at different times can be compared."""

from __future__ import annotations

import cmath
import math
from collections import deque
from typing import NamedTuple

from formation.wire import BadMessage


class Placed(NamedTuple):
    """A robot at one moment."""

    moment: float
    """[s, our system clock]"""
    point: complex
    """Control point [m; world frame]."""
    heading: complex
    """Unit complex [world frame]."""


class Trajectory:
    """The newest samples of one robot, interpolated."""

    def __init__(self, size: int, max_gap: float) -> None:
        """Keep `size` samples; positions between two more than `max_gap` [s] apart are unknown."""
        self.size = size
        self._samples: deque[Placed] = deque(maxlen=size)
        self._max_gap = max_gap

    @property
    def latest(self) -> float:
        """Moment of the newest sample [s, our system clock]; minus infinity without one."""
        return self._samples[-1].moment if self._samples else -math.inf

    def add(self, placed: Placed) -> None:
        """Add a sample. Raises BadMessage if it is not later than the newest."""
        if placed.moment <= self.latest:
            raise BadMessage("stamp is not later than the one before")
        self._samples.append(placed)

    def forget(self) -> None:
        """Drop all samples, as after our system clock was set: old and new ones are not comparable."""
        self._samples.clear()

    def at(self, moment: float) -> Placed | None:
        """Return where it was: linear between two samples, the heading by the arc. None if unknown."""
        later = None
        for sample in reversed(self._samples):
            if sample.moment == moment:
                return sample
            if sample.moment < moment:
                if later is None or later.moment - sample.moment > self._max_gap:
                    return None
                return _between(sample, later, moment)
            later = sample
        return None


def _between(before: Placed, after: Placed, moment: float) -> Placed:
    share = (moment - before.moment) / (after.moment - before.moment)
    turn = cmath.phase(after.heading * before.heading.conjugate())
    return Placed(
        moment,
        before.point + share * (after.point - before.point),
        before.heading * cmath.rect(1.0, share * turn),
    )
