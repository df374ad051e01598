"""Simulate a mission faster than real time: one run or many random starts, and their results.

A run has converged when its formation error (summed over edges) stays under the mission's `settled` bound
until the horizon, and has been there for at least `DWELL_TIME`: an error that falls under the bound in the
last moments, or swings through it, proves nothing (a loop that winds up swings with a period of 2π/√k_I). Its
settling time is when it went under the bound for good.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from formation.control.arrays import ComplexArray, FloatArray
from formation.control.controller import Controller
from formation.control.laws import LAWS, why_unusable
from formation.mission.model import Mission
from formation.simulation.ensemble import Ensemble, Options, own_starts, positions, random_starts

DWELL_TIME = 10.0
"""Time under the bound after which a run counts as converged [s]; half of a short horizon."""
GROUP_STEPS, MAX_GROUP_STEPS = 16, 1_000_000
"""Steps of one run before the next takes its turn, and greatest work of all robots in that time [steps]."""
MAX_RUN_MOMENTS, MAX_ALL_MOMENTS = 1000, 25_000_000
"""Most stored moments of the error of each run, and of all runs together."""
MAX_MOMENTS = 2_000_000
"""Most robot poses in a history; a longer run is thinned evenly."""


@dataclass(frozen=True, slots=True)
class History:
    """One run over time, from a simulation or a recording, ready to be plotted.

    T moments of N robots, the leader first; F = N-1 followers. Unknown values are NaN.
    """

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


@dataclass(frozen=True, slots=True)
class Result:
    """Results of R runs."""

    law: str
    settled: float
    """The bound [m]."""
    settling_time: FloatArray
    """When each run went under the bound for good [s], NaN if it did not; shape (R,)."""
    converged: NDArray[np.bool_]
    """Shape (R,)."""
    final_error: FloatArray
    """At the horizon [m], infinite if a run overflowed; shape (R,)."""
    watched: bool
    """Whether contacts were detected: not with collisions off."""
    nearest: FloatArray
    """Least distance between two bodies [m], shape (R,): negative if they touched, infinite if contacts
    were not detected."""
    deadlocks: NDArray[np.int64]
    """Of all robots; shape (R,)."""
    time: FloatArray
    """Moments of `error` [s]; shape (K,)."""
    error: FloatArray
    """Formation error of every run [m]; shape (K, R)."""
    wall_time: float
    """Duration without compilation [s]."""
    robot_steps: int
    """Control steps of all followers of all runs."""
    history: History | None
    """The first run, if requested."""

    def summary(self) -> dict[str, Any]:
        """The results for JSON; None instead of NaN and infinity."""
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
            "touched": int((self.nearest < 0.0).sum()) if self.watched else None,
            "nearest": _number(self.nearest.min()),
            "deadlocks": int(self.deadlocks.sum()),
            "wall_time": self.wall_time,
            "robot_steps_per_second": self.robot_steps / max(self.wall_time, 1e-9),
        }


def simulate(
    mission: Mission,
    *,
    runs: int = 1,
    seed: int | Sequence[int] = 0,
    law: str | Controller | None = None,
    options: Options | None = None,
    horizon: float | None = None,
    step: float | None = None,
    spread: float | None = None,
    starts: Literal["mission", "random"] | None = None,
    progress: Callable[[float], None] | None = None,
    keep: bool = False,
) -> Result:
    """Run the closed loop `runs` times; missing arguments are as the mission says.

    One run starts as the mission says, several at random: within ± `spread` [m] of the slots. The starts
    depend on `seed` alone, so laws can be compared. `law` is a key of LAWS, or another law. `progress` is
    called with the share done, 0 once all is compiled. `keep` stores the first run's history; with several
    runs this changes the noise and losses of a seed. Raises ValueError for an argument out of range.
    """
    law = law or mission.law.kind
    horizon = mission.simulation.horizon if horizon is None else horizon
    step = mission.simulation.step if step is None else step
    spread = mission.simulation.spread if spread is None else spread
    _check(runs, law, horizon, step, spread)
    drawn, noise = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))
    if (starts or ("mission" if runs == 1 else "random")) == "mission":
        first = own_starts(mission, runs)
    else:
        first = random_starts(mission, runs, spread, drawn)
    steps = round(horizon / step)
    stride = math.ceil(steps / max(1, min(MAX_RUN_MOMENTS, MAX_ALL_MOMENTS // runs)))
    controller = LAWS[law] if isinstance(law, str) else law
    ensemble = Ensemble(mission, controller, options or Options(), first, step, noise, steps, stride)
    ensemble.run_on(0)  # compiles, if not done before
    if progress is not None:
        progress(0.0)
    began = time.perf_counter()
    film = _Film(mission, ensemble, steps) if keep else None
    group = film.pace if film else max(GROUP_STEPS, MAX_GROUP_STEPS // first.position.size)
    while ensemble.steps < steps:
        ensemble.run_on(min(group, steps - ensemble.steps))
        if film is not None:
            film.store_moment()
        if progress is not None:
            progress(ensemble.steps / steps)
    return _result(mission, controller.name, ensemble, stride, time.perf_counter() - began, film)


def _check(runs: int, law: str | Controller, horizon: float, step: float, spread: float) -> None:
    if runs < 1:
        raise ValueError(f"runs = {runs}: must be at least 1")
    if isinstance(law, str) and (why := why_unusable(law)) is not None:
        raise ValueError(why)
    if not 0.0 < step <= 0.2:
        raise ValueError(f"step = {step}: must be above 0 and at most 0.2 s")
    if not step <= horizon < math.inf:
        raise ValueError(f"horizon = {horizon}: must be finite and at least one step of {step} s")
    if not 0.0 <= spread < math.inf:
        raise ValueError(f"spread = {spread}: must be finite and not negative [m]")


def _result(
    mission: Mission, law: str, ensemble: Ensemble, stride: int, wall_time: float, film: _Film | None
) -> Result:
    steps, step = ensemble.steps, ensemble.time / ensemble.steps
    converged = ensemble.last_out + round(min(DWELL_TIME, 0.5 * steps * step) / step) < steps
    return Result(
        law=law,
        settled=mission.settled,
        settling_time=np.where(converged, (ensemble.last_out + 1) * step, np.nan),
        converged=converged,
        final_error=ensemble.error,
        watched=mission.collisions.mode != "off",
        nearest=ensemble.nearest,
        deadlocks=ensemble.followers["deadlocks"].sum(axis=1),
        time=step * stride * np.arange(len(ensemble.errors), dtype=np.float64),
        error=ensemble.errors,
        wall_time=wall_time,
        robot_steps=ensemble.followers.size * steps,
        history=None if film is None else film.history(law),
    )


class _Film:
    """Stores the moments of the first run."""

    def __init__(self, mission: Mission, ensemble: Ensemble, steps: int) -> None:
        self.pace = max(1, math.ceil(steps * len(mission.names) / MAX_MOMENTS))
        """Steps between two moments."""
        self._mission, self._ensemble = mission, ensemble
        self._moments: list[tuple[Any, ...]] = []
        self.store_moment()

    def store_moment(self) -> None:
        """Store the present moment."""
        now, first = self._ensemble, self._ensemble.followers[0]
        names = ("position", "heading", "estimate", "speed", "turn_rate")
        self._moments.append((now.time, now.error[0], *(first[name].copy() for name in names)))

    def history(self, law: str) -> History:
        """Return all stored moments."""
        columns = [np.array(column) for column in zip(*self._moments, strict=True)]
        times, error, position, heading, estimate, speed, turn_rate = columns
        mission, robots, route = self._mission, self._ensemble.robots, self._ensemble.route
        directions = np.array([route.heading(time) for time in times.tolist()])
        return History(
            title=f"{mission.name}, {law} law",
            names=mission.names,
            edges=tuple((i, j) for i, js in enumerate(mission.graph.neighbours) for j in js),
            offset=robots["offset"],
            max_speed=robots["max_speed"],
            max_turn_rate=robots["max_turn_rate"],
            time=times,
            position=np.column_stack([positions(route, times), position]),
            heading=np.column_stack([directions, heading]),
            heading_error=np.angle(estimate * heading.conj()),
            error=error,
            speed=speed,
            turn_rate=turn_rate,
        )


def _number(value: float | np.floating[Any]) -> float | None:
    return float(value) if math.isfinite(value) else None
