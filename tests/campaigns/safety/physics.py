"""The paper's missions with wheels that slip: how true do formations stay, does anybody touch, how fast?"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from formation.control.arrays import ComplexArray
from formation.control.unicycle import Command
from formation.mission.file import load
from formation.mission.model import Mission
from formation.simulation.ensemble import MIN_START_CLEARANCE
from tests.campaigns.document import Found
from tests.campaigns.figures import filled
from tests.campaigns.parts import table
from tests.campaigns.safety.part import Options, bar, reported
from tests.support.missions import with_robots

if TYPE_CHECKING:
    from tests.support.physics_worlds import InPhysics

MISSIONS = {"six robots": "six_robots", "TurtleBot3 pair": "turtlebot3_pair"}
STARTS, SEED = 20, 1
SETTLED, OWN, SECONDS, STEP = 15.0, 30.0, 60.0, 0.1
"""From when on a formation is judged, how long the missions last, how long runs last; between looks [s]."""
MOST = 0.03  # root mean square by which relative positions may be off [m]
TITLE = "Robots with mass"
ABOUT = f"""\
Both shipped missions of the paper, with `avoid = "all"` for starts that cross, in the MuJoCo world
([decision 41](decisions/0041-physics-world.md)): production agents on a fake clock, {STARTS} starts of
each, {SECONDS:.0f} s. Starts are drawn as `formation simulate` draws them: control points within ± 3 m of the
six robots' slots, ± 1 m of the pair's, any heading, bodies {100 * MIN_START_CLEARANCE:.0f} cm
apart. The leader drives all the time, at 0.2 and at 0.05 m/s. *Off* is the distance between the true and
the desired relative positions of control points, root mean square over time and over edges, or over all
pairs, the leader among them. Touching is as MuJoCo finds contacts; *nearest* is the room between the
circles that contain two bodies."""
HEADER = (
    f"mission | runs that touch | nearest | off, {SETTLED:.0f} to {OWN:.0f} s: all runs, worst | "
    f"{SETTLED:.0f} to {SECONDS:.0f} s | of it in odometry | "
    f"over all pairs, {SETTLED:.0f} to {SECONDS:.0f} s | in the last 5 s"
)
KINDS = ("own", "whole", "counted", "pairs", "last")
"""How far relative positions were off, as the header has them."""


def run(options: Options) -> Found:
    starts = 2 if options.quick else STARTS
    found: Found = {
        name: together(with_robots(file, avoid="all"), starts, name) for name, file in MISSIONS.items()
    }
    speed = how_fast(load("six_robots"), 5.0 if options.quick else SECONDS)
    return {"runs": found, "speed": speed, "bars": [*bars(found), real_time(speed)]}


def bars(found: Found) -> list[Found]:
    every = []
    for name, one in found.items():
        starts, touched, own, whole = one["starts"], one["touched"], max(one["own"]), max(one["whole"])
        lasts = f"{name}: off by less than 3 cm RMS for as long as the mission lasts, each start"
        over = f"worst {100 * whole:.1f} cm, {sum(off >= MOST for off in one['whole'])} of {starts} over 3 cm"
        every += [
            bar(f"{name}: no two bodies touch, {starts} starts", f"{touched} runs", not touched),
            bar(lasts, f"worst {100 * own:.1f} cm", own < MOST),
            bar(f"{name}: the same for {SECONDS:.0f} s", over, whole < MOST),
        ]
    return every


def real_time(speed: Found) -> Found:
    """Whether simulated time goes by at least as fast as ours."""
    slower = min(speed["world"], speed["fleet"])
    words = f"{speed['world']:.0f} times real time, with all agents {speed['fleet']:.1f} times"
    return bar("60 s of six robots simulate in real time", words, slower >= 1.0)


def section(found: Found) -> str:
    speed = found["speed"]
    parts = [
        table(HEADER, [_row(name, one) for name, one in found["runs"].items()]),
        filled(
            "*Of it in odometry* is what the robots could have known of: the same figure with control",
            "points where odometry has them. All else is drift, which none of their inputs shows. It",
            "grows with time: a gyroscope that is off by 0.0001 rad/s is off by 6 mrad after a",
            "minute, and a robot at 0.2 m/s has by then gone 3.6 cm aside.",
        ),
        filled(
            f"{SECONDS:.0f} s of six robots took {speed['world_took']:.1f} s without agents, all driving",
            f"circles ({speed['world']:.0f} times real time), and {speed['fleet_took']:.1f} s with the",
            f"agents of all and the leader in the same process ({speed['fleet']:.1f} times).",
        ),
    ]
    return "\n".join(parts)


def _row(name: str, found: Found) -> str:
    off = [f"{100 * over_all(found[kind]):.2f}, {100 * max(found[kind]):.2f} cm" for kind in KINDS]
    touched = f"{found['touched']} of {found['starts']}"
    return " | ".join([name, touched, f"{100 * found['nearest']:.1f} cm", *off])


def together(mission: Mission, starts: int, name: str) -> Found:
    """All runs of a mission: lists have one figure [m] for each start."""
    from tests.support.physics_worlds import InPhysics, at_random

    every = reported(f"physics: {name}", at_random(mission, STARTS, SEED)[:starts])
    runs = [driven(InPhysics(start, seed)) for seed, start in enumerate(every)]
    return {
        "starts": starts,
        "touched": sum(one["touched"] for one in runs),
        "nearest": min(one["nearest"] for one in runs),
        **{kind: [one[kind] for one in runs] for kind in KINDS},
    }


def driven(team: InPhysics) -> Found:
    both = []
    for _ in range(round(SECONDS / STEP)):
        team.fleet.run(STEP)
        both.append(team.off())
    off, believed = np.array(both).swapaxes(0, 1)
    edges = [(i, j) for i, row in enumerate(team.mission.graph.neighbours) for j in row]
    pairs = list(combinations(range(len(team.mission.names)), 2))
    return {
        "touched": bool(team.world.touched),
        "nearest": team.world.nearest,
        "own": relative(off, edges, SETTLED, OWN),
        "whole": relative(off, edges, SETTLED, SECONDS),
        "counted": relative(believed, edges, SETTLED, SECONDS),
        "pairs": relative(off, pairs, SETTLED, SECONDS),
        "last": relative(off, edges, SECONDS - 5.0, SECONDS),
    }


def relative(off: ComplexArray, edges: Sequence[tuple[int, int]], since: float, until: float) -> float:
    """RMS over edges and time [m]. `off` [m] has a row each STEP and a column for each control point."""
    one, other = np.array(edges).T
    some = off[round(since / STEP) : round(until / STEP)]
    return float(np.sqrt(np.mean(np.abs(some[:, one] - some[:, other]) ** 2)))


def over_all(runs: Sequence[float]) -> float:
    """RMS of runs that were equally long."""
    return math.sqrt(sum(one**2 for one in runs) / len(runs))


def how_fast(mission: Mission, seconds: float) -> Found:
    """How long so many seconds take, world alone and with all agents, and how often that is real time."""
    from formation.agent.simulated.physics.world import World
    from tests.support.physics_worlds import InPhysics

    world, team = World(mission), InPhysics(mission)
    began = time.perf_counter()
    world.step({name: Command(0.2, 0.4) for name in world.robots}, 0.0)
    for _ in range(round(seconds / 0.05)):
        world.step({}, 0.05)
    between = time.perf_counter()
    team.fleet.run(seconds)
    alone, fleet = between - began, time.perf_counter() - between
    return {
        "world_took": alone, "fleet_took": fleet, "world": seconds / alone, "fleet": seconds / fleet
    }  # fmt: skip
