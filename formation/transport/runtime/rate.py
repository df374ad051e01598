"""A steady rate on a clock that the caller reads, without drift."""

from __future__ import annotations

import math

TICK_TOLERANCE = 1e-6
"""Time before a tick that counts as on time [s]: clocks are read, and summed up, in floats."""


class Rate:
    """Ticks on a grid that the first call fixes, so that one late tick does not delay the next.

    Missed ticks are not repeated: they are counted in `missed`, and the grid stays.
    """

    def __init__(self, hertz: float, phase: float = 0.0) -> None:
        """`phase` in [0, 1) puts the first tick that share of a period after the first call."""
        if not (hertz > 0.0 and math.isfinite(hertz) and 0.0 <= phase < 1.0):
            raise ValueError(f"rate {hertz} Hz, phase {phase}: need a finite rate > 0 and a phase in [0, 1)")
        self.period = 1.0 / hertz
        """[s]"""
        self.ticks = 0
        self.missed = 0
        """Whole periods that passed without a tick."""
        self._phase = phase
        self._first: float | None = None  # time of grid point 0
        self._point = 0  # grid point of the next tick

    @property
    def due(self) -> float:
        """When the next tick is due [s, the caller's clock]; -inf before the first call."""
        return -math.inf if self._first is None else self._first + self._point * self.period

    def tick(self, now: float) -> bool:
        """Whether a tick has come at `now` [s, monotonic]; if so, the next one is a period later."""
        if self._first is None:
            self._first = now + self._phase * self.period
        late = now - self.due
        if late < -TICK_TOLERANCE:
            return False
        passed = max(0, math.floor((late + TICK_TOLERANCE) / self.period))
        self.missed += passed
        self.ticks += 1
        self._point += passed + 1
        return True
