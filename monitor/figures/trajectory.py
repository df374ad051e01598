"""Where one robot was, between its samples: what makes robots comparable that are sampled at other times."""

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

    def __init__(self, size: int, widest: float) -> None:
        """Keep `size` samples; between two that are more than `widest` [s] apart nothing is known."""
        self.size = size
        self._samples: deque[Placed] = deque(maxlen=size)
        self._widest = widest

    @property
    def latest(self) -> float:
        """Moment of the newest sample [s, our system clock]; minus infinity without one."""
        return self._samples[-1].moment if self._samples else -math.inf

    def add(self, placed: Placed) -> None:
        """Take one more sample. Raises BadMessage for one that is not later than the newest."""
        if placed.moment <= self.latest:
            raise BadMessage("stamp is not later than the one before")
        self._samples.append(placed)

    def forget(self) -> None:
        """Begin anew, as after our system clock was set: what was is not comparable with what comes."""
        self._samples.clear()

    def at(self, moment: float) -> Placed | None:
        """Where it was: linear between two samples, the heading by the arc. None where that is not known."""
        later = None
        for sample in reversed(self._samples):
            if sample.moment == moment:
                return sample
            if sample.moment < moment:
                if later is None or later.moment - sample.moment > self._widest:
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
