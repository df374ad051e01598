"""What robots really do while others meddle: an observer on their side, and what can be read from its notes.

``python -m tests.processes.agent.wheels MISSION NOTES`` is a client of every robot's router and listens to
the leader. It writes one line for each message; `Wheels` reads them as they come, so it does not matter on
which computer of a field the observer runs.
"""

from __future__ import annotations

import json
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from itertools import dropwhile
from pathlib import Path
from typing import NamedTuple, TextIO

from formation.control.unicycle import control_point
from formation.mission.file import load
from formation.mission.model import Mission
from formation.ros2.messages import Odometry, Pose, Twist, TwistStamped, decode
from formation.topics import CMD_VEL, GROUND_TRUTH, ODOM, POSITION
from formation.transport.bus import Bus, BusConfig
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBuses
from formation.transport.runtime.process import say
from formation.transport.wiring import endpoints
from formation.wire import Sample

PATIENCE = 30.0
"""[s]"""
STANDS = 4
"""So many zeros of the odometry in a row mean that a robot stands: a fifth of a second."""


def observe(mission: Mission, notes: TextIO) -> None:
    """Note what is said, until killed."""
    mailbox = Mailbox(8192)
    where = endpoints(mission)
    robots = RobotBuses(mission, where.robots, mailbox, node="observer")
    for name in mission.followers:
        for topic in (ODOM, CMD_VEL, GROUND_TRUTH):
            robots.subscribe(topic, topic.key(name))
    fleet = Bus(BusConfig(connect=(where.agents[mission.leader],)), mailbox)
    fleet.subscribe(POSITION.key(mission.leader))
    say("ready")
    while True:
        mailbox.wait(1.0)
        behind = time.time() - time.monotonic()
        for sample in mailbox.drain():
            note = [sample.key, sample.arrived + behind, *_numbers(mission, sample)]
            notes.write(json.dumps(note) + "\n")
        notes.flush()


def _numbers(mission: Mission, sample: Sample) -> tuple[float, ...]:
    name, _, what = sample.key.partition("/")
    if what == "odom":
        odometry = decode(Odometry, sample.payload)
        return odometry.stamp, odometry.speed, odometry.turn_rate
    if what == "cmd_vel":
        stamped = mission.robots[name].cmd_vel == "twist_stamped"
        twist = decode(TwistStamped, sample.payload) if stamped else decode(Twist, sample.payload)
        return twist.speed, twist.turn_rate
    pose = decode(Pose, sample.payload)
    return pose.stamp, pose.position.real, pose.position.imag, pose.heading.real, pose.heading.imag


class Moving(NamedTuple):
    """One odometry message."""

    stamp: float
    """[s, system clock]"""
    speed: float
    turn_rate: float


class Said(NamedTuple):
    """One command, whoever gave it."""

    arrived: float
    """[s, system clock]"""
    speed: float
    turn_rate: float


class Wheels:
    """What an observer has noted so far."""

    def __init__(self, mission: Mission, notes: Path) -> None:
        self.mission = mission
        self.moving: dict[str, list[Moving]] = defaultdict(list)
        """Odometry, by robot."""
        self.said: dict[str, list[Said]] = defaultdict(list)
        """Commands on their way to each robot."""
        self.errors: dict[str, list[tuple[float, float]]] = defaultdict(list)
        """Distance of each robot's control point from its slot [m], with its time [s, system clock]."""
        self._notes, self._read = notes, 0
        self._leader: tuple[float, complex] | None = None
        self._route = mission.leader_heading * mission.route[0].speed

    def look(self) -> None:
        """Read what was noted since."""
        with self._notes.open("rb") as file:
            file.seek(self._read)
            lines, newline, _ = file.read().rpartition(b"\n")  # the last one may be written just now
        self._read += len(lines) + len(newline)
        for line in lines.splitlines():
            key, arrived, *numbers = json.loads(line)
            name, _, what = key.partition("/")
            if what == "odom":
                self.moving[name].append(Moving(*numbers))
            elif what == "cmd_vel":
                self.said[name].append(Said(arrived, *numbers))
            elif what == "position":
                self._leader = numbers[0], complex(*numbers[1:3])
            elif self._leader is not None:
                self._placed(name, *numbers)

    def until(self, true: Callable[[], object], what: str, patience: float = PATIENCE) -> None:
        """Look until it is so; AssertionError after `patience` [s]."""
        deadline = time.monotonic() + patience
        self.look()
        while not true():
            assert time.monotonic() < deadline, f"not within {patience:g} s: {what}"
            time.sleep(0.01)
            self.look()

    def drives(self, name: str) -> bool:
        """Whether a robot follows the leader, in its place to 2 cm, as of its newest odometry."""
        newest = self.moving[name][-1:], self.errors[name][-1:]
        return all(newest) and newest[0][0].speed > 0.5 * abs(self._route) and newest[1][0][1] < 0.02

    def about(self, name: str) -> str:
        """What was noted of a robot last, to find out why it does not do what it should."""
        return (
            f"{name} at {time.time()}: moved {self.moving[name][-3:]}\nwas told {self.said[name][-3:]}\n"
            f"aside {self.errors[name][-3:]}\nthe leader {self._leader}"
        )

    def stands(self, name: str, since: float) -> bool:
        """Whether, as of its newest odometry, a robot has stood for a while that began after `since`."""
        last = [one for one in self.moving[name][-STANDS:] if one.stamp >= since]
        return len(last) == STANDS and not any(one.speed or one.turn_rate for one in last)

    def stood(self, name: str, since: float) -> float:
        """When a robot that stands by now came to stand [s, system clock], by its own odometry.

        That is up to a period later than it really did. It drove at `since`, else AssertionError.
        """
        before = [one for one in self.moving[name] if one.stamp < since]
        assert before[-1].speed > 0.5 * abs(self._route), f"{name} did not drive: {before[-1]}"
        after = [one for one in self.moving[name] if one.stamp >= since]
        at_rest = list(dropwhile(lambda one: one.speed or one.turn_rate, after))
        assert not any(one.speed or one.turn_rate for one in at_rest), f"{name} drove on: {after}"
        return at_rest[0].stamp

    def commanded(self, name: str, start: float, end: float) -> list[Said]:
        """Commands that reached a robot's router in that time [s, system clock]."""
        return [one for one in self.said[name] if start <= one.arrived <= end]

    def _placed(self, name: str, stamp: float, x: float, y: float, cosine: float, sine: float) -> None:
        assert self._leader is not None
        then, leader = self._leader
        slot = leader + self._route * (stamp - then) + self.mission.slot(name)
        offset = self.mission.robots[name].control_point_offset
        point = control_point(complex(x, y), complex(cosine, sine), offset)
        self.errors[name].append((stamp, abs(point - slot)))


if __name__ == "__main__":
    with Path(sys.argv[2]).open("w", encoding="utf-8") as file:
        observe(load(sys.argv[1]), file)
