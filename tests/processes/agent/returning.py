"""Six robots that drive in real processes, with watchdogs, whose agents are killed and started again.

A witness on the robots' side reads what they are told and where they really are. Times are stamps of this
machine's system clock.
"""

from __future__ import annotations

import cmath
import math
import os
import signal
import time
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Callable
from contextlib import ExitStack, closing
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from formation.control.unicycle import control_point
from formation.deploy.local.plan import programs
from formation.deploy.local.ports import Ports
from formation.mission.file import load
from formation.protocol.order import Do, OperatorReply, OperatorRequest, decode, encode
from formation.ros2.messages import Pose, Twist
from formation.ros2.messages import decode as decode_message
from formation.simulation.edges import Edges, formation_error
from formation.topics import CMD_VEL, GROUND_TRUTH, ORDER, POSITION
from formation.transport.bus import Bus, BusConfig
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBuses
from tests.support.child import PATIENCE, Child, started
from tests.support.named import named

CLOSE = 0.02
"""Formation error of a team that nothing has happened to [m]."""
BEHIND = 0.5
"""So long ago it is known where everybody was [s]."""


class ReceivedCommand(NamedTuple):
    """One command that a robot got."""

    arrived: float
    speed: float
    turn_rate: float


class Return(NamedTuple):
    """How an agent came back."""

    robot: str
    gone: float
    """How long there was none [s]."""
    driving: float
    """From its start to its first command that moves the robot [s]."""
    heading: float
    """How far its heading was off then [deg]."""
    share: float
    """Its largest command, as a share of the limit."""
    jump: float
    """The largest change between two commands that move the robot, likewise."""
    settled: float
    """From its start until the team was close to formation [s]."""


class Team:
    """All processes of a mission, and the witness."""

    def __init__(self, mission: Path, folder: Path, stack: ExitStack, *, state: bool) -> None:
        """`state`: whether agents keep, in `folder`, what is to outlive them."""
        self.mission = load(mission)
        self.where = stack.enter_context(Ports(self.mission)).endpoints
        self._stack, self._children = stack, dict[str, Child]()
        self._arguments: dict[str, tuple[str, ...]] = {}
        for program in programs(
            self.mission, str(mission), self.where,
            parent=os.getpid(), record=folder, watchdogs=True, patience=0.0,
        )[1:]:  # fmt: skip
            words = program.argv[program.argv.index("-m") + 1 :]
            kept = ("--state", str(folder / "state")) if state and program.name.startswith("agent") else ()
            self._arguments[program.name] = (*words, *kept)
            self.begin(program.name)
        self._box = Mailbox(65_536)
        robots = stack.enter_context(
            closing(RobotBuses(self.mission, self.where.robots, self._box, node="witness"))
        )
        for name in self.mission.followers:
            for topic in (GROUND_TRUTH, CMD_VEL, POSITION):
                robots.subscribe(topic, topic.key(name))
        self._fleet = stack.enter_context(
            Bus(BusConfig(connect=tuple(self.where.agents.values())), self._box)
        )
        self._fleet.subscribe(POSITION.key(self.mission.leader))
        self.commands = defaultdict[str, list[ReceivedCommand]](list)
        self._published = defaultdict[str, list[tuple[float, Pose]]](list)
        self._true = defaultdict[str, list[Pose]](list)
        self.until(self.in_formation)

    def begin(self, name: str) -> None:
        """Start a process, the same way each time."""
        module, *arguments = self._arguments[name]
        self._children[name] = self._stack.enter_context(started(module, *arguments))
        self._children[name].event("ready")

    def kill(self, name: str) -> None:
        """With SIGKILL, and wait until it is gone."""
        child = self._children[name]
        os.kill(child.pid, signal.SIGKILL)
        child.wait()

    def ask(self, robot: str, do: Do) -> OperatorReply:
        """Ask one robot until it answers."""
        request = named(OperatorRequest(do=do), lambda data: self._asked(robot, data))
        return decode(OperatorReply, self._asked(robot, encode(request)))

    def _asked(self, robot: str, request: bytes) -> bytes:
        deadline = time.monotonic() + PATIENCE
        while not (replies := self._fleet.ask(ORDER.key(robot), request, 0.5)):
            assert time.monotonic() < deadline, f"{robot} does not answer"
        return replies[0].payload

    def look(self, seconds: float) -> None:
        """Take down what is said for so long."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._box.wait(left)
            now, mono = time.time(), time.monotonic()
            for sample in self._box.drain():
                robot, _, what = sample.key.partition("/")
                arrived = now - (mono - sample.arrived)
                if what == "cmd_vel":
                    twist = decode_message(Twist, sample.payload)
                    self.commands[robot].append(ReceivedCommand(arrived, twist.speed, twist.turn_rate))
                elif what == "position" and robot != self.mission.leader:
                    self._published[robot].append((arrived, decode_message(Pose, sample.payload)))
                else:
                    self._true[robot].append(decode_message(Pose, sample.payload))

    def until(self, condition: Callable[[], bool], patience: float = 2 * PATIENCE) -> None:
        """Look on until that holds."""
        deadline = time.monotonic() + patience
        while not condition():
            assert time.monotonic() < deadline, f"formation error {self.error(time.time() - 1.0):.3f} m"
            self.look(0.05)

    def in_formation(self) -> bool:
        """Whether the team is, and has been for half a second."""
        now = time.time() - BEHIND
        return all(self.error(now - 0.1 * k) < self.mission.settled for k in range(6))

    def error(self, moment: float) -> float:
        """Formation error of the robots as they really were then [m]; infinite where nobody knows."""
        points = []
        for name in self.mission.names:
            offset = self.mission.robots[name].control_point_offset if name != self.mission.leader else 0.0
            track = self._true[name][-400:]
            if len(track) < 2 or not track[0].stamp <= moment <= track[-1].stamp:
                return math.inf
            seen = np.array([control_point(pose.position, pose.heading, offset) for pose in track])
            stamps = np.array([pose.stamp for pose in track])
            points.append(complex(np.interp(moment, stamps, seen.real), np.interp(moment, stamps, seen.imag)))
        edges, slots = Edges(self.mission.graph), np.array(self.mission.slots())
        return float(formation_error(edges, np.array(points), slots))

    def restart(self, robot: str, gone: float) -> Return:
        """Kill a robot's agent, start it again after so long [s], and watch it come back."""
        self.kill(f"agent {robot}")
        self.look(gone)
        began = time.time()
        self.begin(f"agent {robot}")
        self.until(lambda: bool(self._moving(robot, began)))
        drove = self._moving(robot, began)[0].arrived
        self.until(lambda: self._published[robot][-1][0] > drove + 0.2)
        heading = self._heading_error(robot, drove)
        errors = list[tuple[float, float]]()

        def again() -> bool:
            now = time.time() - BEHIND
            errors.append((now, self.error(now)))
            return any(one < CLOSE for _, one in errors[-10:]) and now > began + 2.0 and self.in_formation()

        self.until(again)
        far = max((moment for moment, error in errors if error >= self.mission.settled), default=began)
        close = [moment for moment, error in errors if moment > far and error < CLOSE]
        spec = self.mission.robots[robot]
        reported = [one for one in self.commands[robot] if one.arrived >= began]
        shares = [(one.speed / spec.max_speed, one.turn_rate / spec.max_turn_rate) for one in reported]
        jumps = [
            max(abs(u - u_before), abs(w - w_before))
            for (before, now), ((u_before, w_before), (u, w)) in zip(
                pairwise(reported), pairwise(shares), strict=True
            )
            if (u or w) and now.arrived - before.arrived < 1.8 / spec.rate  # none was lost between them
        ]
        return Return(
            robot, gone, drove - began, heading,
            max(max(abs(u), abs(w)) for u, w in shares), max(jumps), min(close, default=math.inf) - began,
        )  # fmt: skip

    def _moving(self, robot: str, since: float) -> list[ReceivedCommand]:
        return [one for one in self.commands[robot] if one.arrived >= since and (one.speed or one.turn_rate)]

    def _heading_error(self, robot: str, moment: float) -> float:
        """How far the heading was off when the command of that moment was given, or a period later [deg].

        A position of the period before may arrive together with the command.
        """
        result = [pose for arrived, pose in self._published[robot] if arrived > moment - 0.005][1]
        track = self._true[robot]
        near = bisect_left([pose.stamp for pose in track], result.stamp)
        truth = min(track[max(0, near - 1) : near + 1], key=lambda pose: abs(pose.stamp - result.stamp))
        return math.degrees(abs(cmath.phase(result.heading / truth.heading)))


def summary_of(returns: list[Return]) -> str:
    """A line for each, and the worst of all."""
    lines = [
        f"  {one.robot} gone {one.gone:g} s: drives after {one.driving:.2f} s, heading {one.heading:.2f}°,"
        f" commands up to {one.share:.2f}, jump {one.jump:.2f}, in formation after {one.settled:.1f} s"
        for one in returns
    ]
    worst = (
        f"{len(returns)} tries; worst: heading {max(one.heading for one in returns):.2f}°,"
        f" command {max(one.share for one in returns):.2f}, jump {max(one.jump for one in returns):.2f},"
        f" in formation after {max(one.settled for one in returns):.1f} s"
    )
    return "\n".join([*lines, worst])
