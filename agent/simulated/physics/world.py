"""The physics world, without a clock or a socket: from commands and time to the states of all robots.

A robot's firmware converts a command to wheel speeds, and its motors keep them, each within its limits.
Whether the robot then moves so depends on the floor and the obstacles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from formation.agent.simulated.physics.chassis import (
    GYRO_BIAS,
    TICKS_PER_TURN,
    WHEEL_RADIUS_DEVIATION,
    chassis_of,
)
from formation.agent.simulated.physics.model import STEP_TIME, Placed, mjcf
from formation.control.unicycle import Command, advance
from formation.mission.model import Mission
from formation.simulation.body import Body, obeyed

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
        self.time = 0.0
        """Simulated time [s]."""
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
        self._most_rate = np.array([[one.wheel_rate] * 2 for one in chassis])
        self._most_change = np.array(
            [[STEP_TIME * one.acceleration / one.wheel_radius] * 2 for one in chassis]
        )
        self._wanted = np.zeros((count, 2))  # of wheels left and right [rad/s]
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
        for name, command in commands.items():
            self._obey(self.robots.index(name), command)
        self.time += max(dt, 0.0)
        self._left += max(dt, 0.0)
        steps = math.floor(self._left / STEP_TIME + 1e-9)
        for _ in range(steps):
            self._drive()
            mujoco.mj_step(self.model, self.data)
            self._count()
        self._left = max(0.0, self._left - steps * STEP_TIME)
        return self.states

    @property
    def states(self) -> Mapping[str, BodyState]:
        """The states of all robots now, extrapolated along arcs since the engine's newest step."""
        return MappingProxyType({name: self._state(number) for number, name in enumerate(self.robots)})

    @property
    def torques(self) -> Mapping[str, tuple[float, float]]:
        """Torques of the motors, left and right [N m]."""
        given = self.data.actuator_force[self._motors]
        return {
            name: (float(left), float(right)) for name, (left, right) in zip(self.robots, given, strict=True)
        }

    @property
    def touching(self) -> frozenset[frozenset[str]]:
        """Pairs of robots that touch; a robot alone if it touches a wall or a post."""
        pairs = self.data.contact.geom[: self.data.ncon]
        bodies = self.model.geom_bodyid[pairs]
        return frozenset(
            frozenset(filter(None, (self._named.get(int(one)), self._named.get(int(other)))))
            for (one, other), (first, _) in zip(bodies, pairs, strict=True)
            if self.model.geom_contype[first] == _BODY
        )

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
        x, y, _ = self.data.qpos[self._pose[number] : self._pose[number] + 3]
        here = complex(x, y) + facing * at
        eye = np.array([here.real, here.imag, 0.5 * (lds.bottom + lds.top)])
        ways = facing * heading * np.exp(2j * np.pi * np.arange(beams) / beams)
        rays = np.stack([ways.real, ways.imag, np.zeros(beams)], axis=1).ravel()
        hit, far = np.full(beams, -1, dtype=np.int32), np.zeros(beams)
        me, world = self._bodies[number], (self.model, self.data)
        mujoco.mj_multiRay(*world, eye, rays, ALL_GROUPS, True, me, hit, far, None, beams, farthest)
        return np.where((hit >= 0) & (far <= farthest), far, np.inf)

    def _find(self, names: tuple[str, ...]) -> None:
        """Find the robots in MuJoCo's arrays."""
        model, sides = self.model, ("left", "right")
        joints = [[model.joint(f"{name}/{side}") for side in sides] for name in names]
        self._bodies = np.array([model.body(f"{name}/base").id for name in names])
        self._named = {int(body): name for body, name in zip(self._bodies, names, strict=True)}
        free = [int(model.body_jntadr[body]) for body in self._bodies]
        self._pose, self._motion = model.jnt_qposadr[free], model.jnt_dofadr[free]
        self._angles = np.array([[int(joint.qposadr[0]) for joint in pair] for pair in joints])
        self._rates = np.array([[int(joint.dofadr[0]) for joint in pair] for pair in joints])
        self._motors = np.array([[model.actuator(f"{name}/{side}").id for side in sides] for name in names])

    def _obey(self, number: int, command: Command) -> None:
        """Convert a command to wheel speeds, rounded and limited as the firmware does."""
        most, most_turn = self._limits[number]
        obeyed_command = obeyed(self._body, command)
        speed = min(max(obeyed_command.speed, -most), most)
        half = 0.5 * self._track[number] * min(max(obeyed_command.turn_rate, -most_turn), most_turn)
        self._wanted[number] = np.array([speed - half, speed + half]) / self._wheel_radius[number]

    def _drive(self) -> None:
        """Set the servos to the wanted speeds plus the known friction."""
        change = np.clip(self._wanted, -self._most_rate, self._most_rate) - self._servo_rates
        self._servo_rates += np.clip(change, -self._most_change, self._most_change)
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
        way = (ticks - self._ticks).mean(axis=1) * (2.0 * np.pi / TICKS_PER_TURN) * self._wheel_radius
        self._ticks = ticks
        turn = np.exp(0.5j * STEP_TIME * (self.data.qvel[self._motion + 5] + self._bias))
        self._counted += way * turn * self._facing
        self._facing *= turn * turn

    def _heading(self, number: int) -> complex:
        w, x, y, z = self.data.qpos[self._pose[number] + 3 : self._pose[number] + 7]
        ahead = complex(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z))
        return ahead / abs(ahead)

    def _state(self, number: int) -> BodyState:
        at, dof = self._pose[number], self._motion[number]
        heading = self._heading(number)
        position = complex(*self.data.qpos[at : at + 2])
        velocity = complex(*self.data.qvel[dof : dof + 2])
        turn_rate = float(self.data.qvel[dof + 5])
        left, right = self.data.qvel[self._rates[number]] * self._wheel_radius[number]
        counted = Command(float(0.5 * (left + right)), turn_rate + float(self._bias[number]))
        facing = self._facing[number] / abs(self._facing[number])
        moving = Command((velocity * heading.conjugate()).real, turn_rate)
        turned = complex(math.cos(turn_rate * self._left), math.sin(turn_rate * self._left))
        there = advance(complex(self._counted[number]), complex(facing), *counted, self._left)
        return BodyState(position + velocity * self._left, heading * turned, moving, *there, counted)


_BODY = 4
"""Collision group of decks, scanners, walls and posts in the model."""
