"""The bodies of a whole fleet in one light process: odometry out, commands in, and how late each came.

python -m tests.campaigns.bench.bodies PLAN

Every robot is a Zenoh router of its own, as a real one is, and its odometry comes at an even phase of its
own. A command is taken to answer all odometry before it. The process says ``ready`` when all is declared,
``moving`` when every robot has been told to move, ``settled`` after the plan's time to settle, and
``measured`` with its figures after the time to measure.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np

from formation.agent.simulated.plant import Plant
from formation.control.unicycle import Command, control_point
from formation.mission.file import load
from formation.mission.model import Mission
from formation.ros2.messages import Odometry, Pose, Twist, decode, encode
from formation.simulation.body import Body
from formation.simulation.edges import Edges, edge_errors
from formation.topics import CMD_VEL, ODOM, POSITION
from formation.transport.bus import Bus, BusConfig
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBuses
from formation.transport.runtime.process import clocks, say
from formation.wire import Now, Sample
from tests.campaigns.figures import tail

PATIENCE, MORE = 60.0, 3.0
"""For everybody to be on the way, and so much more for each robot [s]."""
SPARE = 1.0
"""Between ``settled`` and what counts: looking at processes meanwhile disturbs them [s]."""


class Robot:
    """One body, and what is still to be answered."""

    def __init__(self, mission: Mission, name: str) -> None:
        spec = mission.robots[name]
        self.odom = ODOM.key(name)
        self.moved = 0.0
        """When it was first told to move [s, monotonic]."""
        self.requested: list[tuple[float, float]] = []
        """When odometry without an answer was due, and when it was sent [s, monotonic]."""
        noise = np.random.default_rng(mission.names.index(name))
        body = Body.of(mission.simulated_robot)
        self._plant = Plant(body, spec.start.position, spec.start.heading, noise)
        self._offset, self._time = spec.control_point_offset, time.monotonic()

    def obey(self, command: Command, arrived: float) -> None:
        """Strive for a command from when it arrived [s, monotonic]."""
        self._go_to(arrived)
        self._plant.obey(command)
        if command.speed != 0.0:
            self.moved = self.moved or arrived

    def odometry(self, now: Now) -> bytes:
        """What its own robot says now."""
        self._go_to(now.mono)
        return encode(Odometry(now.wall, *self._plant.odometry(), *self._plant.moving))

    def point(self, moment: float) -> complex:
        """True control point [m; world frame] at `moment` [s, monotonic]."""
        self._go_to(moment)
        return complex(control_point(self._plant.position, self._plant.heading, self._offset))

    def _go_to(self, moment: float) -> None:
        if moment > self._time:
            self._plant.advance(moment - self._time)
            self._time = moment


class Bodies:
    """All robots of a mission, the clock of their odometry, and the figures."""

    def __init__(self, mission: Mission, buses: RobotBuses) -> None:
        self.robots = {name: Robot(mission, name) for name in mission.followers}
        self.answers: list[float] = []
        """From odometry's being sent to the command [s]."""
        self.late = 0
        """Odometry that had no command half a period after it was due."""
        self.errors: list[float] = []
        """Mean over the edges, at every message of the leader's [m]."""
        self._mission, self._buses = mission, buses
        self._by_command = {CMD_VEL.key(name): robot for name, robot in self.robots.items()}
        self._leader, self._speed = POSITION.key(mission.leader), mission.route[0].speed
        self._edges, self._slots = Edges(mission.graph), np.array(mission.slots())
        self._turns, self._turn = list(self.robots.values()), 0
        self._period = 1.0 / mission.robots[mission.followers[0]].rate
        self._step, self._start = self._period / len(self.robots), time.monotonic()
        self.window = (float("inf"), float("inf"))
        """Odometry that is due in this interval counts [s, monotonic]."""

    @property
    def due(self) -> float:
        """When the next robot has odometry to send [s, monotonic]."""
        return self._start + self._turn * self._step

    @property
    def waiting(self) -> list[str]:
        """Robots that have not been ordered to move yet."""
        return [name for name, robot in self.robots.items() if not robot.moved]

    def speak(self) -> None:
        """Send the odometry that is due; what is late by a period is left out, as a robot's sensors do."""
        while self.due + self._period < time.monotonic():
            self.late += self._counts(self.due)
            self._turn += 1
        robot, due = self._turns[self._turn % len(self._turns)], self.due
        self._turn += 1
        payload = robot.odometry(clocks())
        robot.requested.append((due, time.monotonic()))
        self._buses.publish(robot.odom, payload)

    def process_inbox(self, inbox: Sequence[Sample]) -> None:
        """Obey commands, and look how far everybody is off when the leader says where it is."""
        for sample in inbox:
            if sample.key == self._leader:
                self._judge(decode(Pose, sample.payload))
                continue
            robot = self._by_command[sample.key]
            twist = decode(Twist, sample.payload)
            robot.obey(Command(twist.speed, twist.turn_rate), sample.arrived)
            for due, sent in robot.requested:
                if self._counts(due):
                    self.answers.append(sample.arrived - sent)
                    self.late += sample.arrived - due > 0.5 * self._period
            robot.requested.clear()

    def figures(self) -> dict[str, Any]:
        """What came of the interval; what has no answer by now is late."""
        late = self.late + sum(self._counts(due) for robot in self._turns for due, _ in robot.requested)
        if not self.answers:
            raise SystemExit("no robot had a command in the whole interval")
        requested, errors = round((self.window[1] - self.window[0]) / self._step), np.array(self.errors)
        rms = float(np.sqrt(np.square(errors).mean()))
        return {
            "latency_ms": tail([1e3 * took for took in self.answers]),
            "late_percent": 100.0 * late / requested,
            "error_mm": {"rms": 1e3 * rms, "max": 1e3 * float(errors.max())},
            "asked": float(requested),
        }

    def _judge(self, leader: Pose) -> None:
        now = clocks()
        if not self._counts(now.mono):
            return
        ahead = leader.heading * (self._speed * (now.wall - leader.stamp))
        points = np.array([leader.position + ahead, *(robot.point(now.mono) for robot in self._turns)])
        self.errors.append(float(edge_errors(self._edges, points, self._slots).mean()))

    def _counts(self, due: float) -> bool:
        return self.window[0] <= due < self.window[1]


def main(plan: dict[str, Any]) -> None:
    """Be the robots until the figures are there, or the parent is gone.

    `plan` has the mission's file, the leader's endpoint, each robot's own, and how long to settle and to
    measure [s].
    """
    mission, mailbox, parent = load(plan["mission"]), Mailbox(8192), os.getppid()
    with ExitStack() as stack:
        buses = RobotBuses(mission, plan["robots"], mailbox, mode="router", node="bodies")
        stack.callback(buses.close)
        leader = stack.enter_context(Bus(BusConfig(connect=(plan["leader"],)), mailbox))
        for name in mission.followers:
            buses.advertise(ODOM, ODOM.key(name))
            buses.subscribe(CMD_VEL, CMD_VEL.key(name))
        leader.subscribe(POSITION.key(mission.leader), wakes=False)
        say("ready")
        bodies = Bodies(mission, buses)

        def live(until: float) -> bool:
            """Go on; whether it is not over yet."""
            wait = bodies.due - time.monotonic()
            if wait > 0.0:
                mailbox.wait(wait)
            else:
                bodies.speak()
            bodies.process_inbox(mailbox.drain())
            return time.monotonic() < until and os.getppid() == parent

        patience = PATIENCE + MORE * len(bodies.robots)
        deadline = time.monotonic() + patience
        while (waiting := bodies.waiting) and live(deadline):
            pass
        if waiting:
            raise SystemExit(f"not told to move within {patience:g} s: {', '.join(waiting)}")
        moving = max(robot.moved for robot in bodies.robots.values())
        say("moving", moment=moving)
        while live(moving + plan["settle"]):
            pass
        say("settled")
        begin = time.monotonic() + SPARE
        bodies.window = (begin, begin + plan["seconds"])
        while live(begin + plan["seconds"] + 1.0 / mission.robots[mission.leader].rate):
            pass
        say("measured", **bodies.figures())
        while live(float("inf")):
            pass


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
