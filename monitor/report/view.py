"""The view of runs to compare: the same axes for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from formation.monitor.report import drawing
from formation.monitor.report.gather import Run

ANGLES = (2.0, 5.0, 10.0, 20.0, 45.0, 90.0, 180.0)
"""Possible ends of the scale of heading errors [°]."""


@dataclass(frozen=True, slots=True)
class View:
    """The common axes of several runs."""

    until: float
    """Last moment [s]."""
    error: tuple[float, float]
    """Least and greatest formation error [m]."""
    heading: float
    """Greatest heading error [°]."""
    inputs: tuple[float, float]
    """Greatest limit of speed [m/s] and turn rate [rad/s]."""
    box: tuple[complex, complex] | None
    """Lower left and upper right corner of all paths [m; world frame]."""

    @classmethod
    def of(cls, runs: Sequence[Run], until: float | None = None) -> View:
        """Return the axes that show the relevant part of all `runs`; `until` [s] overrides their end."""
        last = max((_until(run) for run in runs), default=0.0) if until is None else until
        specs = [run.mission.robots[name] for run in runs for name in run.mission.followers]
        return cls(
            until=max(last, 0.1),
            error=_error_range(runs, last),
            heading=_heading_range(runs, last),
            inputs=(max(spec.max_speed for spec in specs), max(spec.max_turn_rate for spec in specs)),
            box=_box(runs, last),
        )


def _until(run: Run) -> float:
    """Return the end of a run's interesting part [s]: after settling, or all if it did not settle."""
    seen = run.paths.time[np.isfinite(run.paths.points).any(axis=1)]
    last, settled = float(seen[-1]) if seen.size else 0.0, run.snapshot.settled_at
    if settled is None or not run.known:
        return last
    time, values = run.formation.line(0)
    shown = time >= 0.0
    return min(max(drawing.span(time[shown], values[shown]), float(np.ceil(1.4 * settled))), last)


def _error_range(runs: Sequence[Run], until: float) -> tuple[float, float]:
    parts = [np.empty(0)]
    for run in runs:
        shown = (run.formation.time >= 0.0) & (run.formation.time <= until)
        parts += [run.formation.low[shown, 0], run.formation.high[shown, 0]]
    values = np.concatenate(parts)
    values = values[np.isfinite(values) & (values > 0.0)]
    return (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)


def _heading_range(runs: Sequence[Run], until: float) -> float:
    most = 0.0
    for run in runs:
        curves = run.headings
        shown = (curves.time >= 0.0) & (curves.time <= until)
        values = np.abs(np.concatenate([curves.low[shown].ravel(), curves.high[shown].ravel()]))
        most = max(most, float(np.nanmax(values, initial=0.0, where=np.isfinite(values))))
    return next((angle for angle in ANGLES if np.rad2deg(most) <= angle), ANGLES[-1])


def _box(runs: Sequence[Run], until: float) -> tuple[complex, complex] | None:
    parts = []
    for run in runs:
        shown = (run.paths.time >= 0.0) & (run.paths.time <= until)
        both = np.concatenate([run.paths.centres[shown].ravel(), run.paths.points[shown].ravel()])
        parts.append(both[np.isfinite(both)])
    if len(runs) < 2 or not all(part.size for part in parts):
        return None
    points = np.concatenate(parts)
    low = complex(points.real.min(), points.imag.min())
    high = complex(points.real.max(), points.imag.max())
    margin = 0.06 * abs(high - low) * (1 + 1j)
    return low - margin, high + margin
