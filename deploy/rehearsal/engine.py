"""The virtual clock: events in order of time, and processes that sleep on it.

Nothing here reads a real clock, and events of one moment happen in the order in which they were scheduled, so
the same calls give the same run.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from formation.deploy.rehearsal.sides import FleetPort, RobotPort
from formation.transport.bus_config import BusError
from formation.transport.mailbox import Mailbox
from formation.transport.runtime.loop import Pauses, Runtime
from formation.wire import Now

UPTIME = 1000.0
"""Monotonic time of every machine when the rehearsal begins [s]."""
EPOCH = 1.7e9
"""System clock of a machine without a clock fault at that moment [s]."""
WAKE_DELAY = 5e-5
"""Time from an arrival to the step that it causes [s]."""
MAX_WAITING_MESSAGES = 1024
"""As of a process on a machine."""
MIN_PAUSE = 1e-4
"""Shortest time between two steps of a process that nothing wakes [s]."""


@dataclass
class Machine:
    """A computer: its processes share its clocks."""

    name: str
    offset: float = 0.0
    """System clock less true time [s]."""
    drift: float = 0.0
    """Rate at which `offset` grows [s/s] …"""
    drift_since: float = 0.0
    """… from then on [s]."""


class Engine:
    """Events, and the time of the newest."""

    def __init__(self) -> None:
        self.now = 0.0
        """Since the beginning [s]."""
        self._events: list[tuple[float, int, Callable[[], object]]] = []
        self._numbers = itertools.count()

    def at(self, time: float, event: Callable[[], object]) -> None:
        """Call `event` at `time` [s], or now if that is over."""
        heapq.heappush(self._events, (max(time, self.now), next(self._numbers), event))

    def run(self, until: float) -> None:
        """Let all events up to `until` [s] happen."""
        while self._events and self._events[0][0] <= until:
            self.now, _, event = heapq.heappop(self._events)
            event()
        self.now = max(self.now, until)

    def clocks(self, machine: Machine) -> Now:
        """Both clocks of `machine`."""
        wrong = machine.offset + machine.drift * (self.now - machine.drift_since)
        return Now(UPTIME + self.now, EPOCH + self.now + wrong)


class Ending:
    """A request to stop; most rehearsed processes get none, and are killed."""

    reason = ""

    def __bool__(self) -> bool:
        return bool(self.reason)


class VirtualProcess(Runtime):
    """A process that sleeps on the virtual clock."""

    stop: Ending

    def __init__(
        self,
        engine: Engine,
        name: str,
        machine: Machine,
        capacity: int = MAX_WAITING_MESSAGES,
        *,
        wakes: bool = True,
        certified: str | None = None,
    ) -> None:
        """`capacity` bounds the messages that wait; without `wakes` none ends a pause early."""
        self.name, self.machine, self.stop = name, machine, Ending()
        self.certified = certified
        """The name in its certificate; None for a process that the field does not have."""
        self.alive = True
        self.failure: Exception | None = None
        """The exception that ended it."""
        self.lag = 0.0
        """Least time from one step to the next [s]; of a slow machine."""
        self._engine = engine
        self.clock = lambda: engine.clocks(machine)
        self.mailbox = Mailbox(capacity, clock=lambda: UPTIME + engine.now)
        self._wakes = wakes
        self._fleet: FleetPort | None = None
        self._side: RobotPort | None = None
        self._main: Pauses | None = None
        self._wake = 0  # number of the wake-up that counts
        self._due = float("inf")  # when that is [s]
        self._stepped = float("-inf")  # [s]
        self._frozen: list[Callable[[], None]] | None = None  # arrivals while frozen

    @property
    def runs(self) -> bool:
        """Whether it is alive and not suspended."""
        return self.alive and self._frozen is None

    def plug(self, fleet: FleetPort | None, side: RobotPort | None) -> None:
        """Connect it."""
        self._fleet, self._side = fleet, side

    @property
    def bus(self) -> FleetPort:
        """The fleet's bus. Raises BusError if this process is not on it."""
        if self._fleet is None:
            raise BusError(f"{self.name} is not on the fleet's bus")
        return self._fleet

    @property
    def robot(self) -> RobotPort:
        """The robot's side. Raises BusError if this process is not on it."""
        if self._side is None:
            raise BusError(f"{self.name} is not on a robot's bus")
        return self._side

    def ready(self, *background_keys: str) -> None:
        """Do nothing: no supervisor waits for it."""

    def tend(self, mono: float) -> None:
        """Do nothing: there is no systemd, and there are no sockets."""

    def let_threads_run(self) -> None:
        """Do nothing: there are no threads."""

    def play(self, main: Pauses) -> None:
        """Begin `main` now."""
        self._main = main
        self._resume_at(self._engine.now)

    def arrive(self, delivery: Callable[[], None], *, wakes: bool) -> None:
        """Take in a message: at once, or when it thaws."""
        if not self.alive:
            return
        if self._frozen is not None:
            self._frozen.append(delivery)
            return
        delivery()
        if wakes and self._wakes:
            self._resume_at(max(self._engine.now + WAKE_DELAY, self._stepped + self.lag))

    def kill(self) -> None:
        """End it as SIGKILL does: nothing is sent, nothing is saved."""
        self.alive = False
        main, self._main = self._main, None
        for port in (self._fleet, self._side):
            if port is not None:
                port.unplug()
        if main is not None:
            with suppress(Exception):  # a killed process runs nothing; closing the generator does
                main.close()

    def freeze(self) -> None:
        """Suspend it, as SIGSTOP does."""
        if self._frozen is None:
            self._frozen = []

    def thaw(self) -> None:
        """Continue it: what has waited arrives now."""
        waiting, self._frozen = self._frozen or [], None
        for delivery in waiting:
            delivery()
        self._resume_at(self._engine.now)

    def _resume_at(self, time: float) -> None:
        if time >= self._due:
            return
        self._wake, self._due = self._wake + 1, time
        number = self._wake
        self._engine.at(time, lambda: self._resume(number))

    def _resume(self, number: int) -> None:
        if number != self._wake or not self.alive:
            return
        self._due = float("inf")
        if self._frozen is not None or self._main is None:
            return
        self._stepped = self._engine.now
        try:
            pause = next(self._main)
        except StopIteration:
            self.alive = False
        except Exception as error:  # noqa: BLE001 - the judge reports it
            self.failure = error
            self.kill()
        else:
            self._resume_at(self._engine.now + max(pause, MIN_PAUSE, self.lag))
