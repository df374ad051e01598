"""The scene that the edge is measured in: a follower and its two neighbours on a straight line.

``python -m tests.campaigns.bench.edge PLAN`` plays all that an agent has links with besides its robot:
the two neighbours, which send, and one monitor, which listens.
"""

from __future__ import annotations

import itertools
import json
import os
import sys
import time
from contextlib import ExitStack

from formation.control.plane import rotation
from formation.control.unicycle import Command
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.ros2.messages import Odometry, Pose, encode
from formation.topics import POSITION
from formation.transport.bus import Bus, BusConfig
from formation.transport.runtime.process import say
from formation.wire import Outgoing

RATE = 50.0
"""Of odometry and of each neighbour's positions, where nothing else is said [Hz]."""
LEADER, NEIGHBOUR, FOLLOWER = "robot1", "robot2", "robot3"
SPEED = 0.2
"""Of everybody [m/s]."""
START = {LEADER: 0j, NEIGHBOUR: -1.0 + 0j, FOLLOWER: -2.3 + 0.1j}
"""Centres at the beginning [m]; the follower stays off its slot, so that its commands are not zero."""


def mission(rate: float = RATE) -> str:
    """The mission's file, everybody at `rate` [Hz]."""
    return f"""
name = "edge"
leader = "{LEADER}"
[robot]
control_point_offset = 0.2
max_speed = 1.5
max_turn_rate = 1.5
rate = {rate}
[shapes.line]
{NEIGHBOUR} = [-1.0, 0.0]
{FOLLOWER} = [-2.0, 0.0]
[robots.{LEADER}]
start = {{ x = 0.0, y = 0.0 }}
[robots.{NEIGHBOUR}]
neighbours = ["{LEADER}"]
start = {{ x = -1.0, y = 0.0 }}
[robots.{FOLLOWER}]
neighbours = ["{LEADER}", "{NEIGHBOUR}"]
start = {{ x = -2.0, y = 0.1 }}
[[route]]
speed = {SPEED}
heading_deg = 0
"""


def attachment(publisher_id: str, beat: int, tag: str, term: int = 1) -> PositionAttachment:
    """The order to run that a neighbour relays, in the mission of this `tag`."""
    what = Order(term=term, beat=beat, mode="run", shape="line")
    return PositionAttachment(publisher_id=publisher_id, count=beat, order=what, mission=tag)


class Follower:
    """The follower's robot, which does as its agent commands."""

    def __init__(self) -> None:
        self._at, self._facing = START[FOLLOWER], 1.0 + 0j

    def odometry(self, command: Command, period: float, wall: float) -> Odometry:
        """What it says after a `period` [s] of this command, at `wall` [s] by its clock."""
        self._at += command.speed * period * self._facing
        self._facing *= rotation(command.turn_rate * period)
        return Odometry(wall, self._at, self._facing, command.speed, command.turn_rate)


def odometry(elapsed: float, wall: float) -> Odometry:
    """What the follower's robot says `elapsed` [s] after the beginning, at `wall` [s] by its clock."""
    return Odometry(wall, START[FOLLOWER] + SPEED * elapsed, 1.0 + 0j, SPEED, 0.0)


def position(robot: str, elapsed: float, wall: float) -> Pose:
    """What a neighbour says then."""
    return Pose(wall, START[robot] + SPEED * elapsed, 1.0 + 0j)


SWEEP = 100.0 / 101.0
"""Neighbours send a little slower than odometry comes, so that they meet all of its phases in turn."""


def main(
    origin: float, rate: float, listen: dict[str, str], monitored: dict[str, list[str]], tag: str
) -> None:
    """Play them until the parent is gone.

    `origin` is the scene's beginning [s, monotonic], `rate` that of each neighbour's positions [Hz], `listen`
    its endpoint; `monitored` has, by endpoint to dial, the keys to listen to; `tag` is the mission's.
    """
    parent, term, start = os.getppid(), time.time_ns(), time.monotonic()
    with ExitStack() as stack:
        buses = {}
        for robot in (LEADER, NEIGHBOUR):
            buses[robot] = stack.enter_context(Bus(BusConfig(listen=(listen[robot],))))
            buses[robot].advertise(POSITION, POSITION.key(robot))
        monitor = stack.enter_context(Bus(BusConfig(connect=tuple(monitored))))
        for key in itertools.chain.from_iterable(monitored.values()):
            monitor.subscribe(key)
        say("ready")
        for tick in itertools.count():
            if os.getppid() != parent:
                return
            due = start + tick / (2.0 * rate * SWEEP)
            time.sleep(max(0.0, due - time.monotonic()))
            robot = NEIGHBOUR if tick % 2 else LEADER
            beat = json_message.encode(attachment(robot, tick // 2, tag, term))
            payload = encode(position(robot, time.monotonic() - origin, time.time()))
            buses[robot].send([Outgoing(POSITION.key(robot), payload, beat)])
            monitor.drain()


if __name__ == "__main__":
    main(*json.loads(sys.argv[1]))
