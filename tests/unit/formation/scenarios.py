"""Missions built in code for tests and benchmarks: the paper's scenarios, rings, chains, random graphs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from formation.control.arrays import ComplexArray
from formation.mission.model import Mission
from formation.simulation.body import Body
from formation.simulation.ensemble import Options
from formation.simulation.simulate import Result, simulate

HEXAGON: ComplexArray = np.exp(1j * np.pi / 3.0 * np.arange(6)) - 1.0
TRIANGLE: ComplexArray = -0.5 * np.exp(1j * np.array([0.0, -np.pi / 6.0, np.pi / 6.0])) + np.array(
    [0.5, 0, 0]
)
TWO_AHEAD = ((), (0,), (0, 1), (1, 2), (2, 3), (3, 4))
"""Neighbours of six robots: each measures the two before it."""
STRAIGHT_ON = {"speed": 0.2, "heading_deg": 30.0}
SHORT_OFFSET = {"control_point_offset": 0.05, "max_turn_rate": 2.84}
IDEAL = Options(body=Body(), avoid=False)
"""Ideal bodies, as certificates assume them, and no collision filter."""


def build(
    slots: ComplexArray,
    neighbours: Sequence[Sequence[int]],
    route: dict[str, Any] | None = None,
    **tables: Any,
) -> Mission:
    """Build a mission of robot1 (the leader), robot2, …, which start in their slots; `tables` as in a file.

    Robots are ideal, as in theory: no collision filter and no ramp, unless `tables` set them.
    """
    places = {f"robot{number}": slot for number, slot in enumerate(slots.tolist(), start=1)}
    names = list(places)
    return Mission.model_validate(
        {
            "name": "scenario",
            "leader": names[0],
            "shapes": {"shape": {name: [places[name].real, places[name].imag] for name in names[1:]}},
            "robots": {
                name: {"neighbours": [names[j] for j in js], "start": {"x": slot.real, "y": slot.imag}}
                for (name, slot), js in zip(places.items(), neighbours, strict=True)
            },
            "route": [route or STRAIGHT_ON],
            "collisions": {"mode": "off"},
            **tables,
            "robot": {"ramp": 0.0, **tables.get("robot", {})},
        }
    )


def random_neighbours(rng: np.random.Generator, count: int) -> list[list[int]]:
    """Draw one or two earlier robots as neighbours of each of `count` robots; none for the leader."""
    return [sorted(set(rng.integers(0, one, min(one, 2)).tolist())) if one else [] for one in range(count)]


def edge_errors(mission: Mission, horizon: float = 60.0, step: float = 0.05) -> dict[str, float]:
    """Mean error of each follower's worst edge in the last ten seconds of a simulation [m]."""
    result = simulate(mission, horizon=horizon, step=step, options=IDEAL, keep=True, starts="mission")
    history = result.history
    assert history is not None
    points = history.position.copy()
    points[:, 1:] += np.array(history.offset) * history.heading[:, 1:]
    late, slots = history.time > horizon - 10.0, np.array(mission.slots())
    return {
        name: max(
            float(np.abs(points[late, j] - points[late, i] - slots[j] + slots[i]).mean())
            for j in mission.graph.neighbours[i]
        )
        for i, name in enumerate(mission.followers, start=1)
    }


def clearing(mission: Mission, avoid: object = "all", **collisions: Any) -> Mission:
    """The mission with collision filter and ramp; followers avoid `avoid` and their neighbours."""
    output = mission.model_dump()
    for name in mission.followers:
        output["robots"][name].update(avoid=avoid, ramp=0.25)
    return Mission.model_validate({**output, "collisions": collisions})


def ramped(mission: Mission, ramp: float) -> Mission:
    """The mission with a ramp of `ramp` [s] from rest to a limit; 0 for none."""
    robots = {name: one.model_copy(update={"ramp": ramp}) for name, one in mission.robots.items()}
    return mission.model_copy(update={"robots": robots})


def exchanged(mission: Mission, avoid: object = "all", **collisions: Any) -> Mission:
    """The mission of `clearing` with followers that start in each other's slots, in reverse order."""
    output = clearing(mission, avoid, **collisions).model_dump()
    places = [mission.slot(name) for name in reversed(mission.followers)]
    for name, place in zip(mission.followers, places, strict=True):
        output["robots"][name]["start"] = {"x": place.real, "y": place.imag}
    return Mission.model_validate(output)


def opposite(robots: int) -> Mission:
    """Fast robots on a circle behind the leader, which all measure it and start opposite to their slots.

    All ways cross in the middle, at the same time.
    """
    circle = max(1.4, 0.22 * robots) * np.exp(1j * (0.26 + 2.0 * np.pi / robots * np.arange(robots)))
    output = clearing(
        build(
            np.array([0.0, *(circle - 2.0)]),
            ((), *[(0,)] * robots),
            {"speed": 0.1, "heading_deg": 0.0},
            robot={"control_point_offset": 0.1, "max_speed": 1.0, "max_turn_rate": 2.5, "radius": 0.15},
            simulated_robot={"lag": 0.1},
        ),
        lag=0.1,
    ).model_dump()
    for name, place in zip(output["shapes"]["shape"], circle.tolist(), strict=True):
        start = -2.0 - place
        heading = float(np.degrees(np.angle(place)))
        output["robots"][name]["start"] = {"x": start.real, "y": start.imag, "heading_deg": heading}
    return Mission.model_validate(output)


def six(**law: Any) -> Mission:
    """Section 4 of the paper, starts within ±3 m."""
    return build(
        HEXAGON,
        TWO_AHEAD,
        law={"k_i": 1.0, **law},
        robot={"control_point_offset": 0.2, "max_speed": 1.5, "max_turn_rate": 1.5},
        simulation={"spread": 3.0, "horizon": 120.0},
    )


def pair(**law: Any) -> Mission:
    """Section 5 of the paper with ideal bodies, starts within ±1 m."""
    return build(
        TRIANGLE,
        ((), (0,), (0,)),
        {"speed": 0.05, "heading_deg": 0.0},
        law={"k_i": 0.2, **law},
        robot={"control_point_offset": 0.05, "max_speed": 0.22, "max_turn_rate": 2.84},
        simulation={"spread": 1.0, "horizon": 120.0},
    )


def near_limit(max_turn_rate: float = 1.5, **law: Any) -> Mission:
    """The six robots with a top speed just above their leader's speed."""
    return build(
        HEXAGON,
        TWO_AHEAD,
        law={"k_i": 0.5, **law},
        robot={"control_point_offset": 0.1, "max_speed": 0.22, "max_turn_rate": max_turn_rate},
        simulation={"spread": 1.0, "horizon": 240.0},
    )


def chain(followers: int, route: dict[str, Any], robot: dict[str, Any], spread: float, **law: Any) -> Mission:
    """A chain: each follower is behind the robot that it measures."""
    return build(
        (-0.5 * np.arange(followers + 1)).astype(np.complex128),
        ((), *((i,) for i in range(followers))),
        route,
        law=law,
        robot={"control_point_offset": 0.1, "max_speed": 0.22, "max_turn_rate": 1.5, **robot},
        simulation={"spread": spread, "horizon": 240.0},
    )


def long_chain(followers: int, **law: Any) -> Mission:
    """A chain of robots with a top speed of 0.22 m/s behind a leader at 0.15 m/s."""
    return chain(followers, {"speed": 0.15, "heading_deg": 30.0}, {}, 1.0, **{"k_i": 0.5, **law})


def circling_chain(**law: Any) -> Mission:
    """A chain of eleven followers behind a leader on a circle of 1 m at 0.1 m/s; all start in their slots."""
    circle = {"radius": 1.0, "speed": 0.1, "heading_deg": 90.0}
    return chain(11, circle, SHORT_OFFSET, 0.0, **{"k_i": 0.2, **law})


def straight_chain(**law: Any) -> Mission:
    """The chain of `circling_chain` behind a leader that drives straight at 0.1 m/s."""
    straight = {"speed": 0.1, "heading_deg": 0.0}
    return chain(11, straight, SHORT_OFFSET, 0.0, **{"k_i": 0.2, **law})


def ring(followers: int, **law: Any) -> Mission:
    """Followers on a circle: each measures the one before it, and the first measures the leader too."""
    around = np.exp(2j * np.pi * np.arange(followers) / followers)
    return build(
        np.concatenate([[0.0], around]),
        ((), (0, followers), *((i,) for i in range(1, followers))),
        law={"k_i": 1.0, **law},
        robot={"control_point_offset": 0.2, "max_speed": 1.5, "max_turn_rate": 1.5},
        simulation={"spread": 0.1, "horizon": 120.0},
    )


def median(result: Result) -> float:
    return float(result.summary()["settling_time"]["median"])


def out_of_slot(mission: Mission, result: Result) -> list[float]:
    """Each robot's distance from its slot behind the leader, RMS over the last third of the run [cm]."""
    assert result.history is not None
    points = result.history.points
    away = np.abs(points - points[:, :1] - np.array(mission.slots()))[len(points) * 2 // 3 :]
    rms: list[float] = (100.0 * np.sqrt(np.square(away).mean(axis=0))).tolist()
    return rms
