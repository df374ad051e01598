"""Simulated robots on the robots' side, each of which also replaces a robot's ROS 2 router."""

from __future__ import annotations

import logging
from collections.abc import Iterable

from formation.agent.simulated.simulated import World
from formation.ros2.ros_names import address
from formation.topics import GROUND_TRUTH
from formation.transport.runtime.loop import Pauses, Runtime
from formation.wire import Outgoing

_log = logging.getLogger(__name__)


def host(world: World, process: Runtime) -> Pauses:
    """Declare, wait for a monitor if requested, then simulate until told to stop.

    The loop sleeps until the next odometry is due or a command arrives, so a command takes effect at once.
    """
    robots = process.robot
    for topic, key in world.publications:
        robots.advertise(topic, key)
    for key in world.subscriptions:
        topic = address(key).topic
        if topic.side == "robot":
            robots.subscribe(topic, key)
        else:
            process.bus.subscribe(key)

    def send(outbox: Iterable[Outgoing]) -> None:
        for out in outbox:
            robots.publish(out.key, out.payload)

    process.ready(*(GROUND_TRUTH.key(name) for name in world.robots))
    yield from process.loop(world, send)
    for key, count in world.dropped.items():
        _log.warning("%d messages on %s were no commands, and were not obeyed", count, key)
