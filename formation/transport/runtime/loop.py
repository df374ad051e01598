"""The loop of every process around its core: update, step, publish, wait; and its two sides as it sees them.

On a machine both sides, the fleet's bus and its robot's, are Zenoh sessions; in a rehearsal they are in
memory. The loop is a generator of pauses, and so are the main functions that use it: what plays them decides
how time passes. A `formation.transport.runtime.process.Process` sleeps; a rehearsal puts its clock forward.
"""

from __future__ import annotations

import logging
import os
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
from typing import Protocol

from formation.topics import Topic
from formation.transport.mailbox import Handler, Mailbox
from formation.wire import Now, Outgoing, Sample

Pauses = Generator[float, None, None]
"""Times to wait, one after another [s]; a message that wakes ends a wait early."""
PARENT_CHECK_PERIOD = 0.2
"""Period at which an idle process checks whether to stop [s]."""
_log = logging.getLogger(__name__)


class Steps(Protocol):
    """The part that a process's loop calls: bytes in, bytes out, no clock of its own."""

    @property
    def due(self) -> float:
        """When it needs a step though nothing arrives [s, monotonic]."""

    @property
    def dropped(self) -> Mapping[str, int]:
        """Number of messages not used, by key."""

    def step(self, now: Now, inbox: Sequence[Sample]) -> Iterable[Outgoing]:
        """Process the received messages and return those to publish. May be called at any time."""

    def halt(self, now: Now, reason: str) -> Iterable[Outgoing]:
        """Return the last messages, which leave the fleet safe without this process."""


class Core(Steps, Protocol):
    """A process without its transport."""

    @property
    def publications(self) -> Iterable[tuple[Topic, str]]:
        """Every topic and key that it publishes."""

    @property
    def subscriptions(self) -> Iterable[str]:
        """Every key that it subscribes to."""


class StopRequest(Protocol):
    """A request to stop; true once there is one."""

    @property
    def reason(self) -> str:
        """Why to stop; empty if there is no reason."""

    def __bool__(self) -> bool:
        """Whether to stop."""


class Side(Protocol):
    """What both sides of a process have in common."""

    @property
    def published(self) -> Counter[str]:
        """Messages handed to Zenoh, by (logical) key."""

    @property
    def received(self) -> Counter[str]:
        """Messages that arrived, by (logical) key."""

    def advertise(self, topic: Topic, key: str) -> None:
        """Declare that this process will publish `key`."""

    def answer(self, key: str, handler: Handler) -> None:
        """Answer queries on `key`."""


class FleetSide(Side, Protocol):
    """The part of `formation.transport.bus.Bus` that a process's main function uses."""

    @property
    def refused(self) -> Counter[str]:
        """Number of refused messages and links so far, by kind."""

    @property
    def advertised(self) -> Collection[str]:
        """Every key that this side may publish."""

    @property
    def overflowed(self) -> int:
        """Messages that newer ones pushed out of the mailbox before they were drained."""

    def publish(self, key: str, payload: bytes, attachment: bytes | None = None) -> None:
        """As `Bus.publish`."""

    def send(self, outbox: Iterable[Outgoing]) -> None:
        """As `Bus.send`."""

    def subscribe(
        self, key: str, *, wakes: bool = True, check: Callable[[Sample, float], Sample] | None = None
    ) -> None:
        """As `Bus.subscribe`."""

    def drain(self) -> list[Sample]:
        """As `Bus.drain`."""


class RobotSide(Side, Protocol):
    """A `formation.transport.robot_bus.RobotBus`, or several as one."""

    @property
    def connected(self) -> bool:
        """Whether every router is linked."""

    def subscribe(self, topic: Topic, key: str, *, from_others: bool = False) -> None:
        """As `RobotBus.subscribe`."""

    def publish(self, key: str, payload: bytes) -> None:
        """As `RobotBus.publish`."""

    def routed(self, key: str) -> bool | None:
        """As `RobotBus.routed`."""

    def close(self) -> None:
        """As `RobotBus.close`."""


class Runtime(ABC):
    """What surrounds the main function of a process: its two sides, its mailbox, its clocks."""

    name: str
    """The process, such as ``agent robot2``."""
    mailbox: Mailbox
    """All messages to it."""
    stop: StopRequest
    """Whether to stop."""
    clock: Callable[[], Now]
    """Reads both clocks together."""
    dropped: Mapping[str, int] = {}
    """Number of messages that the core did not use, by key."""

    @property
    @abstractmethod
    def bus(self) -> FleetSide:
        """The fleet's bus. Raises BusError if this process is not on it."""

    @property
    @abstractmethod
    def robot(self) -> RobotSide:
        """The robot's side. Raises BusError if this process is not on it."""

    @abstractmethod
    def ready(self, *background_keys: str) -> None:
        """Report that all is declared; wait for subscribers of `background_keys` if that is requested."""

    @abstractmethod
    def tend(self, mono: float) -> None:
        """Do what a process does now and then beside its core, at `mono` [s]."""

    def let_threads_run(self) -> None:
        """Let other threads of this process run first, such as the one that writes to sockets."""
        os.sched_yield()

    def declare(self, core: Core, check: Callable[[Sample, float], Sample] | None = None) -> None:
        """Declare all that `core` publishes and subscribes to on the fleet's bus. Raises BusError.

        Received messages do not wake it: `core` steps when it is due. `check` is as in `Bus.subscribe`.
        """
        for topic, key in core.publications:
            self.bus.advertise(topic, key)
        for key in core.subscriptions:
            self.bus.subscribe(key, wakes=False, check=check)

    def loop(self, core: Steps, send: Callable[[Iterable[Outgoing]], None] | None = None) -> Pauses:
        """Step `core` on every arrival that wakes and whenever it is due, until told to stop.

        Its messages go to `send`, by default the fleet's bus. Its last messages are sent after a failure,
        too.
        """
        send = send or self.bus.send
        self.dropped = core.dropped
        try:
            while not self.stop:
                self.mailbox.serve()
                now = self.clock()
                send(core.step(now, self.mailbox.drain()))
                self.tend(now.mono)
                yield min(max(core.due - self.clock().mono, 0.0), PARENT_CHECK_PERIOD)
        finally:
            send(core.halt(self.clock(), self.stop.reason or "failed"))
        _log.info("stopped: %s", self.stop.reason)
