"""Physics worlds for tests: missions with other starts, fleets in physics, and figures over them."""

from __future__ import annotations

import cmath
import math
import random
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np

from formation.agent.simulated.physics.world import BodyState, Wheeled, World, wheeled
from formation.control.arrays import ComplexArray
from formation.control.unicycle import Command, control_point
from formation.mission.file import load
from formation.mission.model import Mission
from formation.mission.robot import Post, Wall
from formation.simulation.ensemble import random_starts
from tests.support.fleet import Fleet

PAIR, SIX = load("turtlebot3_pair"), load("six_robots")
BODIES = 4
"""Collision group of decks, scanners, walls and posts in the model."""


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
    """All robots off their slots by the same way, up to `spread` [m] on each axis: no paths cross."""
    chance = random.Random(seed)
    off = complex(chance.uniform(-spread, spread), chance.uniform(-spread, spread))
    leader = mission.robots[mission.leader].start.position
    poses = {
        name: (leader + mission.slot(name) + off, chance.uniform(-math.pi, math.pi))
        for name in mission.followers
    }
    return placed(mission, **poses)


def at_random(mission: Mission, runs: int, seed: int) -> list[Mission]:
    """The mission with starts as `formation simulate` draws them: around the slots, bodies apart."""
    starts = random_starts(mission, runs, mission.simulation.spread, np.random.default_rng(seed))
    return [
        placed(
            mission,
            **{
                name: (complex(at), cmath.phase(heading))
                for name, at, heading in zip(mission.followers, places, headings, strict=True)
            },
        )
        for places, headings in zip(starts.position, starts.heading, strict=True)
    ]


def drive(world: World, seconds: float, **commands: tuple[float, float]) -> Mapping[str, BodyState]:
    """Let robots drive; those that are not named keep to what they did."""
    return world.step({name: Command(*command) for name, command in commands.items()}, seconds)


def turned(before: BodyState, after: BodyState) -> float:
    """By how much it turned [rad], less than half a turn."""
    return cmath.phase(after.heading / before.heading)


def touching(world: World) -> frozenset[frozenset[str]]:
    """Pairs of robots that touch; a robot alone if it touches a wall or a post."""
    names = {world.model.body(f"{name}/base").id: name for name in world.robots}
    pairs = world.data.contact.geom[: world.data.ncon]
    bodies = world.model.geom_bodyid[pairs]
    return frozenset(
        frozenset(filter(None, (names.get(int(one)), names.get(int(other)))))
        for (one, other), (first, _) in zip(bodies, pairs, strict=True)
        if world.model.geom_contype[first] == BODIES
    )


class Watched(World):
    """A physics world that records which bodies touched, and how near two came."""

    def __init__(self, mission: Mission, seed: int = 0) -> None:
        super().__init__(mission, seed)
        self.touched: set[frozenset[str]] = set()
        self.nearest = math.inf
        """Room between the circles that hold two robots, at least [m]."""
        self._radii = {name: mission.robots[name].radius for name in self.robots}

    def advance(self, commands: Mapping[str, Command], dt: float) -> None:
        """Go on, at most by what lies between two messages of a fleet, and look."""
        super().advance(commands, dt)
        states = self.states
        self.touched |= touching(self)
        for one, other in combinations(self.robots, 2):
            away = abs(states[one].position - states[other].position)
            self.nearest = min(self.nearest, away - self._radii[one] - self._radii[other])


class InPhysics:
    """A fleet whose robots are in a physics world."""

    def __init__(self, mission: Mission, seed: int = 0) -> None:
        self.mission = mission
        self.world = Watched(mission, seed)
        self.fleet = Fleet(mission, seed=seed, plants=self._plants)

    def errors(self, seconds: float) -> list[float]:
        """Go on for so long; each half second, RMS over followers of how far they really are off [m].

        That is off their slots relative to the leader, which has no body.
        """
        errors = []
        for _ in range(round(2 * seconds)):
            self.fleet.run(0.5)
            off, _ = self.off()
            errors.append(float(np.sqrt(np.mean(np.abs(off[1:] - off[0]) ** 2))))
        return errors

    def off(self) -> tuple[ComplexArray, ComplexArray]:
        """How far all control points are off their slots now, truly and by odometry, the leader's first [m].

        The leader is off by where it is, so that only differences mean something.
        """
        points = self.fleet.points()  # has all be where they are by now
        slots = np.array(self.fleet.in_charge.wanted.slots(self.mission))
        counted = [points[0]]
        for name, state in self.world.states.items():
            offset = self.mission.robots[name].control_point_offset
            counted.append(control_point(state.counted_position, state.counted_heading, offset))
        return np.array(points) - slots, np.array(counted) - slots

    def _plants(self, mission: Mission, robots: Sequence[str], seed: int) -> dict[str, Wheeled]:
        return wheeled(self.world, mission, robots, seed)
