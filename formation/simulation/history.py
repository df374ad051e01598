"""One run over time, as arrays: from a simulation or a recording, ready to be plotted."""

from __future__ import annotations

from dataclasses import dataclass

from formation.control.arrays import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True)
class History:
    """T moments of N robots, the leader first; F = N-1 followers. Unknown values are NaN."""

    title: str
    names: tuple[str, ...]
    """All robots, leader first."""
    edges: tuple[tuple[int, int], ...]
    """(i, j) by index into `names`: robot i measures robot j."""
    offset: FloatArray
    """Control-point offset of each follower [m]; shape (F,)."""
    max_speed: FloatArray
    """Limit of each follower [m/s]; shape (F,)."""
    max_turn_rate: FloatArray
    """Limit of each follower [rad/s]; shape (F,)."""
    time: FloatArray
    """[s]; shape (T,)."""
    position: ComplexArray
    """Centres [m; world frame]; shape (T, N)."""
    heading: ComplexArray
    """Unit complex [world frame]; shape (T, N)."""
    heading_error: FloatArray
    """Signed angle from the true heading to the estimated one [rad]; shape (T, F)."""
    error: FloatArray
    """Formation error, summed over edges [m]; shape (T,)."""
    speed: FloatArray
    """Forward speed of each follower [m/s]; shape (T, F)."""
    turn_rate: FloatArray
    """Turn rate of each follower [rad/s]; shape (T, F)."""

    @property
    def points(self) -> ComplexArray:
        """Control points, the leader's being its position [m; world frame]; shape (T, N)."""
        points = self.position.copy()
        points[:, 1:] += self.offset * self.heading[:, 1:]
        return points
