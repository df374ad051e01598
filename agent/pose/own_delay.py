"""Estimate how late the sensor shows what was commanded, whatever its stamps say; without a clock.

A driver that stamps on publication hides how old its measurements are. What a robot was commanded shows it:
speeds that vary appear in the positions after the delay. Over a few seconds, the distance between two
positions `WINDOW_TIME` apart is fitted by that of the dead reckoning, for every delay on a grid, with a
factor for slip. Where no delay up to the limit fits, and a longer one does, measurements are late. Steady
motion fits every delay, and proves nothing.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from formation.agent.pose.motion_model import Modelled

SPACING = 0.05
"""Time between two delays on the grid [s]."""
GRID_COUNT = 25
"""Number of delays on the grid, from none on."""
WINDOW_STEPS = 8
WINDOW_TIME = WINDOW_STEPS * SPACING
"""Time between the two positions of each fitted distance [s]."""
LOOKBACK_COUNT = GRID_COUNT + WINDOW_STEPS
"""Number of states of the dead reckoning that are needed, `SPACING` apart."""
KEPT_TIME = LOOKBACK_COUNT * SPACING
"""Time over which the dead reckoning is needed [s]."""
FADING_TIME = 5.0
"""Time constant with which earlier distances are forgotten [s]."""
FIT_RATIO = 4.0
"""The best delay beyond the limit fits so many times better than the best one within it."""
MIN_MISFIT = 0.02
"""Root mean square by which delays within the limit must miss [m]."""
NOISE_DEVIATIONS = 2.0
"""The same in standard deviations of stated noise."""
MIN_FIT = 0.8
"""Share of the variation that a delay must explain to count as seen."""
MIN_COUNT = 8.0
"""Number of distances from which on they are judged."""


@dataclass(slots=True, kw_only=True)
class OwnDelayState:
    """Sums of distances, which fade, and the newest positions."""

    seen: deque[tuple[float, complex]] = field(default_factory=deque)
    """When positions arrived [s, monotonic], and the positions from where the first was [m], oldest first."""
    count: float = 0.0
    """Number of distances."""
    squares: float = 0.0
    """Sum of the squared distances seen [m²]."""
    model_squares: list[float] = field(default_factory=lambda: [0.0] * GRID_COUNT)
    """Sum of the modelled ones, by delay [m²]."""
    products: list[float] = field(default_factory=lambda: [0.0] * GRID_COUNT)
    """Sum of the products of both, by delay [m²]."""


class OwnDelay:
    """Estimates the delay of one robot's measurements."""

    def __init__(self, noise: float) -> None:
        """Positions have `noise` [m] (standard deviation per axis)."""
        self.state = OwnDelayState()
        self._misfit = math.hypot(MIN_MISFIT, NOISE_DEVIATIONS * noise)

    def break_off(self) -> None:
        """Begin the next distance anew, after a gap."""
        self.state.seen.clear()

    def add(self, moment: float, moved: complex, models: Sequence[Modelled]) -> None:
        """Add a measurement at `moment` [s, monotonic], `moved` [m] from the one before.

        `models` are `LOOKBACK_COUNT` states of the dead reckoning, `SPACING` apart, newest first.
        """
        state = self.state
        before = state.seen[-1] if state.seen else (moment, 0j)
        state.seen.append((moment, before[1] + moved))
        while len(state.seen) > 2 and state.seen[1][0] <= moment - WINDOW_TIME:
            state.seen.popleft()
        oldest, next_one = state.seen[0], state.seen[min(1, len(state.seen) - 1)]
        if oldest[0] > moment - WINDOW_TIME:
            return
        share = (moment - WINDOW_TIME - oldest[0]) / (next_one[0] - oldest[0])
        start = oldest[1] + share * (next_one[1] - oldest[1])
        self._add(abs(state.seen[-1][1] - start), models, math.exp((before[0] - moment) / FADING_TIME))

    def _add(self, seen: float, models: Sequence[Modelled], kept: float) -> None:
        state = self.state
        state.count, state.squares = kept * state.count + 1.0, kept * state.squares + seen * seen
        for index in range(GRID_COUNT):
            commanded = abs(models[index].position - models[index + WINDOW_STEPS].position)
            state.model_squares[index] = kept * state.model_squares[index] + commanded * commanded
            state.products[index] = kept * state.products[index] + commanded * seen

    def misfits(self) -> list[float]:
        """Mean square that is left by each delay [m²]."""
        state = self.state
        return [
            max(0.0, state.squares - (product * product / square if square > 0.0 else 0.0)) / state.count
            for square, product in zip(state.model_squares, state.products, strict=True)
        ]

    def judge(self, limit: float) -> float | None:
        """Delay of the measurements [s], if it explains them and none up to `limit` [s] does; else None."""
        state = self.state
        if state.count < MIN_COUNT:
            return None
        allowed = math.floor(min(limit, KEPT_TIME) / SPACING + 0.5) + 1
        if allowed >= GRID_COUNT:
            return None
        misfits = self.misfits()
        within, beyond = min(misfits[:allowed]), min(misfits[allowed:])
        if within < self._misfit**2 or within < FIT_RATIO * beyond:
            return None
        if beyond > (1.0 - MIN_FIT) * state.squares / state.count:
            return None
        return SPACING * misfits.index(beyond)
