"""Everybody whom an agent has links with besides its robot: two neighbours who send, one monitor who listens.

python -m tests.campaigns.bench.surroundings PLAN
"""

from __future__ import annotations

import itertools
import json
import os
import sys
import time
from contextlib import ExitStack

from formation.protocol import order
from formation.protocol.order import Order, PositionAttachment
from formation.ros2.messages import encode
from formation.topics import POSITION
from formation.transport.bus import Bus, BusConfig
from formation.transport.runtime.process import say
from formation.wire import Outgoing
from tests.campaigns.bench.edge import LEADER, NEIGHBOUR, position

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
            result = Order(term=term, beat=tick // 2, mode="run", shape="line")
            beat = order.encode(
                PositionAttachment(publisher_id=robot, count=tick // 2, order=result, mission=tag)
            )
            payload = encode(position(robot, time.monotonic() - origin, time.time()))
            buses[robot].send([Outgoing(POSITION.key(robot), payload, beat)])
            monitor.drain()


if __name__ == "__main__":
    main(*json.loads(sys.argv[1]))
