"""Simulated robots on the bus."""

from __future__ import annotations

import logging

from agent.robots.simulated import World
from formation.process import Process
from formation.topics import GROUND_TRUTH

_log = logging.getLogger(__name__)


def host(world: World, process: Process) -> None:
    """Declare, wait for whoever watches, then simulate until told to stop.

    The loop sleeps until the next odometry is due or a command arrives, so a command takes hold at once.
    """
    process.declare(world)
    process.ready(*(GROUND_TRUTH.key(name) for name in world.robots))
    process.run(world)
    for key, count in world.dropped.items():
        _log.warning("%d messages on %s were no commands, and were not obeyed", count, key)
