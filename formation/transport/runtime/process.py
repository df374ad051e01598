"""Common parts of all main functions: signals, the loop, exit codes, and the output on stdout.

A process is ``update → step → publish → wait`` around a pure core (`Runtime.loop`), on the fleet's bus, on
a robot's, or on both. For programs it reports on stdout, one JSON object a line, that it is ready and, at
its end, what it published and received; for people it logs to stderr. Exit codes: 0 success, 1 failed, 2
bad input, 128 + signal if forced.
"""

from __future__ import annotations

import argparse
import gc
import json
import logging
import math
import os
import shlex
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing, suppress
from types import FrameType
from typing import Any, Self

from formation.mission.file import MissionError
from formation.mission.model import Mission
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.linger import Linger
from formation.transport.mailbox import Mailbox
from formation.transport.runtime.clock import monotonic
from formation.transport.runtime.loop import Pauses, RobotSide, Runtime
from formation.wire import Now

WELL, FAILED, BAD_INPUT = 0, 1, 2
GRACE_TIME = 1.0
"""Time after the first signal from which another one forces the exit [s]. An earlier one is a repetition:
a terminal's Ctrl-C reaches the whole process group, and the supervisor passes it on."""
LAST_STAMP = 2.0**31 - 2.0
"""In 2038 [s since the epoch]."""
MIN_REPORT_PERIOD = 0.2
"""Shortest time between two reports to the watchdog [s]."""
_log = logging.getLogger(__name__)


class BadInput(ValueError):  # noqa: N818 - it is the input that is bad
    """The user's input is invalid; the text names it and the legal values."""


class Stop:
    """Turns SIGINT, SIGTERM and SIGHUP, and the parent's death, into a request to stop.

    The first signal ends the process in order, one later than `GRACE_TIME` after it at once. A process that
    was started to ignore SIGHUP (nohup) continues to ignore it.
    """

    def __init__(self, parent: int | None = None) -> None:
        self.reason = ""
        """Why to stop; empty if there is no reason."""
        self._parent = parent
        self._since = math.inf  # when the first signal came [s, monotonic]
        self._wake: Callable[[], None] | None = None
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def __bool__(self) -> bool:
        """Whether to stop."""
        if not self.reason and self._parent is not None and os.getppid() != self._parent:
            self.reason = f"the parent process {self._parent} is gone"
        return bool(self.reason)

    def wakes(self, wake: Callable[[], None]) -> None:
        """Call `wake` on a signal, so that it interrupts a sleep."""
        self._wake = wake

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if now - self._since > GRACE_TIME:
            os._exit(128 + number)
        self._since = min(self._since, now)
        self.reason = self.reason or signal.Signals(number).name
        if self._wake is not None:
            self._wake()


class Notifier:
    """Reports of a service to systemd: that it is ready, that its main loop runs, and that it stops.

    The protocol of sd_notify(3): datagrams to the Unix socket that ``NOTIFY_SOCKET`` names; without that
    variable nothing is sent. Only the main loop may call `alive`, so that systemd's watchdog detects a loop
    that hangs.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        """`environment` is that of the process."""
        self._address = environment.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        self._fed = float("-inf")  # [s, monotonic]
        self._complained = False
        if self._address:
            if self._address.startswith("@"):  # notation of a name in the abstract namespace
                self._address = "\0" + self._address[1:]
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)  # a watchdog that does not read must not block a robot

    def ready(self) -> None:
        """Report that everything is declared."""
        self._send("READY=1")

    def alive(self, now: float) -> None:
        """Report that the main loop runs, at `now` [s, monotonic]."""
        if self._socket is not None and now - self._fed >= MIN_REPORT_PERIOD:
            self._fed = now
            self._send("WATCHDOG=1")

    def stopping(self, why: str) -> None:
        """Report that the process stops, because of `why`; nothing is sent after this."""
        self._send(f"STOPPING=1\nSTATUS=stopping: {' '.join(why.split())}")
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, state: str) -> None:
        if self._socket is None:
            return
        try:
            self._socket.sendto(state.encode(), self._address)
        except OSError as error:
            if not self._complained:
                _log.warning("systemd was not told %s: %s", state.partition("\n")[0], error)
            self._complained = True


class Process(Runtime):
    """A process on its buses. As a context manager it opens them, and always closes them."""

    def __init__(
        self,
        name: str,
        args: argparse.Namespace,
        config: BusConfig | None,
        stop: Stop,
        robot: Callable[[Mailbox], RobotSide] | None = None,
    ) -> None:
        """`name` is the name of the process on stdout, such as ``agent robot2``. Raises BusError.

        `config` is that of the fleet's bus, None for no fleet; `robot` opens its robot's side.
        """
        self.name = name
        self.stop: Stop = stop
        self.mailbox = Mailbox()
        self.clock = clocks
        self._await_monitor: float = args.await_monitor
        self._bus = None if config is None else Bus(config, self.mailbox)
        try:
            self._robot = None if robot is None else robot(self.mailbox)
        except BusError:
            if self._bus is not None:
                self._bus.close()
            raise
        self._notifier = Notifier(os.environ)
        self._linger = Linger()
        stop.wakes(self.mailbox.wake)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._notifier.stopping(self.stop.reason or "failed")
        fleet, side = self._bus, self._robot
        for bus in (side, fleet):  # the last messages to the robot are sent first
            if bus is not None:
                bus.close()
        say(
            "summary",
            process=self.name,
            published=dict(fleet.published) if fleet else {},
            received=dict(fleet.received) if fleet else {},
            dropped={**self.dropped, "overflowed": self.mailbox.overflowed},
            robot={
                "published": dict(side.published) if side else {},
                "received": dict(side.received) if side else {},
            },
            refused=dict(fleet.refused) if fleet else {},
        )

    @property
    def bus(self) -> Bus:
        """The fleet's bus. Raises BusError if this process is not on it."""
        if self._bus is None:
            raise BusError(f"{self.name} is not on the fleet's bus")
        return self._bus

    @property
    def robot(self) -> RobotSide:
        """The robot's side. Raises BusError if this process is not on it."""
        if self._robot is None:
            raise BusError(f"{self.name} is not on a robot's bus")
        return self._robot

    def ready(self, *background_keys: str) -> None:
        """Report that all is declared; then, if requested, wait for subscribers of `background_keys`.

        The monitor subscribes to background topics last, so once it has subscribed to these it receives
        all.
        """
        say("ready", process=self.name)
        self._notifier.ready()
        gc.freeze()  # present objects stay, and need not be searched for garbage again and again
        deadline = time.monotonic() + self._await_monitor
        while not (self.stop or all(map(self._watched, background_keys))):
            now = time.monotonic()
            if now >= deadline:
                if self._await_monitor > 0.0:
                    _log.warning("no monitor after %g s; starting without", self._await_monitor)
                return
            self.tend(now)
            self.mailbox.serve()
            time.sleep(min(0.01, deadline - now))

    def tend(self, mono: float) -> None:
        """Report to systemd that the loop runs, and keep the bus's own sockets short."""
        self._notifier.alive(mono)
        self._linger.tend(mono)

    def play(self, pauses: Pauses) -> None:
        """Play a main function, sleeping through its pauses, until it ends."""
        with closing(pauses):
            for pause in pauses:
                self.mailbox.wait(pause)

    def _watched(self, key: str) -> bool:
        if self._bus is not None and key in self._bus.advertised:
            return self._bus.watched(key)
        return bool(self.robot.routed(key))


def clocks() -> Now:
    """Both clocks, read together; the system's limited to the range of a ROS 2 stamp."""
    return Now(monotonic(), min(max(time.time(), 0.0), LAST_STAMP))


def run_process(name: str, args: argparse.Namespace, main: Callable[[Stop], bool | None]) -> int:
    """Call ``main(stop)``; return the exit code. `name` is its name in the log, such as ``robot2``.

    `main` returns False if it failed and has logged why. Bad input is one line on stderr, any other failure
    is logged with its traceback.
    """
    log_to_stderr(name, args.log_level)
    try:
        with Stop(args.parent) as stop:
            well = main(stop) is not False
    except (MissionError, BusError, BadInput) as error:
        print(f"{name}: {error}", file=sys.stderr)
        return BAD_INPUT
    except Exception:  # noqa: BLE001 - the outermost frame: a failure becomes a log entry and an exit code
        _log.exception("failed")
        return FAILED
    return WELL if well else FAILED


def one_of(flag: str, value: str, legal: Iterable[str]) -> str:
    """`value`, if it is legal. Raises BadInput."""
    legal = tuple(legal)
    if value not in legal:
        raise BadInput(f"{flag} {value!r}: must be one of {', '.join(legal)}")
    return value


def follower_of(mission: Mission, robot: str, source: str) -> str:
    """`robot` of --robot, if it is a follower of the mission read from `source`. Raises BadInput."""
    if robot in mission.followers:
        return robot
    leads = f"formation leader {shlex.quote(source)}"
    words = f"--robot {robot!r}: must be a follower of {mission.name}: {', '.join(mission.followers)}"
    if robot == mission.leader:
        words += f"; {robot} leads: {leads}"
    elif robot in mission.standbys:
        words += f"; {robot} is a standby: {leads} --standby {robot}"
    raise BadInput(words)


def say(event: str, **fields: Any) -> None:
    """Write one line of JSON to stdout. Ignore a reader that has gone away."""
    try:
        print(json.dumps({"event": event, **fields}), flush=True)
    except BrokenPipeError:
        # the interpreter's last flush needs a valid file
        with suppress(OSError), open(os.devnull, "wb") as nowhere:  # noqa: PTH123 - a device, not a path
            os.dup2(nowhere.fileno(), sys.stdout.fileno())


def log_to_stderr(name: str, level: str) -> None:
    """Log as ``12:34:56 robot2: message``."""
    logging.basicConfig(
        stream=sys.stderr, level=level.upper(), format=f"%(asctime)s {name}: %(message)s", datefmt="%H:%M:%S"
    )
