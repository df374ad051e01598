"""What the yardstick measures: scenarios, laws with the gains that are tried, and the figures of one cell.

Robots are points that follow commands at once, within u_max and ω_max, without collision filter and ramp, so
that only the law differs. All laws but the paper's get the same filtered poses and the same tracks of their
neighbours; each uses the velocities as it is made to. No law knows the leader's orders.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from types import FunctionType, MappingProxyType
from typing import Any

import numpy as np

from formation.control.arrays import FloatArray
from formation.control.controller import Controller, Gains, Limits, Measured
from formation.control.laws import LAWS
from formation.control.plane import rotation
from formation.mission.model import Mission
from formation.simulation.body import Body
from formation.simulation.compiled import compiled
from formation.simulation.edges import Edges
from formation.simulation.ensemble import Ensemble, Options, positions, random_starts
from tests.campaigns.bench.control_trials import HEADING, NEAR_IDENTITY, SPEED, UNAIDED, first_stay, varied
from tests.campaigns.bench.yardstick_laws import FOLLOWER, PREDICTIVE
from tests.unit.formation import scenarios

STEP, STRIDE = 0.02, 2
"""Control period [s], and steps between stored moments."""
SETTLED = 0.05
"""Bound under which every edge's error must be for `DWELL_TIME` [m]."""
SEED, TUNING_SEED = 0, 1
MAX_ERROR = 100.0
"""Errors of a run that runs away count as this [m]."""
LEAST_RMS = 1e-3
"""A smaller RMS counts as this when gains are compared [m]."""
QUARTER, WHOLE = 0.5 * math.pi / SPEED, 2.0 * math.pi / SPEED
"""Duration of a quarter and of a whole circle of 1 m [s]."""


def circle(turn: str = "left", duration: float | None = None, **heading: float) -> dict[str, Any]:
    """A leg along a circle of 1 m."""
    return {"radius": 1.0, "speed": SPEED, "turn": turn, "duration": duration, **heading}


def alternating(turns: Sequence[str], duration: float) -> list[dict[str, Any]]:
    """Circles one after the other, each for `duration` [s]."""
    first, *others = (circle(turn, duration) for turn in turns)
    return [{**first, "heading_deg": HEADING}, *others]


def straight(speed: float, heading: float, duration: float | None = None) -> dict[str, Any]:
    """A straight leg at `speed` [m/s]."""
    return {"speed": speed, "heading_deg": heading, "duration": duration}


def on(route: list[dict[str, Any]]) -> Mission:
    """Six robots in a hexagon with 1 m sides, two neighbours each; the leader on a route."""
    return varied(scenarios.six(), route=route)


def chain() -> Mission:
    """Twelve robots in a line behind a leader that changes its speed every 20 s."""
    speeds = (0.15, 0.05) * 4
    mission = scenarios.chain(11, straight(0.15, 0.0), {}, 1.0)
    return varied(mission, route=[straight(speed, 0.0, 20.0) for speed in speeds])


@dataclass(frozen=True)
class Scenario:
    """One line of the table."""

    build: Callable[[], Mission]
    horizon: float = 80.0
    """[s]"""
    options: Options = field(default_factory=Options)


_CIRCLE = partial(on, [circle(heading_deg=HEADING)])
SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {
        "straight": Scenario(partial(on, [straight(SPEED, HEADING)])),
        "circle": Scenario(_CIRCLE),
        "S-curves": Scenario(partial(on, alternating(("left", "right") * 6, QUARTER))),
        "square": Scenario(
            partial(on, [straight(SPEED, HEADING + 90.0 * corner, 20.0) for corner in range(5)])
        ),
        "figure eight": Scenario(partial(on, alternating(("left", "right", "left"), WHOLE))),
        "stop and go": Scenario(partial(on, [straight(speed, HEADING, 16.0) for speed in (SPEED, 0.0) * 3])),
        "chain of 12": Scenario(chain, 120.0),
        "circle, 5 mm of noise": Scenario(_CIRCLE, options=Options(body=Body(position_noise=0.005))),
        "circle, 100 ms late": Scenario(_CIRCLE, options=Options(delay=0.1)),
        "circle, 30 % lost": Scenario(_CIRCLE, options=Options(loss=0.3)),
    }
)
TUNED_ON = ("straight", "square", "circle, 5 mm of noise", "circle, 100 ms late")


@dataclass(frozen=True)
class Law:
    """A law, and the gains that are tried: every combination of the values of its keys of [law]."""

    controller: Controller
    tried: Mapping[str, tuple[float, ...]]
    fixed: Mapping[str, Any] = field(default_factory=dict)
    """Other keys of [law]."""
    shapeless: bool = False
    """Whether each robot measures only the one before it, and keeps a distance to it."""

    def mission(self, mission: Mission, gains: Mapping[str, float]) -> Mission:
        """The mission with this law's parameters."""
        law = {**mission.law.model_dump(), **self.fixed, **gains}
        if not self.shapeless:
            return varied(mission, law=law)
        robots = {name: robot.model_dump() for name, robot in mission.robots.items()}
        for before, name in pairwise(mission.names):
            robots[name]["neighbours"] = [before]
        return varied(mission, law=law, robots=robots)


LAW: Mapping[str, Law] = MappingProxyType(
    {
        "field": Law(LAWS["field"], {"gain": (4.0, 6.0, 8.0, 12.0, 16.0, 24.0)}),
        "paper": Law(LAWS["paper"], {"k_p": (2.0, 4.0, 8.0), "k_i": (0.2, 1.0)}),
        "proportional + feed-forward": Law(LAWS["proportional"], {"k_p": (1.0, 2.0, 3.0, 4.0, 6.0, 8.0)}),
        "Robotarium": Law(NEAR_IDENTITY, {"k_p": (2.5, 5.0, 10.0, 20.0, 40.0, 60.0)}, UNAIDED),
        "follower": Law(FOLLOWER, {"k_p": (2.0, 4.0, 8.0), "k_i": (4.0, 8.0)}, shapeless=True),
        "predictive": Law(PREDICTIVE, {"k_p": (5.0, 10.0, 20.0), "k_i": (0.001, 0.01)}),
    }
)


def edge_errors(
    scenario: Scenario, law: Law, gains: Mapping[str, float], runs: int, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Errors of displacements over the scenario's edges, and of distances over the law's own edges [m].

    Shapes (T, R, E).
    """
    given = scenario.build()
    driven = law.mission(given, gains)
    steps = STRIDE * (round(scenario.horizon / STEP) // STRIDE)
    starts = random_starts(given, runs, given.simulation.spread, np.random.default_rng(seed))
    ensemble = Ensemble(
        driven, law.controller, scenario.options, starts, STEP,
        np.random.default_rng(seed + 1000), steps, steps,
    )  # fmt: skip
    offset, points = ensemble.robots["offset"], []
    for _ in range(steps // STRIDE):
        ensemble.run_on(STRIDE)
        points.append(ensemble.followers["position"] + offset * ensemble.followers["heading"])
    leader = positions(ensemble.route, STEP * STRIDE * np.arange(1, len(points) + 1, dtype=np.float64))
    shape = len(points), runs, 1
    all_points = np.concatenate([np.broadcast_to(leader[:, None, None], shape), np.array(points)], axis=2)
    slots, edges, own = np.array(given.slots()), Edges(given.graph), Edges(driven.graph)
    displaced = np.abs(edges.along_edges(all_points) - edges.along_edges(slots))
    distant = np.abs(np.abs(own.along_edges(all_points)) - np.abs(own.along_edges(slots)))
    displaced, distant = (
        np.nan_to_num(one, nan=MAX_ERROR).clip(max=MAX_ERROR) for one in (displaced, distant)
    )
    return displaced, distant


def figures(displaced: FloatArray, distant: FloatArray) -> dict[str, Any]:
    """Figures of one cell, from the `edge_errors` of all runs: medians of the runs [m, s]."""
    third, half = displaced[len(displaced) * 2 // 3 :], displaced[len(displaced) // 2 :]
    moments = STEP * STRIDE * np.arange(1.0, len(displaced) + 1.0)
    times = first_stay(displaced.max(axis=2), moments, SETTLED)
    known = times[np.isfinite(times)]
    median, upper = np.percentile(known, (50.0, 95.0)).tolist() if len(known) else (None, None)
    return {
        "rms": float(np.median(np.sqrt(np.square(third).mean(axis=(0, 2))))),
        "distance": float(np.median(np.sqrt(np.square(distant[len(distant) * 2 // 3 :]).mean(axis=(0, 2))))),
        "peak": float(np.median(half.max(axis=(0, 2)))),
        "share": float(np.isfinite(times).mean()),
        "median": median,
        "p95": upper,
    }


def cost(cells: Mapping[str, Mapping[str, Any]], *, shapeless: bool) -> float:
    """What is compared when gains are chosen: geometric mean over scenarios of RMS [m] × settling time [s].

    The settling time is the median of the runs; where under half settle, the horizon. For a law without shape
    the RMS is that of distances.
    """
    products = [
        max(cell["distance" if shapeless else "rms"], LEAST_RMS)
        * (cell["median"] if cell["share"] >= 0.5 else SCENARIOS[name].horizon)
        for name, cell in cells.items()
    ]
    return float(np.exp(np.mean(np.log(products))))


def step_times(controller: Controller, gains: Gains) -> dict[str, float]:
    """CPU time of a step of a law [µs] over various inputs: compiled, as in simulations, and in Python."""
    plain: Any = FunctionType(many_steps.__code__, {**many_steps.__globals__, "law": controller.step})
    return {
        "compiled": step_time(compiled(many_steps, law=controller.step), gains, 1000),
        "python": step_time(plain, gains, 30),
    }


def step_time(steps: Callable[..., float], gains: Gains, count: int, seconds: float = 0.3) -> float:
    """CPU time of one of so many steps [µs]."""
    rng, limits = np.random.default_rng(SEED), Limits(0.2, 1.5, 1.5)
    away = rng.uniform(-1.0, 1.0, count) + 1j * rng.uniform(-1.0, 1.0, count)
    steps(away, gains, limits)
    done, began = 0, time.process_time()
    while (elapsed := time.process_time() - began) < seconds:
        steps(away, gains, limits)
        done += count
    return 1e6 * elapsed / done


def law(integral: complex, *_: Any) -> Any:
    """Stand for the law with which `many_steps` is compiled."""
    raise NotImplementedError


def many_steps(away: Any, gains: Gains, limits: Limits) -> float:
    """Take a step for each error in `away` [m], with headings all around; return the sum of the speeds."""
    total = 0.0
    for k in range(len(away)):
        measured = Measured(away[k] + 1.0, 1.0 + 0j, 1.0, 0.2 + 0.1j)
        command, _ = law(0.01j, rotation(0.1 * k), measured, gains, limits, 0.02)
        total += command.speed
    return total
