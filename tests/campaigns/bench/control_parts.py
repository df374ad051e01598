"""What the control benchmarks measure: laws, convergence, routes, conditions, saturation; as JSON has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from formation.control.arrays import FloatArray
from formation.mission.model import Mission
from formation.simulation.body import Body
from formation.simulation.ensemble import Options
from formation.simulation.simulate import Result
from tests.campaigns.bench import lower_bound, routes
from tests.campaigns.bench.control_trials import (
    CONTENDERS,
    FIELD,
    GENTLE,
    PAPER,
    ROBOTARIUM,
    SEED,
    Contender,
    figures,
    figures_of_stays,
)

SHOWN = 40.0
"""Of the error over time [s]."""
QUARTILES = (25.0, 50.0, 75.0)
RATIOS = (1.05, 1.1, 1.2, 1.35, 1.6, 2.0, 3.0, 5.0, 7.5, 10.0)
"""u_max over the leader's speed; the shipped mission has 7.5."""
DELAYS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8)
LOSSES = (0.1, 0.2, 0.3, 0.4, 0.5)
NOISES = (0.001, 0.002, 0.005, 0.01, 0.02)
STEP_OF_COMMANDS = 0.01


@dataclass(frozen=True)
class Effort:
    """How much to run."""

    runs: int = 1000
    many: int = 10_000
    every: int = 1
    """Only each so-many-th point of a curve."""
    chain: int = 50
    """Followers of the deepest chain."""
    chain_time: float = 240.0
    """[s]"""


def laws(effort: Effort) -> Any:
    """Every law from the same starts on the shipped mission, the least that any could take, the curves."""
    mission = routes.six_robots()
    starts = routes.drawn(mission, effort.runs, SEED)
    soonest = lower_bound.by_distance(mission, starts)
    bodily = lower_bound.by_body(mission, starts)
    moments = np.linspace(0.0, SHOWN, 161)
    found, curves = {}, {}
    for contender in (*CONTENDERS, ROBOTARIUM):
        result = contender.drive(mission, effort.runs, 40.0)
        found[contender.name] = {
            **figures(result),
            "of the bound": _median(result.settling_time / soonest),
            "times": _percentiles(result.settling_time),
        }
        curves[contender.name] = _curve(result, moments)
    return {
        "found": found,
        "bounds": {"by distance": _percentiles(soonest), "by body": _percentiles(bodily)},
        "moments": moments.tolist(),
        "curves": curves,
    }


def convergence(effort: Effort) -> Any:
    """The field law from very many starts, also behind a leader at 95 % of the followers' top speed."""
    limit = routes.six_robots().robots["robot2"].max_speed
    cases = {
        "leader at 13 % of u_max": (0.2, 30.0, 0.02),
        "leader at 95 % of u_max": (0.95 * limit, 150.0, 0.05),
    }
    return {
        name: figures(FIELD.drive(routes.six_robots(leader_speed=speed), effort.many, horizon, step=step))
        for name, (speed, horizon, step) in cases.items()
    }


def on_routes(effort: Effort) -> Any:
    """Every law on every route."""
    found = {}
    for route in list(routes.ROUTES)[:: effort.every]:
        mission = routes.six_robots(route)
        soonest = lower_bound.by_distance(mission, routes.drawn(mission, effort.runs, SEED))
        results = {one.name: one.drive(mission, effort.runs, 90.0 / one.patience) for one in CONTENDERS}
        found[route] = {
            "bound": _median(soonest),
            "laws": {name: figures_of_stays(result) for name, result in results.items()},
        }
    return found


def conditions(effort: Effort) -> Any:
    """Every law under each condition on its own: {condition: {value: {law: figures}}}."""
    mission, every = routes.six_robots(), effort.every
    kinds: dict[str, dict[float, Options]] = {
        "delay": {value: Options(delay=value) for value in DELAYS[::every]},
        "loss": {value: Options(loss=value) for value in LOSSES[::every]},
        "noise": {value: Options(body=Body(position_noise=value)) for value in NOISES[::every]},
    }
    perfect = _under(Options(), mission, effort.runs, (*CONTENDERS, GENTLE))
    found: dict[str, Any] = {}
    for kind, values in kinds.items():
        laws = (*CONTENDERS, GENTLE) if kind == "noise" else CONTENDERS
        found[kind] = {"0.0": {one.name: perfect[one.name] for one in laws}} | {
            str(value): _under(options, mission, effort.runs, laws) for value, options in values.items()
        }
    return {**found, "steps": _steps(mission, effort.runs)}


def _under(options: Options, mission: Mission, runs: int, laws: Sequence[Contender]) -> dict[str, Any]:
    """Figures of laws under one condition."""
    return {one.name: figures(one.drive(mission, runs, 30.0, options)) for one in laws}


def _steps(mission: Mission, runs: int) -> Any:
    """Commands cut to hundredths by the robots; and the same where the agents know of it."""
    cut = Options(body=Body(speed_step=STEP_OF_COMMANDS, turn_rate_step=STEP_OF_COMMANDS))
    reported = {"speed_step": STEP_OF_COMMANDS, "turn_rate_step": STEP_OF_COMMANDS}
    aware = routes.varied(
        mission, robots={name: {**robot.model_dump(), **reported} for name, robot in mission.robots.items()}
    )
    fed_back = _under(cut, aware, runs, [FIELD])[FIELD.name]
    return {**_under(cut, mission, runs, CONTENDERS), "field law, error feedback": fed_back}


def saturation(effort: Effort) -> Any:
    """Both laws behind faster and faster leaders: share, settling and mean rate of convergence."""
    limit = routes.six_robots().robots["robot2"].max_speed
    found = {}
    for ratio in RATIOS[:: effort.every]:
        mission = routes.six_robots(leader_speed=limit / ratio)
        starts = routes.drawn(mission, effort.runs, SEED)
        pace = 1.0 - 1.0 / ratio  # how fast a follower catches up, of its top speed
        horizon = 20.0 + 8.0 / pace
        found[str(ratio)] = {
            "bound": _percentiles(lower_bound.by_body(mission, starts, step=0.05 if ratio < 2.0 else 0.02)),
            "horizon": {one.name: one.patience * horizon for one in (FIELD, PAPER)},
            **{one.name: _with_rate(one.drive(mission, effort.runs, horizon)) for one in (FIELD, PAPER)},
        }
    return found


def _with_rate(result: Result) -> Any:
    """Figures and the rate at which the error fell from the first to the bound, on average [1/s]."""
    rates = np.log(result.error[0] / result.settled) / result.settling_time
    known = rates[np.isfinite(rates)]
    settled = figures(result)
    enough = settled["share"] >= 0.5
    return {**settled, "rate": np.percentile(known, QUARTILES).tolist() if enough else None}


def _curve(result: Result, moments: FloatArray) -> Any:
    """Quartiles of the error over time [m]; None where the run had ended."""
    quartiles = np.percentile(np.minimum(result.error, 1e6), QUARTILES, axis=1)
    shown = moments[moments <= result.time[-1]]
    return np.array([np.interp(shown, result.time, quartile) for quartile in quartiles]).T.tolist()


def _percentiles(times: FloatArray) -> list[float | None]:
    """0, 5, … 100 % of all starts; None for those that never settled."""
    settled = np.sort(np.where(np.isnan(times), np.inf, times))
    picked = settled[np.round(np.linspace(0, len(settled) - 1, 21)).astype(int)]
    return [float(time) if np.isfinite(time) else None for time in picked]


def _median(values: FloatArray) -> float | None:
    """The middle of all, None where it is that of a start that never settled."""
    middle = float(np.median(np.where(np.isnan(values), np.inf, values)))
    return middle if np.isfinite(middle) else None
