"""Simulate a mission faster than real time: one run or many random starts, and what became of them.

A run has converged when its formation error (summed over edges) stays under the mission's `settled` bound
until the horizon, and has been there for at least `DWELL`: an error that dips under the bound in the last
moments, or swings through it, has shown nothing (a loop that winds up swings with a period of 2π/√k_I). Its
settling time is when it went under the bound for good.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from formation.graph import formation_error
from formation.law import LAWS, Law
from formation.mission import Mission
from formation.plane import ComplexArray, FloatArray, angle_between
from formation.simulation.ensemble import Ensemble, Options
from formation.simulation.history import History
from formation.simulation.starts import own_starts, random_starts

DWELL = 10.0
"""How long a run has to stay under the bound before it counts as converged [s]; half of a short horizon."""
MOMENTS = 2_000_000
"""Robot poses that a history holds at most; a longer run is thinned evenly."""


@dataclass(frozen=True, slots=True)
class Result:
    """What became of R runs."""

    law: str
    settled: float
    """The bound [m]."""
    settling_time: FloatArray
    """When each run went under the bound for good [s], NaN where it did not; shape (R,)."""
    converged: NDArray[np.bool_]
    """Shape (R,)."""
    final_error: FloatArray
    """At the horizon [m], infinite where a run left the numbers; shape (R,)."""
    time: FloatArray
    """Moments of `error` [s]; shape (K,)."""
    error: FloatArray
    """Formation error of every run [m]; shape (K, R)."""
    wall_time: float
    """[s]"""
    robot_steps: int
    """Control steps of all followers of all runs."""
    history: History | None
    """The first run, if it was to be kept."""

    def summary(self) -> dict[str, Any]:
        """The figures as JSON has them; None where there is no number."""
        settling = self.settling_time[self.converged]
        return {
            "runs": len(self.converged),
            "converged_fraction": float(self.converged.mean()),
            "settling_time": {
                "median": _number(np.median(settling)) if len(settling) else None,
                "p95": _number(np.percentile(settling, 95)) if len(settling) else None,
            },
            "final_error": {
                "median": _number(np.median(self.final_error)),
                "max": _number(self.final_error.max()),
            },
            "wall_time": self.wall_time,
            "robot_steps_per_second": self.robot_steps / max(self.wall_time, 1e-9),
        }


def simulate(
    mission: Mission,
    *,
    runs: int = 1,
    seed: int = 0,
    law: str | Law | None = None,
    options: Options | None = None,
    horizon: float | None = None,
    step: float | None = None,
    spread: float | None = None,
    starts: Literal["mission", "random"] | None = None,
    progress: Callable[[float], None] | None = None,
    keep: bool = False,
) -> Result:
    """Run the closed loop `runs` times; what is not given is as the mission says.

    One run starts as the mission says, several at random: within ± `spread` [m] of the slots. The starts
    depend on `seed` alone, so laws can be compared. `law` is a key of LAWS, or a law that gets what `field`
    does. `progress` is told the share done, `keep` keeps the first run's history. Raises ValueError
    for an argument out of range.
    """
    law = law or mission.law.kind
    horizon = mission.simulation.horizon if horizon is None else horizon
    step = mission.simulation.step if step is None else step
    spread = mission.simulation.spread if spread is None else spread
    _check(runs, law, horizon, step, spread)
    drawn, noise = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))
    began = time.perf_counter()
    if (starts or ("mission" if runs == 1 else "random")) == "mission":
        first = own_starts(mission, runs)
    else:
        first = random_starts(mission, runs, spread, drawn)
    with np.errstate(all="ignore"):  # a run may leave the numbers: it then has not converged, and says so
        ensemble = Ensemble(mission, law, options or Options(), first, step, noise)
        watch = _Watch(mission, ensemble, round(horizon / step), keep=keep)
        watch.look()
        while ensemble.steps < watch.steps:
            ensemble.step()
            watch.look()
            if progress is not None and (ensemble.steps % watch.stride == 0 or ensemble.steps == watch.steps):
                progress(ensemble.steps / watch.steps)
    return watch.result(law if isinstance(law, str) else law.__name__, step, time.perf_counter() - began)


def _check(runs: int, law: str | Law, horizon: float, step: float, spread: float) -> None:
    if runs < 1:
        raise ValueError(f"runs = {runs}: must be at least 1")
    if isinstance(law, str) and law not in LAWS:
        raise ValueError(f"law {law!r}: must be one of {', '.join(LAWS)}")
    if not 0.0 < step <= 0.2:
        raise ValueError(f"step = {step}: must be above 0 and at most 0.2 s")
    if not step <= horizon < math.inf:
        raise ValueError(f"horizon = {horizon}: must be finite and at least one step of {step} s")
    if not 0.0 <= spread < math.inf:
        raise ValueError(f"spread = {spread}: must be finite and not negative [m]")


class _Watch:
    """Looks at an ensemble after every step, and remembers what the result needs."""

    def __init__(self, mission: Mission, ensemble: Ensemble, steps: int, *, keep: bool) -> None:
        self.steps = steps
        self.stride = max(1, steps // 1000)
        """Steps between moments of the error that is kept for every run."""
        self._mission, self._ensemble = mission, ensemble
        self._slots = mission.slots()
        self._last_out = np.full(ensemble.position.shape[0], -1)
        self._errors: list[FloatArray] = []
        self._error: FloatArray = np.empty(0)
        self._pace = max(1, math.ceil(steps * len(mission.names) / MOMENTS))
        self._moments: list[tuple[Any, ...]] | None = [] if keep else None

    def look(self) -> None:
        """Take in the present."""
        now = self._ensemble
        error = formation_error(self._mission.graph, now.points, self._slots)
        self._error = np.where(np.isfinite(error), error, np.inf)
        self._last_out[self._error >= self._mission.settled] = now.steps
        if now.steps % self.stride == 0:
            self._errors.append(self._error)
        if self._moments is not None and now.steps % self._pace == 0:
            followers = (now.position, now.heading, now.estimate, now.moving.speed, now.moving.turn_rate)
            self._moments.append((now.time, self._error[0], *(array[0] for array in followers)))

    def result(self, law: str, step: float, wall_time: float) -> Result:
        """What there is to say at the end."""
        runs, followers = self._ensemble.position.shape
        dwell = round(min(DWELL, 0.5 * self.steps * step) / step)
        converged = self._last_out + dwell < self.steps
        return Result(
            law=law,
            settled=self._mission.settled,
            settling_time=np.where(converged, (self._last_out + 1) * step, np.nan),
            converged=converged,
            final_error=self._error,
            time=step * self.stride * np.arange(len(self._errors), dtype=np.float64),
            error=np.array(self._errors),
            wall_time=wall_time,
            robot_steps=runs * followers * self.steps,
            history=None if self._moments is None else self._history(law),
        )

    def _history(self, law: str) -> History:
        columns = [np.array(column) for column in zip(*(self._moments or ()), strict=True)]
        times, error, position, heading, estimate, speed, turn_rate = columns
        mission, limits, route = self._mission, self._ensemble.limits, self._ensemble.route
        return History(
            title=f"{mission.name}, {law} law",
            names=mission.names,
            edges=tuple(zip(mission.graph.tails.tolist(), mission.graph.heads.tolist(), strict=True)),
            offset=limits.offset,
            max_speed=limits.max_speed,
            max_turn_rate=limits.max_turn_rate,
            time=times,
            position=_beside(route.position(times), position),
            heading=_beside(route.heading(times), heading),
            heading_error=angle_between(heading, estimate),
            error=error,
            speed=speed,
            turn_rate=turn_rate,
        )


def _beside(leader: ComplexArray, followers: ComplexArray) -> ComplexArray:
    return np.column_stack([leader, followers])


def _number(value: float | np.floating[Any]) -> float | None:
    return float(value) if math.isfinite(value) else None
