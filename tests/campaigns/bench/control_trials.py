"""One trial of the control benchmarks: a law, a mission, many starts; and the figures that come of it.

The missions are the shipped six robots on four routes, with other leaders and laws. The leader goes at the
mission's 0.2 m/s on all routes. Shapes keep their direction in the world, so every slot moves as the leader
does.

The proportional laws, beside which ours are measured, are after the public simulator of the Robotarium
(robotarium_python_simulator 2.0: `leader_follower.py`, `transformations.py`), read and written anew. A
follower goes like a single integrator towards where its neighbours want it, no faster than three quarters of
its top speed; a mapping makes that a unicycle's command.

| there | here | why |
|---|---|---|
| distances to keep, by a potential | displacements to keep | the formations here are made of displacements |
| gain 10 | `gains.k_p` | displacements have another scale; the benchmarks take the best of a range |
| pose from cameras above the field | the field law's observer | the same inputs for all laws |
| barrier certificates | no collision filter, with any law | what the laws do is compared; `SHIPPED` has it |

No integral, no feed-forward, no memory: behind a leader at speed v an edge keeps an error of about v / gain.
Arithmetic and `formation.control.plane` only, so that scalars and arrays take the same path.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from formation.control.arrays import FloatArray
from formation.control.controller import Controller, Gains, Limits, Measured
from formation.control.observer import INNOVATION
from formation.control.plane import angle_between, clip, shorten
from formation.control.unicycle import Command, saturate
from formation.mission.file import load
from formation.mission.model import Mission
from formation.simulation.ensemble import Options, Starts, random_starts
from formation.simulation.simulate import DWELL_TIME, Result, simulate
from tests.unit.formation import scenarios

SHARE = 0.75
"""Of the top speed, what a follower is asked for at most."""
FORWARD = 0.8
"""Forward speed for each m/s in the direction of travel."""
TURN = 2.0
"""Turn rate for each radian between heading and wanted velocity [1/s]: π rad/s at a right angle."""


def turning(
    integral: Any, heading: Any, measured: Measured, gains: Gains, limits: Limits, _dt: float
) -> tuple[Command, Any]:
    """Turn towards the wanted velocity and drive what of it lies ahead: `create_si_to_uni_dynamics`."""
    wanted = gains.k_p * (measured.relative - heading.conjugate() * measured.desired)
    wanted = shorten(wanted, SHARE * limits.max_speed)
    turn_rate = TURN * angle_between(1.0 + 0.0j, wanted)
    speed = clip(FORWARD * wanted.real, limits.max_speed)
    return Command(speed, clip(turn_rate, limits.max_turn_rate)), integral


def near_identity(
    integral: Any, heading: Any, measured: Measured, gains: Gains, limits: Limits, _dt: float
) -> tuple[Command, Any]:
    """Give the control point the wanted velocity exactly: `create_si_to_uni_mapping`."""
    wanted = gains.k_p * (measured.relative - heading.conjugate() * measured.desired)
    wanted = shorten(wanted, SHARE * limits.max_speed)
    return saturate(wanted, limits.offset, limits.max_speed, limits.max_turn_rate), integral


TURNING = Controller("turning", turning, INNOVATION, integral=False, ramp=False)
NEAR_IDENTITY = Controller("near_identity", near_identity, INNOVATION, integral=False, ramp=False)


SPEED = 0.2
"""[m/s]"""
SIDE = 25.0
"""Time along one side of the square [s]."""
HEADING = 30.0
"""[deg]"""


_CIRCLE: dict[str, Any] = {"radius": 1.0, "speed": SPEED}
_TURNS = [
    {**_CIRCLE, "turn": turn, "duration": float(2.0 * np.pi / SPEED)}
    for turn in ("left", *("right", "left", "right") * 3)
]
ROUTES: Mapping[str, Sequence[dict[str, Any]]] = MappingProxyType(
    {
        "line": [{"speed": SPEED, "heading_deg": HEADING}],
        "circle of 1 m": [{**_CIRCLE, "heading_deg": HEADING}],
        "square of 5 m": [
            {"speed": SPEED, "heading_deg": HEADING + 90.0 * corner, "duration": SIDE} for corner in range(8)
        ],
        "figure eight, 1 m": [{**_TURNS[0], "heading_deg": HEADING}, *_TURNS[1:]],
    }
)


def six_robots(route: str = "line", leader_speed: float | None = None) -> Mission:
    """The shipped mission on a route, or behind a straight leader of another speed [m/s]."""
    mission = load("six_robots")
    legs = ROUTES[route] if leader_speed is None else [{"speed": leader_speed, "heading_deg": HEADING}]
    return varied(mission, route=legs)


def varied(mission: Mission, **tables: Any) -> Mission:
    """The mission with some of its tables replaced."""
    return Mission.model_validate({**mission.model_dump(), **tables})


def circling_chain(followers: int, **law: Any) -> Mission:
    """One behind the other, half a metre apart, behind a leader on a circle of 1 m at 0.1 m/s."""
    circle = {"radius": 1.0, "speed": 0.1, "heading_deg": 90.0}
    robot = {"control_point_offset": 0.05, "max_turn_rate": 2.84}
    return scenarios.chain(followers, circle, robot, 0.0, **{"k_i": 0.2, **law})


def drawn(mission: Mission, runs: int, seed: int) -> Starts:
    """The starts that `simulate` draws."""
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0])
    return random_starts(mission, runs, mission.simulation.spread, rng)


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
    filtered: bool = False
    """With the collision filter, as the mission says."""

    def of(self, mission: Mission) -> Mission:
        """The mission with this law's parameters."""
        return varied(mission, law={**mission.law.model_dump(), **self.parameters})

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
        options = replace(options or Options(), avoid=self.filtered)
        return simulate(
            self.of(mission), law=self.law, runs=runs, seed=SEED, options=options, step=step, starts=starts,
            horizon=horizon * self.patience, keep=keep,
        )  # fmt: skip


FIELD = Contender("field law", "field")
SHIPPED = Contender("field law, with the collision filter", "field", filtered=True)
PAPER = Contender("paper's law", "paper", patience=3.0)
PROPORTIONAL = Contender("proportional, gain 10", NEAR_IDENTITY, {**UNAIDED, "k_p": 10.0})
STIFF = Contender("proportional, gain 40", NEAR_IDENTITY, {**UNAIDED, "k_p": 40.0})
GENTLE = Contender("field law, gentle", "field", {"gain": 4.0, "velocity_filter": 0.1})
ROBOTARIUM = Contender("proportional, gain 10, turning first", TURNING, {**UNAIDED, "k_p": 10.0})
CONTENDERS = (FIELD, PAPER, PROPORTIONAL, STIFF)
"""Those of every comparison; the gentle one is for noise, the one that turns first for the first table."""


def figures(result: Result) -> dict[str, Any]:
    """How many settle for good, how fast, and what error remains in the second half."""
    return {"runs": len(result.converged), **_settled(result.settling_time), **_remaining(result)}


def figures_of_stays(result: Result) -> dict[str, Any]:
    """The same with lasting disturbances: settled is under the bound for `DWELL_TIME` in a row."""
    return {
        "runs": len(result.converged),
        **_settled(first_stay(result.error, result.time, result.settled)),
        **_remaining(result),
    }


def first_stay(error: FloatArray, time: FloatArray, bound: float) -> FloatArray:
    """When each run's error (T, R) first went under `bound` for `DWELL_TIME` [s] or more, NaN where never."""
    long = max(1, round(DWELL_TIME / (time[1] - time[0])))
    under = np.cumsum(np.vstack([np.zeros(error.shape[1]), error < bound]), axis=0)
    stays = under[long:] - under[:-long] == long
    return np.where(stays.any(axis=0), time[stays.argmax(axis=0)], np.nan)


def _settled(times: FloatArray) -> dict[str, Any]:
    """Share, and quantiles of the time of those that did [s]; None under half."""
    share = float(np.isfinite(times).mean())
    names = ("q25", "median", "q75", "p95", "max")
    if share < 0.5:
        return {"share": share, "settling": dict.fromkeys(names)}
    quantiles = np.percentile(times[np.isfinite(times)], (25, 50, 75, 95, 100)).tolist()
    return {"share": share, "settling": dict(zip(names, quantiles, strict=True))}


def _remaining(result: Result) -> dict[str, Any]:
    """Formation error in the second half: each run's root mean square and peak [m], medians of all runs."""
    late = np.minimum(result.error[len(result.error) // 2 :], 1e6)
    return {
        "rms": float(np.median(np.sqrt(np.square(late).mean(axis=0)))),
        "peak": float(np.median(late.max(axis=0))),
    }


def slot_errors(mission: Mission, result: Result) -> FloatArray:
    """Each robot's distance from its slot, RMS over the last third of the first run [m]; shape (n,)."""
    assert result.history is not None
    points = result.history.points
    away = np.abs(points - points[:, :1] - np.array(mission.slots()))
    errors: FloatArray = np.sqrt(np.square(away[len(away) * 2 // 3 :]).mean(axis=0))
    return errors


def front(tried: list[Any]) -> list[Any]:
    """Those of the tried that no other beats in both settling and the error in the rough world."""
    reliable = [one for one in tried if one["calm"]["share"] == 1.0]
    best: list[Any] = []
    for one in sorted(reliable, key=lambda one: (one["calm"]["settling"]["median"], one["rough"]["rms"])):
        if not best or one["rough"]["rms"] < best[-1]["rough"]["rms"]:
            best.append(one)
    return best
