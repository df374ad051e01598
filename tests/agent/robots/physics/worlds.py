"""Physics worlds for tests: missions with other starts, fleets in physics, and figures over them."""

from __future__ import annotations

import cmath
import math
import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from agent.robots.physics.wheeled import Wheeled, wheeled
from agent.robots.physics.world import State, World
from formation.mission import Mission
from formation.mission_file import load
from formation.scan_spec import Post, Wall
from formation.unicycle import Command
from tests.agent.fleet import Fleet

PAIR, SIX = load("turtlebot3_pair"), load("six_robots")


def placed(mission: Mission, **poses: tuple[complex, float]) -> Mission:
    """The mission with other starts: centre [m] and heading [rad]."""
    robots = dict(mission.robots)
    for name, (at, heading) in poses.items():
        spec = robots[name]
        start = {"x": at.real, "y": at.imag, "heading_deg": math.degrees(heading)}
        robots[name] = spec.model_copy(update={"start": spec.start.model_copy(update=start)})
    return mission.model_copy(update={"robots": robots})


def standing(
    mission: Mission,
    posts: Iterable[tuple[complex, float]] = (),
    walls: Iterable[tuple[complex, complex]] = (),
) -> Mission:
    """The mission with posts (axis, radius) and walls (both ends) in its world [m]."""
    around = {
        "posts": tuple(Post(x=at.real, y=at.imag, radius=radius) for at, radius in posts),
        "walls": tuple(Wall(begin=(a.real, a.imag), end=(b.real, b.imag)) for a, b in walls),
    }
    return mission.model_copy(update={"simulation": mission.simulation.model_copy(update=around)})


def beside_its_slots(mission: Mission, seed: int, spread: float) -> Mission:
    """Everybody off its slot by the same way, up to `spread` [m] on each axis: nobody has to cross."""
    chance = random.Random(seed)
    off = complex(chance.uniform(-spread, spread), chance.uniform(-spread, spread))
    leader = mission.robots[mission.leader].start.position
    poses = {
        name: (leader + mission.slot(name) + off, chance.uniform(-math.pi, math.pi))
        for name in mission.followers
    }
    return placed(mission, **poses)


def drive(world: World, seconds: float, **commands: tuple[float, float]) -> Mapping[str, State]:
    """Let robots drive; those that are not named keep to what they did."""
    return world.step({name: Command(*command) for name, command in commands.items()}, seconds)


def turned(before: State, after: State) -> float:
    """By how much it turned [rad], less than half a turn."""
    return cmath.phase(after.heading / before.heading)


@dataclass
class InPhysics:
    """A fleet whose robots are in a physics world."""

    mission: Mission
    seed: int = 0
    touched: set[frozenset[str]] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.world = World(self.mission, self.seed)
        self.fleet = Fleet(self.mission, seed=self.seed, plants=self._plants)

    def errors(self, seconds: float) -> list[float]:
        """Go on for so long; each half second, RMS over followers of how far they really are off [m].

        That is off their slots relative to the leader, which has no body.
        """
        errors = []
        for _ in range(round(2 * seconds)):
            self.fleet.run(0.5)
            self.touched |= self.world.touching
            slots = np.array(self.fleet.in_charge.wanted.slots(self.mission))
            off = np.array(self.fleet.points()) - slots
            errors.append(float(np.sqrt(np.mean(np.abs(off[1:] - off[0]) ** 2))))
        return errors

    def _plants(self, mission: Mission, robots: Sequence[str], seed: int) -> dict[str, Wheeled]:
        return wheeled(self.world, mission, robots, seed)
