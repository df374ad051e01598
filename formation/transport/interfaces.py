"""The two sides of a process as its code sees them: the fleet's bus, and its robot's.

On a machine both are Zenoh sessions; in a rehearsal they are in memory.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable
from typing import Protocol

from formation.topics import Topic
from formation.wire import Outgoing, Sample

Handler = Callable[[bytes, float], bytes]
"""Answers ``handler(request, received)``; ``received`` is the time of arrival [s, monotonic]."""


class FleetSide(Protocol):
    """The part of `formation.transport.bus.Bus` that a process's main function uses."""

    @property
    def published(self) -> Counter[str]:
        """Messages published, by key."""

    @property
    def received(self) -> Counter[str]:
        """Messages that arrived, by key."""

    @property
    def refused(self) -> Counter[str]:
        """Number of refused messages and links so far, by kind."""

    @property
    def advertised(self) -> Collection[str]:
        """Every key that this side may publish."""

    @property
    def overflowed(self) -> int:
        """Messages that newer ones pushed out of the mailbox before they were drained."""

    def advertise(self, topic: Topic, key: str) -> None:
        """As `Bus.advertise`."""

    def publish(self, key: str, payload: bytes, attachment: bytes | None = None) -> None:
        """As `Bus.publish`."""

    def send(self, outbox: Iterable[Outgoing]) -> None:
        """As `Bus.send`."""

    def subscribe(
        self, key: str, *, wakes: bool = True, check: Callable[[Sample, float], Sample] | None = None
    ) -> None:
        """As `Bus.subscribe`."""

    def answer(self, key: str, handler: Handler) -> None:
        """As `Bus.answer`."""

    def drain(self) -> list[Sample]:
        """As `Bus.drain`."""


class RobotSide(Protocol):
    """A `formation.transport.robot_bus.RobotBus`, or several as one."""

    @property
    def published(self) -> Counter[str]:
        """Messages handed to Zenoh, by logical key."""

    @property
    def received(self) -> Counter[str]:
        """Messages that arrived, by logical key."""

    @property
    def connected(self) -> bool:
        """Whether every router is linked."""

    def advertise(self, topic: Topic, key: str) -> None:
        """As `RobotBus.advertise`."""

    def subscribe(self, topic: Topic, key: str, *, from_others: bool = False) -> None:
        """As `RobotBus.subscribe`."""

    def answer(self, key: str, handler: Handler) -> None:
        """As `RobotBus.answer`."""

    def publish(self, key: str, payload: bytes) -> None:
        """As `RobotBus.publish`."""

    def routed(self, key: str) -> bool | None:
        """As `RobotBus.routed`."""

    def close(self) -> None:
        """As `RobotBus.close`."""
