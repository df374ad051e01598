"""One trial of the control benchmarks: a law, a mission, many starts; and the figures that come of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from formation.control.arrays import FloatArray
from formation.control.controller import Controller
from formation.mission.model import Mission
from formation.simulation.ensemble import Options
from formation.simulation.simulate import DWELL_TIME, Result, simulate
from tests.campaigns.bench import routes
from tests.campaigns.bench.proportional import NEAR_IDENTITY, TURNING

SEED = 0
UNAIDED: dict[str, Any] = {"feed_forward": False, "delay_compensation": False}
"""Neighbours are taken to be where they were last seen, and to stand still."""


@dataclass(frozen=True)
class Contender:
    """A law with its parameters."""

    name: str
    law: str | Controller
    parameters: dict[str, Any] = field(default_factory=dict)
    """As in [law]; the mission's where nothing is said."""
    patience: float = 1.0
    """How many times longer than the field law it is given."""

    def of(self, mission: Mission) -> Mission:
        """The mission with this law's parameters."""
        return routes.varied(mission, law={**mission.law.model_dump(), **self.parameters})

    def drive(
        self,
        mission: Mission,
        runs: int,
        horizon: float,
        options: Options | None = None,
        step: float = 0.02,
        *,
        starts: Literal["mission", "random"] = "random",
        keep: bool = False,
    ) -> Result:
        """`runs` starts, the same for every law, for `horizon` [s] times its patience."""
        return simulate(
            self.of(mission),
            law=self.law,
            runs=runs,
            seed=SEED,
            options=options,
            horizon=horizon * self.patience,
            step=step,
            starts=starts,
            keep=keep,
        )


FIELD = Contender("field law", "field")
PAPER = Contender("paper's law", "paper", patience=3.0)
PROPORTIONAL = Contender("proportional, gain 10", NEAR_IDENTITY, {**UNAIDED, "k_p": 10.0})
STIFF = Contender("proportional, gain 40", NEAR_IDENTITY, {**UNAIDED, "k_p": 40.0})
GENTLE = Contender("field law, gentle", "field", {"velocity_filter": 0.5, "observer_gain": 2.0})
ROBOTARIUM = Contender("proportional, gain 10, turning first", TURNING, {**UNAIDED, "k_p": 10.0})
CONTENDERS = (FIELD, PAPER, PROPORTIONAL, STIFF)
"""Those of every comparison; the gentle one is for noise, the one that turns first for the first table."""


def figures(result: Result) -> dict[str, Any]:
    """How many settle for good, how fast, and what error remains in the second half."""
    return {"runs": len(result.converged), **_settled(result.settling_time), **_remaining(result)}


def figures_of_stays(result: Result) -> dict[str, Any]:
    """The same with lasting disturbances: settled is under the bound for `DWELL_TIME` in a row."""
    return {"runs": len(result.converged), **_settled(first_stay(result)), **_remaining(result)}


def first_stay(result: Result) -> FloatArray:
    """When each run first went under the bound for at least `DWELL_TIME` [s], NaN where never; shape (R,)."""
    moments, runs = result.error.shape
    long = max(1, round(DWELL_TIME / (result.time[1] - result.time[0])))
    under = np.cumsum(np.vstack([np.zeros(runs), result.error < result.settled]), axis=0)
    stays = under[long:] - under[:-long] == long
    first = result.time[: moments - long + 1][stays.argmax(axis=0)]
    return np.where(stays.any(axis=0), first, np.nan)


def _settled(times: FloatArray) -> dict[str, Any]:
    """Share, and quantiles of the time of those that did [s]; None under half."""
    share = float(np.isfinite(times).mean())
    known = times[np.isfinite(times)]
    names = ("q25", "median", "q75", "p95", "max")
    if share < 0.5:
        return {"share": share, "settling": dict.fromkeys(names)}
    quantiles = np.percentile(known, (25, 50, 75, 95, 100)).tolist()
    return {"share": share, "settling": dict(zip(names, quantiles, strict=True))}


def _remaining(result: Result) -> dict[str, Any]:
    """Formation error in the second half: each run's root mean square and peak [m], medians of all runs."""
    late = np.minimum(result.error[len(result.error) // 2 :], 1e6)
    return {
        "rms": float(np.median(np.sqrt(np.square(late).mean(axis=0)))),
        "peak": float(np.median(late.max(axis=0))),
    }
