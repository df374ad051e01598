"""How well the laws control: same starts, same limits, same robots; beside the least that any law could take.

python -m tests.campaigns.bench.bench_control [--quick] [--json] [--figures FOLDER]

Nothing here depends on the machine or its load: from the same code come the same figures.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from formation.control.arrays import FloatArray
from formation.mission.model import Mission
from formation.simulation.body import PROFILES, Body
from formation.simulation.ensemble import Options
from formation.simulation.simulate import Result
from tests.campaigns.bench import lower_bound
from tests.campaigns.bench.control_curves import draw
from tests.campaigns.bench.control_trials import (
    CONTENDERS,
    FIELD,
    GENTLE,
    NEAR_IDENTITY,
    PAPER,
    PROPORTIONAL,
    ROBOTARIUM,
    ROUTES,
    SEED,
    STIFF,
    UNAIDED,
    Contender,
    circling_chain,
    drawn,
    figures,
    figures_of_stays,
    six_robots,
    slot_errors,
    varied,
)
from tests.campaigns.bench.report_control import section
from tests.campaigns.figures import rounded, show

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
    mission = six_robots()
    starts = drawn(mission, effort.runs, SEED)
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
    limit = six_robots().robots["robot2"].max_speed
    cases = {
        "leader at 13 % of u_max": (0.2, 30.0, 0.02),
        "leader at 95 % of u_max": (0.95 * limit, 150.0, 0.05),
    }
    return {
        name: figures(FIELD.drive(six_robots(leader_speed=speed), effort.many, horizon, step=step))
        for name, (speed, horizon, step) in cases.items()
    }


def on_routes(effort: Effort) -> Any:
    """Every law on every route."""
    found = {}
    for route in list(ROUTES)[:: effort.every]:
        mission = six_robots(route)
        soonest = lower_bound.by_distance(mission, drawn(mission, effort.runs, SEED))
        results = {one.name: one.drive(mission, effort.runs, 90.0 / one.patience) for one in CONTENDERS}
        found[route] = {
            "bound": _median(soonest),
            "laws": {name: figures_of_stays(result) for name, result in results.items()},
        }
    return found


def conditions(effort: Effort) -> Any:
    """Every law under each condition on its own: {condition: {value: {law: figures}}}."""
    mission, every = six_robots(), effort.every
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
    aware = varied(
        mission, robots={name: {**robot.model_dump(), **reported} for name, robot in mission.robots.items()}
    )
    fed_back = _under(cut, aware, runs, [FIELD])[FIELD.name]
    return {**_under(cut, mission, runs, CONTENDERS), "field law, error feedback": fed_back}


def saturation(effort: Effort) -> Any:
    """Both laws behind faster and faster leaders: share, settling and mean rate of convergence."""
    limit = six_robots().robots["robot2"].max_speed
    found = {}
    for ratio in RATIOS[:: effort.every]:
        mission = six_robots(leader_speed=limit / ratio)
        starts = drawn(mission, effort.runs, SEED)
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


CHAINS: dict[str, tuple[Contender, Options]] = {
    "field law": (FIELD, Options()),
    "field law, 100 ms": (FIELD, Options(delay=0.1)),
    "field law, 300 ms": (FIELD, Options(delay=0.3)),
    "field law, 30 % lost": (FIELD, Options(loss=0.3)),
    "field law, TurtleBot3": (FIELD, Options(body=PROFILES["turtlebot3_burger"])),
    "paper's law": (PAPER, Options()),
    "paper's law, 100 ms": (PAPER, Options(delay=0.1)),
    "proportional, gain 10": (PROPORTIONAL, Options()),
    "proportional, gain 10, 100 ms": (PROPORTIONAL, Options(delay=0.1)),
    "proportional, gain 40": (STIFF, Options()),
    "proportional, gain 40, 100 ms": (STIFF, Options(delay=0.1)),
}


def chains(effort: Effort) -> Any:
    """Each robot's distance from its slot, RMS over the last third [m], by hops from the leader.

    Nobody hears those behind, so one chain of fifty is every shorter chain as well.
    """
    mission = circling_chain(effort.chain)
    found = {}
    for name, (contender, options) in CHAINS.items():
        result = contender.drive(
            mission, 1, effort.chain_time / contender.patience, options, starts="mission", keep=True
        )
        errors = slot_errors(mission, result)[1:]
        found[name] = np.fmin(errors, 1e6).tolist()
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
    mission = six_robots()
    bound = float(np.median(lower_bound.by_distance(mission, drawn(mission, runs, SEED))))
    grid = [dict(zip(GRID, values, strict=True)) for values in itertools.product(*GRID.values())]
    tried = []
    for parameters in ({}, *grid[:: effort.every**2]):
        one = Contender("field law", "field", parameters)
        calm = figures(one.drive(mission, runs, 25.0))
        rough = figures(one.drive(mission, max(20, runs // 3), 25.0, ROUGH))
        tried.append({"parameters": parameters, "calm": calm, "rough": rough})
    return {"runs": runs, "bound": bound, "tried": tried, "star": _star(mission, runs)}


def _star(mission: Mission, runs: int) -> Any:
    """What the graph costs: the same with every robot measuring the leader itself."""
    leader = [mission.leader]
    robots = {
        name: {**robot.model_dump(), "neighbours": leader if name in mission.followers else []}
        for name, robot in mission.robots.items()
    }
    star = varied(mission, robots=robots)
    return {
        str(gain): figures(Contender("field law", "field", {"gain": gain}).drive(star, runs, 25.0))
        for gain in STAR_GAINS
    }


def peer_gains(effort: Effort) -> Any:
    """Gains of the proportional law: what settles, and what error is left, with and without delay."""
    mission, runs = six_robots(), max(20, effort.runs // 5)
    found = {}
    for gain in PEER_GAINS[:: effort.every]:
        one = Contender("proportional", NEAR_IDENTITY, {**UNAIDED, "k_p": gain})
        found[str(gain)] = {
            name: figures(one.drive(mission, runs, 30.0, Options(delay=delay)))
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


def measure(effort: Effort) -> Any:
    """All figures; what it takes goes to stderr."""
    found = {}
    for name, part in PARTS.items():
        began = time.perf_counter()
        found[name] = rounded(part(effort))
        print(f"{name}: {time.perf_counter() - began:.0f} s", file=sys.stderr)
    return found


def main() -> None:
    """Print the figures, and draw those that are curves."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="few starts, few points: only a hint")
    parser.add_argument("--json", action="store_true", help="figures for programs, not for people")
    parser.add_argument("--figures", type=Path, help="draw the curves into this folder")
    arguments = parser.parse_args()
    found = measure(QUICK if arguments.quick else Effort())
    if arguments.figures:
        draw(found, arguments.figures)
    show(found, section, as_json=arguments.json)


if __name__ == "__main__":
    main()
