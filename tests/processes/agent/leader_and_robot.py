"""A leader or a simulated robot as a real process, and buses by which a test links with it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from formation.mission.file import load
from formation.ros2.naming import Naming
from formation.ros2.ros_names import address
from formation.topics import POSITION
from formation.transport.bus import Bus, BusConfig
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBus
from formation.wire import Sample
from tests.support.child import PATIENCE, Child, started, until
from tests.unit.leader.leading import relayed

SIX = load("six_robots")


@contextmanager
def listening(endpoint: str, *keys: str) -> Iterator[Bus]:
    """Open a bus that is linked with the process under test and subscribed to `keys`."""
    with Bus(BusConfig(connect=(endpoint,))) as bus:
        for key in keys:
            bus.subscribe(key)
        bus.advertise(POSITION, POSITION.key("robot2"))
        yield bus


def first_received(bus: Bus) -> list[Sample]:
    """Samples up to the leader's first position. It gives no order before it has received a robot."""
    samples: list[Sample] = []

    def reached() -> bool:
        bus.send([relayed("robot2", None, of=SIX)])
        bus.wait(0.05)  # no more of them than the leader's mailbox holds, if that is paused meanwhile
        samples.extend(bus.drain())
        return any(sample.key == POSITION.key("robot1") for sample in samples)

    until(reached)
    return samples


@contextmanager
def agent_side(endpoint: str, *keys: str) -> Iterator[tuple[RobotBus, Mailbox]]:
    """Open a bus as robot2's agent has it; yield it and its mailbox, which receives `keys`."""
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
