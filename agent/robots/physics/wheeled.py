"""Robots of a physics world as `agent.robots.simulated` hosts them: all on one floor and one clock."""

from __future__ import annotations

import cmath
from collections.abc import Sequence

import numpy as np

from agent.robots.physics.world import State, World
from formation.mission import Mission
from formation.simulation.body import Body
from formation.unicycle import Command

LONGEST = 5.0
"""A process that was frozen for longer goes on where it was, so much later [s]."""


class Floor:
    """The world on the clock of whoever asks first; whoever wants it later takes all others along."""

    def __init__(self, world: World) -> None:
        """`world` stands still until the first `go_to`."""
        self.world = world
        self.states = world.states
        """How all robots are."""
        self._time: float | None = None
        self._commands: dict[str, Command] = {}

    def go_to(self, time: float) -> None:
        """Let everybody live up to `time` [s, monotonic]; time never runs backwards."""
        if self._time is None:
            self._time = time
        if time > self._time:
            self.states = self.world.step(self._commands, min(time - self._time, LONGEST))
            self._commands.clear()
            self._time = time

    def obey(self, robot: str, command: Command) -> None:
        """Have a robot's firmware strive for `command` from now on."""
        self._commands[robot] = command


class Wheeled:
    """One robot on the floor."""

    def __init__(self, floor: Floor, mission: Mission, robot: str, seed: int) -> None:
        """At rest at the mission's start. `seed` is of the noise of the camera above it."""
        spec = mission.robots[robot]
        self.command = Command(0.0, 0.0)
        """What it strives for, before its firmware cuts and clamps it."""
        self._floor, self._robot = floor, robot
        self._body = Body.of(mission.simulated_robot)
        self._noise = np.random.default_rng([seed, mission.names.index(robot)])
        self._origin, self._axis = 0j, 1.0 + 0.0j
        if spec.odometry_frame == "start":
            self._origin, self._axis = spec.start.position, spec.start.heading

    @property
    def position(self) -> complex:
        """True middle of the axle [m; world frame]."""
        return self._state.position

    @property
    def heading(self) -> complex:
        """True heading, unit complex [world frame]."""
        return self._state.heading

    @property
    def moving(self) -> Command:
        """Forward speed and turn rate as the encoders tell them."""
        return self._state.counted_moving

    def obey(self, command: Command) -> None:
        """Strive for what the firmware makes of `command`."""
        self.command = command
        self._floor.obey(self._robot, command)

    def go_to(self, time: float) -> None:
        """Live up to `time` [s, monotonic], with everybody else."""
        self._floor.go_to(time)

    def odometry(self) -> tuple[complex, complex]:
        """Middle of the axle [m] and heading as the encoders tell them [its own frame]."""
        position, heading = self._state.counted_position, self._state.counted_heading
        return (position - self._origin) * self._axis.conjugate(), heading * self._axis.conjugate()

    def seen(self) -> tuple[complex, complex]:
        """Middle of the axle [m] and heading as a camera above sees them [world frame]; each call anew."""
        x, y, angle = self._noise.normal(size=3)
        return (
            self.position + self._body.position_noise * complex(x, y),
            self.heading * cmath.rect(1.0, self._body.heading_noise * angle),
        )

    def cast(self, at: complex, heading: complex, beams: int, farthest: float) -> list[float]:
        """How far the beams of a scanner on this robot go [m]; infinite where nothing is in their way."""
        found: list[float] = self._floor.world.scan(self._robot, at, heading, beams, farthest).tolist()
        return found

    def reset_odometry(self) -> None:
        """Have odometry count from here, as a TurtleBot3's `reset_odometry` does."""
        self._origin, self._axis = self._state.counted_position, self._state.counted_heading

    @property
    def _state(self) -> State:
        return self._floor.states[self._robot]


def wheeled(world: World, mission: Mission, robots: Sequence[str], seed: int) -> dict[str, Wheeled]:
    """What moves for `robots`, all in `world`, as `agent.robots.simulated.World` asks for it."""
    floor = Floor(world)
    return {name: Wheeled(floor, mission, name, seed) for name in robots}
