"""The collision filter with imperfect sensing: does it leave robots behind, do bodies touch?"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from formation.mission.model import Mission
from formation.simulation.body import Body
from formation.simulation.ensemble import Options as Simulated
from formation.simulation.simulate import simulate
from formation.slots.shapes import SHAPES
from tests.campaigns.document import Found
from tests.campaigns.parts import table
from tests.campaigns.safety.missions import made
from tests.campaigns.safety.part import Options, bar, reported
from tests.support.missions import with_robots

TITLE = "Imperfect sensing"
NOISES, DELAYS = (0.0, 0.001, 0.002, 0.005), (0.0, 0.05, 0.1, 0.2)
"""Standard deviation of positions per axis [m]; age of others' positions [s]."""
SEVEN, SEVEN_RUNS, SEVEN_DELAY = 7, 200, 0.1  # robots, starts and delay [s] of the second table
RUNS, HORIZON, LEFT_BEHIND = 400, 120.0, 1.0
"""Starts of each; [s]; a final error above this is a robot left behind [m]."""
ABOUT = f"""\
`six_robots` with `avoid = "all"` in `formation simulate`'s own loop, {RUNS} random starts of {HORIZON:g} s
for each pair of noise (of every position, standard deviation per axis) and delay (of all that robots receive
of each other), with the collision filter. The mission states the noise where it is more than the default. A
run *leaves robots behind* when its error, summed over edges, is above {LEFT_BEHIND:g} m at the end. The
second table has seven TurtleBots, as `formation new` makes the mission, in each shape, {SEVEN_RUNS} starts
each with {1e3 * NOISES[-1]:g} mm of noise, which the mission states, and {1e3 * SEVEN_DELAY:g} ms of
delay."""


def run(options: Options) -> Found:
    runs, seven_runs, shapes = (20, 10, 2) if options.quick else (RUNS, SEVEN_RUNS, len(SHAPES))
    pairs = reported("imperfect", list(product(NOISES, DELAYS)))
    six = with_robots("six_robots", avoid="all")
    cells = [cell(six, noise, delay, runs) for noise, delay in pairs]
    seven = [
        cell(made(shape, SEVEN, "turtlebot3_burger"), NOISES[-1], SEVEN_DELAY, seven_runs)
        for shape in reported("seven TurtleBots", list(SHAPES)[:shapes])
    ]
    return {"cells": cells, "seven": seven, "bars": [*bars(cells), *bars(seven)]}


def cell(
    mission: Mission, noise: float, delay: float, runs: int, horizon: float = HORIZON, seed: int = 0
) -> Found:
    """What became of `runs` random starts with this `noise` [m] and `delay` [s]."""
    stated = max(noise, mission.collisions.noise)
    rules = mission.collisions.model_copy(update={"noise": stated})
    mission = mission.model_copy(update={"collisions": rules})
    options = Simulated(delay=delay, body=Body.of(mission.simulated_robot)._replace(position_noise=noise))
    result = simulate(mission, runs=runs, seed=seed, starts="random", horizon=horizon, options=options)
    return {
        "mission": mission.name,
        "noise": noise,
        "delay": delay,
        "runs": runs,
        "left": int((~(result.final_error <= LEFT_BEHIND)).sum()),
        "touched": int((result.nearest < 0.0).sum()),
        "nearest": float(result.nearest.min()),
        "error": float(np.median(result.final_error)),
        "deadlocks": int(result.deadlocks.sum()),
    }


def bars(cells: Sequence[Found]) -> list[Found]:
    """None left behind and no touch, in any cell."""
    kind = "pairs of noise and delay" if cells[0]["mission"] == "six-robots" else "shapes of seven"
    left, touched = (sum(one[what] for one in cells) for what in ("left", "touched"))
    words = f"no robot left behind, {len(cells)} {kind}, {cells[0]['runs']} starts each"
    return [
        bar(words, f"{left} runs leave robots behind", left == 0),
        bar("no two bodies touch in any of them", f"{touched} runs touch", touched == 0),
    ]


def section(found: Found) -> str:
    header = (
        "noise | delay | runs that leave robots behind | runs that touch | nearest bodies | "
        "median error at the end | deadlocks"
    )
    seven = table(f"mission | {header}", [f"{one['mission']} | {_row(one)}" for one in found["seven"]])
    return f"{table(header, map(_row, found['cells']))}\n{seven}"


def _row(one: Found) -> str:
    return (
        f"{1e3 * one['noise']:g} mm | {1e3 * one['delay']:g} ms | {one['left']} of {one['runs']} | "
        f"{one['touched']} of {one['runs']} | {100 * one['nearest']:.1f} cm | {100 * one['error']:.1f} cm | "
        f"{one['deadlocks']}"
    )
