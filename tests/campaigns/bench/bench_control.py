"""How well the laws control: same starts, same limits, same robots; beside the least that any law could take.

python -m tests.campaigns.bench.bench_control [--quick] [--json]

Nothing here depends on the machine or its load: from the same code come the same figures.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from formation.control.arrays import FloatArray
from formation.mission.model import Mission
from formation.simulation.body import PROFILES, Body
from formation.simulation.ensemble import Options
from formation.simulation.simulate import Result
from tests.campaigns.bench import control_curves, lower_bound
from tests.campaigns.bench import control_trials as trials
from tests.campaigns.bench.control_trials import Contender
from tests.campaigns.bench.report_control import section
from tests.campaigns.figures import command, progress, rounded

draw = control_curves.draw
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
    mission = trials.six_robots()
    starts = trials.drawn(mission, effort.runs, trials.SEED)
    soonest = lower_bound.by_distance(mission, starts)
    bodily = lower_bound.by_body(mission, starts)
    moments = np.linspace(0.0, SHOWN, 161)
    found, curves = {}, {}
    for contender in (*trials.CONTENDERS, trials.ROBOTARIUM, trials.SHIPPED):
        result = contender.drive(mission, effort.runs, 40.0)
        found[contender.name] = {
            **trials.figures(result),
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
    limit = trials.six_robots().robots["robot2"].max_speed
    found = {}
    for percent, speed, horizon, step in ((13, 0.2, 30.0, 0.02), (95, 0.95 * limit, 150.0, 0.05)):
        mission = trials.six_robots(leader_speed=speed)
        result = trials.FIELD.drive(mission, effort.many, horizon, step=step)
        found[f"leader at {percent} % of u_max"] = trials.figures(result)
    return found


def on_routes(effort: Effort) -> Any:
    """Every law on every route."""
    found = {}
    for route in list(trials.ROUTES)[:: effort.every]:
        mission = trials.six_robots(route)
        soonest = lower_bound.by_distance(mission, trials.drawn(mission, effort.runs, trials.SEED))
        laws = {
            one.name: trials.figures_of_stays(one.drive(mission, effort.runs, 90.0 / one.patience))
            for one in trials.CONTENDERS
        }
        found[route] = {"bound": _median(soonest), "laws": laws}
    return found


def conditions(effort: Effort) -> Any:
    """Every law under each condition on its own: {condition: {value: {law: figures}}}."""
    mission, every = trials.six_robots(), effort.every
    kinds: dict[str, dict[float, Options]] = {
        "delay": {value: Options(delay=value) for value in DELAYS[::every]},
        "loss": {value: Options(loss=value) for value in LOSSES[::every]},
        "noise": {value: Options(body=Body(position_noise=value)) for value in NOISES[::every]},
    }
    perfect = _under(Options(), mission, effort.runs, (*trials.CONTENDERS, trials.GENTLE))
    found: dict[str, Any] = {}
    for kind, values in kinds.items():
        laws = (*trials.CONTENDERS, trials.GENTLE) if kind == "noise" else trials.CONTENDERS
        found[kind] = {"0.0": {one.name: perfect[one.name] for one in laws}} | {
            str(value): _under(options, mission, effort.runs, laws) for value, options in values.items()
        }
    return {**found, "steps": _steps(mission, effort.runs)}


def _under(options: Options, mission: Mission, runs: int, laws: Sequence[Contender]) -> dict[str, Any]:
    """Figures of laws under one condition."""
    return {one.name: trials.figures(one.drive(mission, runs, 30.0, options)) for one in laws}


def _steps(mission: Mission, runs: int) -> Any:
    """Commands cut to hundredths by the robots; and the same where the agents know of it."""
    cut = Options(body=Body(speed_step=STEP_OF_COMMANDS, turn_rate_step=STEP_OF_COMMANDS))
    reported = {"speed_step": STEP_OF_COMMANDS, "turn_rate_step": STEP_OF_COMMANDS}
    aware = trials.varied(
        mission, robots={name: {**robot.model_dump(), **reported} for name, robot in mission.robots.items()}
    )
    fed_back = _under(cut, aware, runs, [trials.FIELD])[trials.FIELD.name]
    return {**_under(cut, mission, runs, trials.CONTENDERS), "field law, error feedback": fed_back}


def saturation(effort: Effort) -> Any:
    """Laws behind faster and faster leaders: share, settling and mean rate of convergence."""
    limit = trials.six_robots().robots["robot2"].max_speed
    found, laws = {}, (trials.FIELD, trials.PAPER, trials.SHIPPED)
    for ratio in RATIOS[:: effort.every]:
        mission = trials.six_robots(leader_speed=limit / ratio)
        starts = trials.drawn(mission, effort.runs, trials.SEED)
        pace = 1.0 - 1.0 / ratio  # how fast a follower catches up, of its top speed
        horizon = 20.0 + 8.0 / pace
        found[str(ratio)] = {
            "bound": _percentiles(lower_bound.by_body(mission, starts, step=0.05 if ratio < 2.0 else 0.02)),
            "horizon": {one.name: one.patience * horizon for one in laws},
            **{one.name: _with_rate(one.drive(mission, effort.runs, horizon)) for one in laws},
        }
    return found


def _with_rate(result: Result) -> Any:
    """Figures and the rate at which the error fell from the first to the bound, on average [1/s]."""
    rates = np.log(result.error[0] / result.settled) / result.settling_time
    settled = trials.figures(result)
    if settled["share"] < 0.5:
        return {**settled, "rate": None}
    return {**settled, "rate": np.percentile(rates[np.isfinite(rates)], QUARTILES).tolist()}


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


CHAINS: dict[str, tuple[Contender, Options]] = {
    "field law": (trials.FIELD, Options()),
    "field law, 100 ms": (trials.FIELD, Options(delay=0.1)),
    "field law, 300 ms": (trials.FIELD, Options(delay=0.3)),
    "field law, 30 % lost": (trials.FIELD, Options(loss=0.3)),
    "field law, TurtleBot3": (trials.FIELD, Options(body=PROFILES["turtlebot3_burger"])),
    "paper's law": (trials.PAPER, Options()),
    "paper's law, 100 ms": (trials.PAPER, Options(delay=0.1)),
    "proportional, gain 10": (trials.PROPORTIONAL, Options()),
    "proportional, gain 10, 100 ms": (trials.PROPORTIONAL, Options(delay=0.1)),
    "proportional, gain 40": (trials.STIFF, Options()),
    "proportional, gain 40, 100 ms": (trials.STIFF, Options(delay=0.1)),
}


def chains(effort: Effort) -> Any:
    """Each robot's distance from its slot, RMS over the last third [m], by hops from the leader.

    No robot receives those behind, so one chain of fifty is every shorter chain as well.
    """
    mission, found = trials.circling_chain(effort.chain), {}
    for name, (contender, options) in CHAINS.items():
        seconds = effort.chain_time / contender.patience
        result = contender.drive(mission, 1, seconds, options, starts="mission", keep=True)
        found[name] = np.fmin(trials.slot_errors(mission, result)[1:], 1e6).tolist()
    return found


GRID: dict[str, tuple[float, ...]] = {
    "gain": (2.0, 4.0, 6.0, 8.0, 12.0, 16.0),
    "velocity_filter": (0.02, 0.04, 0.1),
}
"""Tried in all combinations."""
ROUGH = Options(delay=0.1, body=Body(position_noise=0.005))
"""Where parameters that are too sharp show: samples 100 ms old, positions off by 5 mm."""
STAR_GAINS = (4.0, 8.0, 12.0)
PEER_GAINS = (1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0)


def search(effort: Effort) -> Any:
    """Field-law parameters, the same for all starts: settling, and what error is left in a rough world."""
    runs = max(20, effort.runs // 5)
    mission = trials.six_robots()
    bound = float(np.median(lower_bound.by_distance(mission, trials.drawn(mission, runs, trials.SEED))))
    grid = [dict(zip(GRID, values, strict=True)) for values in itertools.product(*GRID.values())]
    tried = []
    for parameters in ({}, *grid[:: effort.every**2]):
        one = Contender("field law", "field", parameters)
        calm = trials.figures(one.drive(mission, runs, 25.0))
        rough = trials.figures(one.drive(mission, max(20, runs // 3), 25.0, ROUGH))
        tried.append({"parameters": parameters, "calm": calm, "rough": rough})
    return {"runs": runs, "bound": bound, "tried": tried, "star": _star(mission, runs)}


def _star(mission: Mission, runs: int) -> Any:
    """What the graph costs: the same with every robot measuring the leader itself."""
    leader = [mission.leader]
    robots = {
        name: {**robot.model_dump(), "neighbours": leader if name in mission.followers else []}
        for name, robot in mission.robots.items()
    }
    star = trials.varied(mission, robots=robots)
    return {
        str(gain): trials.figures(Contender("field law", "field", {"gain": gain}).drive(star, runs, 25.0))
        for gain in STAR_GAINS
    }


def peer_gains(effort: Effort) -> Any:
    """Gains of the proportional law: what settles, and what error is left, with and without delay."""
    mission, runs = trials.six_robots(), max(20, effort.runs // 5)
    found = {}
    for gain in PEER_GAINS[:: effort.every]:
        one = Contender("proportional", trials.NEAR_IDENTITY, {**trials.UNAIDED, "k_p": gain})
        found[str(gain)] = {
            name: trials.figures(one.drive(mission, runs, 30.0, Options(delay=delay)))
            for name, delay in (("calm", 0.0), ("late", 0.1))
        }
    return found


QUICK = Effort(runs=24, many=100, every=4, chain=12, chain_time=60.0)
PARTS = {
    "laws": laws,
    "convergence": convergence,
    "routes": on_routes,
    "conditions": conditions,
    "saturation": saturation,
    "chains": chains,
    "parameters": search,
    "peer gains": peer_gains,
}


def measure(_rounds: int, effort: Effort | None = None) -> Any:
    """All figures: rounds would not differ."""
    found = {}
    for name, part in PARTS.items():
        began = time.perf_counter()
        found[name] = rounded(part(effort or Effort()))
        progress(f"{name}: {time.perf_counter() - began:.0f} s")
    return found


if __name__ == "__main__":
    command(__doc__, measure, section, effort=QUICK)
