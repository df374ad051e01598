"""Robots of a physics world, as `formation.agent.simulated` hosts them: one floor, one clock."""

from __future__ import annotations

import cmath
from collections.abc import Sequence

import numpy as np

from formation.agent.simulated.moving import Disturbed
from formation.agent.simulated.physics.world import BodyState, World
from formation.control.unicycle import Command
from formation.mission.model import Mission
from formation.simulation.body import Body

MAX_CATCH_UP_TIME = 5.0
"""Length of a freeze from which the simulation does not catch up, but continues later [s]."""


class Floor:
    """The world with a clock: the first call for a time moves all robots to it."""

    def __init__(self, world: World) -> None:
        """`world` stands still until the first `go_to`."""
        self.world = world
        self.states = world.states
        """The states of all robots."""
        self._time: float | None = None
        self._commands: dict[str, Command] = {}

    def go_to(self, time: float) -> None:
        """Simulate all robots until `time` [s, monotonic]; time never runs backwards."""
        if self._time is None:
            self._time = time
        if time > self._time:
            self.states = self.world.step(self._commands, min(time - self._time, MAX_CATCH_UP_TIME))
            self._commands.clear()
            self._time = time

    def obey(self, robot: str, command: Command) -> None:
        """Have a robot's firmware follow `command` from now on."""
        self._commands[robot] = command


class Wheeled:
    """One robot on the floor."""

    def __init__(self, floor: Floor, mission: Mission, robot: str, seed: int) -> None:
        """At rest at the mission's start. `seed` is for the noise of the external camera."""
        spec = mission.robots[robot]
        self.command = Command(0.0, 0.0)
        """The command before the firmware rounds and limits it."""
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
        """Forward speed and turn rate as the encoders report them."""
        return self._state.counted_moving

    @property
    def disturbed(self) -> Disturbed:
        """Return that its sensors are good."""
        return Disturbed()

    def obey(self, command: Command) -> None:
        """Follow `command` as the firmware rounds and limits it."""
        self.command = command
        self._floor.obey(self._robot, command)

    def go_to(self, time: float) -> None:
        """Simulate until `time` [s, monotonic], together with all other robots."""
        self._floor.go_to(time)

    def odometry(self) -> tuple[complex, complex]:
        """Middle of the axle [m] and heading as the encoders report them [its own frame]."""
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
        """Ranges of the beams of a scanner on this robot [m]; infinite where nothing is hit."""
        found: list[float] = self._floor.world.scan(self._robot, at, heading, beams, farthest).tolist()
        return found

    def reset_odometry(self) -> None:
        """Restart odometry at the present pose, as a TurtleBot3's `reset_odometry` does."""
        self._origin, self._axis = self._state.counted_position, self._state.counted_heading

    @property
    def _state(self) -> BodyState:
        return self._floor.states[self._robot]


def wheeled(world: World, mission: Mission, robots: Sequence[str], seed: int) -> dict[str, Wheeled]:
    """Return the bodies of `robots`, all in `world`, for `formation.agent.simulated.simulated.World`."""
    floor = Floor(world)
    return {name: Wheeled(floor, mission, name, seed) for name in robots}
