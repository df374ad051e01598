"""`python -m tests.campaigns.perception.lock SEED ...`: how far off robots are in the seconds after lock.

One line for each start, off by 5 cm and 3° (standard deviations): the greatest error of a locked robot's
place relative to a locked landmark [cm], and when and where it was. In its own frame it is what the robot
steers by; in the anchor's frame headings count as well; turned as fits best, all that turns the whole shape
is left out.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

from formation.deploy.rehearsal.engine import UPTIME
from tests.campaigns.perception.drift import Case, Displaced, fleet_of
from tests.support.seeing import Errors

SECONDS, STEP = 12.0, 0.5
CASE = Case("straight", errors=Errors(start=0.05, start_deg=3.0))
FRAMES = ("own frame", "turned as fits best", "anchor's frame")


class Placed(NamedTuple):
    """A robot, as it is and as it believes to be."""

    true: complex
    """[m; world frame]"""
    facing: complex
    """Unit [world frame]."""
    believed: complex
    """[m; team's frame]"""
    believed_facing: complex
    """Unit [team's frame]."""
    locked: bool
    """Whether it is locked, or needs not be."""


def placed(fleet: Displaced) -> dict[str, Placed]:
    """Every robot now."""
    found = {}
    for name, (world, _) in fleet.robots.items():
        plant, (agent, _) = world.plant(name), fleet.agents[name]
        plant.go_to(UPTIME + fleet.engine.now)
        sees, here = agent.perception, agent.here.state
        locked = sees is None or not sees.mates or sees.state.locked
        found[name] = Placed(plant.position, plant.heading, here.position, here.measured, locked)
    return found


def errors(fleet: Displaced) -> list[tuple[tuple[float, float, float], str]]:
    """Error in each of `FRAMES` [m] of each locked robot's place relative to a locked landmark."""
    robots, mission = placed(fleet), fleet.mission
    pairs = [
        (name, robots[name], robots[mate])
        for name in mission.followers
        for mate in mission.landmarks_of(name)
        if robots[name].locked and robots[mate].locked
    ]
    fit = sum((mate.believed - me.believed) * (mate.true - me.true).conjugate() for _, me, mate in pairs)
    anchor = next(robots[name] for name in mission.followers if not mission.landmarks_of(name))
    found = []
    for name, me, mate in pairs:
        true, believed = mate.true - me.true, mate.believed - me.believed
        own = abs(true / me.facing - believed / me.believed_facing)
        turned = abs(true * fit / abs(fit) - believed)
        team = abs(true * anchor.believed_facing / anchor.facing - believed)
        found.append(((own, turned, team), name))
    return found


def main() -> None:
    """Print one line for each start."""
    for seed in map(int, sys.argv[1:] or ("0",)):
        fleet, worst = fleet_of(CASE, seed), [(0.0, 0.0, "")] * len(FRAMES)
        for step in range(1, round(SECONDS / STEP) + 1):
            fleet.engine.run(step * STEP)
            for each, name in errors(fleet):
                worst = [max(old, (new, step * STEP, name)) for old, new in zip(worst, each, strict=True)]
        parts = [
            f"{frame} {100 * most:.1f} ({name} at {time:.1f} s)"
            for frame, (most, time, name) in zip(FRAMES, worst, strict=True)
        ]
        print(f"start {seed}: {', '.join(parts)}", flush=True)


if __name__ == "__main__":
    main()
