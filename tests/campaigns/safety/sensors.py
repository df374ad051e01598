"""Sensors that freeze or tremble: how far do robots drive on? And does a well robot ever hold for nothing?"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from itertools import product
from typing import Any

from formation.mission.model import Mission
from tests.campaigns.bench.figures import markdown
from tests.campaigns.safety.part import Found, Options, bar, reported
from tests.support.fleet import Fleet
from tests.support.sensing import (
    FAULTS,
    GRACE,
    MISSIONS,
    SOURCES,
    Quiet,
    Sensed,
    late,
    mission_of,
    noisy,
    resting,
    suffer,
    watch,
)

TITLE = "Sensors that lie"
SEEDS, HOUR, BOUND = 20, 3600.0, 0.1
"""Faults of each kind; length of the runs without fault [s]; longest way after a fault [m]."""
NOISE, DELAY = 0.005, 0.1
"""Of own positions, and of every robot's own measurement, in runs without fault [m; s]."""
ABOUT = f"""\
A random robot's sensor, in production cores on a fake clock, freezes, or trembles around one place, at a
random moment on the way to its slot or in formation, for 10 s; {SEEDS} times for each mission and source.
*Driven* is the true way from {GRACE:g} s after the fault began until it ended, probes included. *Resumed* is
when the robot was in formation control again by itself after the sensor was well.
*No fault*: each mission for an hour with {1000 * NOISE:.0f} mm of noise (standard deviation per axis) and
{1000 * DELAY:.0f} ms of delay, also with a leader at rest, and with wheels that slip (MuJoCo); how often a
robot held because its motion seemed wrong."""


def run(options: Options) -> Found:
    """Faults, then runs without any."""
    seeds, seconds = (2, 30.0) if options.quick else (SEEDS, HOUR)
    names = MISSIONS[:2] if options.quick else MISSIONS
    cases = list(product(names, SOURCES, FAULTS))
    faults = [
        _fault(name, source, kind, size, [suffer(name, source, kind, size, seed) for seed in range(seeds)])
        for name, source, (kind, size) in reported("sensors", cases)
    ]
    worlds = ("kinematic", "mujoco") if find_spec("mujoco") else ("kinematic",)
    runs = list(product(names, SOURCES, worlds, (False, True)))
    quiet = [
        _quiet(name, source, world, seconds, at_rest=at_rest)
        for name, source, world, at_rest in reported("sensors without fault", runs)
    ]
    driven = max(one["driven"] for one in faults)
    lost = sum(one["lost"] for one in faults)
    holds = sum(len(one["holds"]) for one in quiet)
    return {
        "faults": faults,
        "quiet": quiet,
        "bars": [
            bar(
                "no robot drives 10 cm from 1 s after the fault on", f"{100 * driven:.1f} cm", driven < BOUND
            ),
            bar("all go on by themselves when the sensor is well", f"{lost} do not", lost == 0),
            bar(f"no false hold in {seconds:.0f} s of each mission", f"{holds}", holds == 0),
        ],
    }


def _fault(name: str, source: str, kind: str, size: float, tries: Sequence[Sensed]) -> dict[str, Any]:
    back = [one.resumed for one in tries if one.resumed != float("inf")]
    return {
        "mission": name,
        "source": source,
        "fault": kind if not size else f"{kind} {1e6 * size:g} µm",
        "tries": len(tries),
        "driven": max(one.driven for one in tries),
        "resumed": max(back, default=0.0),
        "lost": len(tries) - len(back),
    }


def _quiet(name: str, source: str, world: str, seconds: float, *, at_rest: bool) -> dict[str, Any]:
    mission = noisy(mission_of(name, source), NOISE)
    fleet = _fleet(resting(mission) if at_rest else mission, world)
    fleet.meddle = late(DELAY)
    found: Quiet = watch(fleet, seconds)
    where = f"{name}, {source}, {world}{', leader at rest' if at_rest else ''}"
    return {"run": where, "seconds": seconds, "commands": found.commands, "holds": found.holds}


def _fleet(mission: Mission, world: str) -> Fleet:
    if world == "kinematic":
        return Fleet(mission, seed=1)
    # only this needs the physics world
    from formation.agent.simulated.physics.wheeled import wheeled
    from formation.agent.simulated.physics.world import World

    floor = World(mission, 1)
    return Fleet(mission, seed=1, plants=lambda one, robots, seed: wheeled(floor, one, robots, seed))


def section(found: Found) -> str:
    """Tables for people."""
    faults = [
        [
            one["mission"],
            one["source"],
            one["fault"],
            str(one["tries"]),
            f"{100 * one['driven']:.1f} cm",
            f"{one['resumed']:.1f} s",
            str(one["lost"]),
        ]
        for one in found["faults"]
    ]
    head = ("mission", "source", "fault", "tries", "driven, most", "resumed after, most", "not resumed")
    quiet = [
        [one["run"], f"{one['seconds']:.0f} s", str(one["commands"]), str(len(one["holds"]))]
        for one in found["quiet"]
    ]
    return f"{markdown(head, faults)}\n{markdown(('no fault', 'time', 'commands', 'false holds'), quiet)}"
