"""Write every command to a robot and every status of its agent as JSON lines to stdout.

``python -m tests.field.witness ENDPOINT ROBOT``: a client of the robot's own router, as a ROS 2 node is.
"""

from __future__ import annotations

import queue
import sys
import time

import zenoh

from formation.ros2.messages import Diagnostics, Twist, decode
from formation.topics import CMD_VEL, STATUS
from formation.transport.bus_config import DEFAULTS
from formation.transport.runtime.process import say


def opened(endpoint: str) -> zenoh.Session:
    """Open a client session; retry until there is a router."""
    settings = zenoh.Config()
    for path, value in DEFAULTS:
        settings.insert_json5(path, value)
    settings.insert_json5("mode", '"client"')
    settings.insert_json5("connect/endpoints", f'["{endpoint}"]')
    while True:
        try:
            return zenoh.open(settings)
        except zenoh.ZError:
            time.sleep(0.1)


def main(endpoint: str, robot: str) -> None:
    received: queue.SimpleQueue[tuple[float, str, bytes]] = queue.SimpleQueue()

    def receive(sample: zenoh.Sample) -> None:
        received.put((time.monotonic(), str(sample.key_expr), sample.payload.to_bytes()))

    with opened(endpoint) as session:
        for topic in (CMD_VEL, STATUS):
            session.declare_subscriber(topic.key(robot), zenoh.handlers.Callback(receive, indirect=False))
        while True:
            at, key, payload = received.get()
            if key == CMD_VEL.key(robot):
                twist = decode(Twist, payload)
                say("command", at=at, speed=twist.speed, turn_rate=twist.turn_rate)
            else:
                (status,) = decode(Diagnostics, payload).statuses
                say("status", at=at, message=status.message, values=dict(status.values))


if __name__ == "__main__":
    main(*sys.argv[1:])
