"""A leader or a simulated robot as a real process, and a test in the place of whoever is linked with it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from formation.mission.file import load
from formation.ros2.naming import Naming
from formation.ros2.ros_names import address
from formation.transport.bus import Bus, BusConfig
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBus
from formation.wire import Sample
from tests.support.child import PATIENCE, Child, started

SIX = load("six_robots")


@contextmanager
def listening(endpoint: str, *keys: str) -> Iterator[Bus]:
    """A bus of the test's own, linked with the process under test."""
    with Bus(BusConfig(connect=(endpoint,))) as bus:
        for key in keys:
            bus.subscribe(key)
        yield bus


@contextmanager
def beside(endpoint: str, *keys: str) -> Iterator[tuple[RobotBus, Mailbox]]:
    """The test in the place of robot2's agent, and what it hears from the robot."""
    mailbox = Mailbox()
    with RobotBus((endpoint,), Naming.of(SIX.robots, ["robot2"]), mailbox) as bus:
        for key in keys:
            bus.subscribe(address(key).topic, key)
        yield bus, mailbox


def received(bus: Bus | Mailbox, enough: Callable[[Sequence[Sample]], Any]) -> list[Sample]:
    samples: list[Sample] = []
    deadline = time.monotonic() + PATIENCE
    while not enough(samples):
        assert bus.wait(deadline - time.monotonic()), f"only {len(samples)} samples came"
        samples += bus.drain()
    return samples


@contextmanager
def leader(endpoint: str, *arguments: str) -> Iterator[Child]:
    with started("formation.leader", "six_robots", "-l", endpoint, *arguments) as child:
        assert child.event("ready") == {"event": "ready", "process": "leader robot1"}
        yield child


@contextmanager
def robot2(endpoint: str, *arguments: str) -> Iterator[Child]:
    with started(
        "formation.agent.simulated", "six_robots", "--robot", "robot2", "-l", endpoint, *arguments
    ) as child:
        assert child.event("ready") == {"event": "ready", "process": "robot robot2"}
        yield child
