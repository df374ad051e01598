"""The physics world, without a clock or a socket: from commands and time to the states of all robots.

A robot's firmware converts a command to wheel speeds, and its motors keep them, each within its limits.
Whether the robot then moves so depends on the floor and the obstacles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from formation.agent.simulated.physics.model import (
    GYRO_BIAS,
    STEP_TIME,
    TICKS_PER_TURN,
    WHEEL_RADIUS_DEVIATION,
    Placed,
    chassis_of,
    mjcf,
)
from formation.agent.simulated.plant import Disturbed, measured
from formation.control.unicycle import Command, advance
from formation.mission.model import Mission
from formation.simulation.body import Body, obeyed

MAX_CATCH_UP_TIME = 5.0
"""Length of a freeze from which the simulation does not catch up, but continues later [s]."""
FRICTION_TIME = 0.5
"""Time constant with which the firmware compensates the friction of a wheel [s]."""
ALL_GROUPS = np.array([1, 0, 1, 1, 1, 1], dtype=np.uint8)
"""What a beam can hit: everything but what only pictures show."""


class BodyState(NamedTuple):
    """One robot: its true state, and what its encoders measure."""

    position: complex
    """True middle of the axle [m; world frame]."""
    heading: complex
    """True, unit complex [world frame]."""
    moving: Command
    """True forward speed and turn rate."""
    counted_position: complex
    """By odometry, which started where the robot stood [m; world frame]."""
    counted_heading: complex
    """By odometry, unit complex [world frame]."""
    counted_moving: Command
    """Forward speed of the wheels, if they rolled, and turn rate by gyroscope."""


class World:
    """All followers of a mission on one floor, with walls and posts.

    Equal seeds and commands give equal runs.
    """

    def __init__(self, mission: Mission, seed: int = 0) -> None:
        """Place all robots at their starts, posts and walls where [simulation] has them.

        `seed` determines the errors of wheels and gyroscopes.
        """
        names, count = mission.followers, len(mission.followers)
        self.robots = names
        self._body = Body.of(mission.simulated_robot)
        is_burger = mission.simulated_robot.profile == "turtlebot3_burger"
        specs = [mission.robots[name] for name in names]
        self._limits = [(spec.max_speed, spec.max_turn_rate) for spec in specs]
        self.chassis = {
            name: chassis_of(spec, is_burger=is_burger) for name, spec in zip(names, specs, strict=True)
        }
        """The construction of each robot."""
        chassis = tuple(self.chassis.values())
        chance = np.random.default_rng([seed, count])
        radii = np.array([[one.wheel_radius] * 2 for one in chassis])
        real = radii * (1.0 + WHEEL_RADIUS_DEVIATION * chance.standard_normal((count, 2)))
        self._bias = GYRO_BIAS * chance.standard_normal(count)  # of the gyroscopes [rad/s]
        placed = {
            name: Placed(one, spec.start.position, spec.start.heading, (float(left), float(right)))
            for name, one, spec, (left, right) in zip(names, chassis, specs, real, strict=True)
        }
        posts = [post.disc for post in mission.simulation.posts]
        walls = [wall.line for wall in mission.simulation.walls]
        self.model = mujoco.MjModel.from_xml_string(mjcf(placed, posts, walls))
        """MuJoCo's model, for pictures."""
        self.data = mujoco.MjData(self.model)
        """MuJoCo's state, for pictures."""
        self._find(names)
        self._wheel_radius, self._track = radii[:, 0], np.array([one.track for one in chassis])
        self._torque = np.array([[one.torque] * 2 for one in chassis])
        self._most_change = np.array(
            [[STEP_TIME * one.acceleration / one.wheel_radius] * 2 for one in chassis]
        )
        self._wanted = np.zeros((count, 2))  # of wheels left and right, as fast as they turn at most [rad/s]
        self._servo_rates = np.zeros((count, 2))  # of their servos at present [rad/s]
        self._expected = np.zeros((count, 2))  # of the wheels without a load [rad/s]
        self._follow = STEP_TIME / np.array([[one.response] * 2 for one in chassis])
        self._friction_rates = np.zeros((count, 2))  # the firmware's estimate of friction [rad/s]
        self._ticks = np.zeros((count, 2))
        self._counted = np.array([one.position for one in placed.values()])
        self._facing = np.array([one.heading for one in placed.values()])
        self._left = 0.0  # remainder of the requested time, less than a step [s]
        mujoco.mj_forward(self.model, self.data)

    def step(self, commands: Mapping[str, Command], dt: float) -> Mapping[str, BodyState]:
        """Simulate `dt` [s]; robots without a new command keep their last. Return all states."""
        self.advance(commands, dt)
        return self.states

    def advance(self, commands: Mapping[str, Command], dt: float) -> None:
        """Simulate `dt` [s]; robots without a new command keep their last."""
        for name, command in commands.items():
            self._obey(self.robots.index(name), command)
        self._left += max(dt, 0.0)
        steps = math.floor(self._left / STEP_TIME + 1e-9)
        for _ in range(steps):
            self._drive()
            mujoco.mj_step(self.model, self.data)
            self._count()
        self._left = max(0.0, self._left - steps * STEP_TIME)

    @property
    def states(self) -> Mapping[str, BodyState]:
        """The states of all robots now."""
        return MappingProxyType({name: self.state(name) for name in self.robots})

    def scan(
        self, robot: str, at: complex, heading: complex, beams: int, farthest: float
    ) -> NDArray[np.float64]:
        """Range of each beam of its scanner [m], infinite where nothing is hit: (beams,).

        The scanner sits at `at` [m] and faces `heading` [unit complex; both robot's frame], as high as its
        chassis says: among robots of one height it sees the others' scanners and nothing else of them.
        Beams go counter-clockwise round a whole turn, and end after `farthest` [m].
        """
        number = self.robots.index(robot)
        facing, lds = self._heading(number), self.chassis[robot].lds
        x, y = self.data.qpos[self._pose[number] : self._pose[number] + 2].tolist()
        here = complex(x, y) + facing * at
        eye = np.array([here.real, here.imag, 0.5 * (lds.bottom + lds.top)])
        ways = facing * heading * _rays(beams)
        rays = np.stack([ways.real, ways.imag, np.zeros(beams)], axis=1).ravel()
        hit, far = np.full(beams, -1, dtype=np.int32), np.zeros(beams)
        me, world = self._bodies[number], (self.model, self.data)
        mujoco.mj_multiRay(*world, eye, rays, ALL_GROUPS, True, me, hit, far, None, beams, farthest)
        return np.where((hit >= 0) & (far <= farthest), far, np.inf)

    def _find(self, names: tuple[str, ...]) -> None:
        model, sides = self.model, ("left", "right")
        joints = [[model.joint(f"{name}/{side}") for side in sides] for name in names]
        self._bodies = np.array([model.body(f"{name}/base").id for name in names])
        free = [int(model.body_jntadr[body]) for body in self._bodies]
        self._pose, self._motion = model.jnt_qposadr[free].tolist(), model.jnt_dofadr[free].tolist()
        self._turns = model.jnt_dofadr[free] + 5
        self._angles = np.array([[int(joint.qposadr[0]) for joint in pair] for pair in joints])
        self._rates = np.array([[int(joint.dofadr[0]) for joint in pair] for pair in joints])
        self._motors = np.array([[model.actuator(f"{name}/{side}").id for side in sides] for name in names])

    def _obey(self, number: int, command: Command) -> None:
        """Convert a command to wheel speeds, rounded and limited as the firmware does."""
        most, most_turn = self._limits[number]
        obeyed_command = obeyed(self._body, command)
        speed = min(max(obeyed_command.speed, -most), most)
        half = 0.5 * self._track[number] * min(max(obeyed_command.turn_rate, -most_turn), most_turn)
        wanted = np.array([speed - half, speed + half]) / self._wheel_radius[number]
        most_rate = self.chassis[self.robots[number]].wheel_rate
        self._wanted[number] = np.clip(wanted, -most_rate, most_rate)

    def _drive(self) -> None:
        """Set the servos to the wanted speeds plus the known friction."""
        change = self._wanted - self._servo_rates
        # `np.clip` takes several times as long
        self._servo_rates += np.minimum(np.maximum(change, -self._most_change), self._most_change)
        self._expected += self._follow * (self._servo_rates - self._expected)
        missing = self._expected - self.data.qvel[self._rates]
        able = np.abs(self.data.actuator_force[self._motors]) < self._torque
        self._friction_rates += (
            able * missing * (STEP_TIME / FRICTION_TIME)
        )  # a saturated motor learns nothing
        self.data.ctrl[self._motors] = self._servo_rates + self._friction_rates

    def _count(self) -> None:
        """Update odometry: arcs as long as the ticks of nominal wheels, curved as the gyroscopes say."""
        ticks = np.floor(self.data.qpos[self._angles] * (TICKS_PER_TURN / (2.0 * np.pi)))
        left, right = (ticks - self._ticks).T
        distance = 0.5 * (left + right) * (2.0 * np.pi / TICKS_PER_TURN) * self._wheel_radius
        self._ticks = ticks
        turn = np.exp(0.5j * STEP_TIME * (self.data.qvel[self._turns] + self._bias))
        self._counted += distance * turn * self._facing
        self._facing *= turn * turn

    def _heading(self, number: int) -> complex:
        w, x, y, z = self.data.qpos[self._pose[number] + 3 : self._pose[number] + 7].tolist()
        ahead = complex(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z))
        return ahead / abs(ahead)

    def state(self, robot: str) -> BodyState:
        """The state of a robot now, extrapolated along an arc since the engine's newest step."""
        number = self.robots.index(robot)
        at, dof = self._pose[number], self._motion[number]
        heading = self._heading(number)
        position = complex(*self.data.qpos[at : at + 2].tolist())
        velocity = complex(*self.data.qvel[dof : dof + 2].tolist())
        turn_rate = float(self.data.qvel[dof + 5])
        left, right = (self.data.qvel[self._rates[number]] * self._wheel_radius[number]).tolist()
        counted = Command(0.5 * (left + right), turn_rate + float(self._bias[number]))
        facing = self._facing[number] / abs(self._facing[number])
        moving = Command((velocity * heading.conjugate()).real, turn_rate)
        turned = complex(math.cos(turn_rate * self._left), math.sin(turn_rate * self._left))
        there = advance(complex(self._counted[number]), complex(facing), *counted, self._left)
        return BodyState(position + velocity * self._left, heading * turned, moving, *there, counted)


@cache
def _rays(beams: int) -> NDArray[np.complex128]:
    """The direction of each beam, unit complex [scanner's frame]: (beams,)."""
    return np.asarray(np.exp(2j * np.pi * np.arange(beams) / beams))


class Floor:
    """The world with a clock: the first call for a time moves all robots to it."""

    def __init__(self, world: World) -> None:
        """`world` stands still until the first `go_to`."""
        self.world = world
        self._time: float | None = None
        self._commands: dict[str, Command] = {}
        self._states: dict[str, BodyState] = {}  # since the newest step

    def go_to(self, time: float) -> None:
        """Simulate all robots until `time` [s, monotonic]; time never runs backwards."""
        if self._time is None:
            self._time = time
        if time > self._time:
            self.world.advance(self._commands, min(time - self._time, MAX_CATCH_UP_TIME))
            self._commands.clear()
            self._states.clear()
            self._time = time

    def state(self, robot: str) -> BodyState:
        """The state of a robot."""
        if robot not in self._states:
            self._states[robot] = self.world.state(robot)
        return self._states[robot]

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
        if spec.odometry_frame != "world":
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
        return measured(self.position, self.heading, self._body, self._noise)

    def cast(self, at: complex, heading: complex, beams: int, farthest: float) -> list[float]:
        """Ranges of the beams of a scanner on this robot [m]; infinite where nothing is hit."""
        found: list[float] = self._floor.world.scan(self._robot, at, heading, beams, farthest).tolist()
        return found

    @property
    def _state(self) -> BodyState:
        return self._floor.state(self._robot)


def wheeled(world: World, mission: Mission, robots: Sequence[str], seed: int) -> dict[str, Wheeled]:
    """Return the bodies of `robots`, all in `world`, for `formation.agent.simulated.simulated.World`."""
    floor = Floor(world)
    return {name: Wheeled(floor, mission, name, seed) for name in robots}
