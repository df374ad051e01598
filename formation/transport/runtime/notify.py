"""Reports of a service to systemd: that it is ready, that its main loop runs, and that it stops.

The protocol of sd_notify(3): datagrams to the Unix socket that ``NOTIFY_SOCKET`` names. Without that
variable nothing is sent. Only the main loop may call `alive`, so that systemd's watchdog detects a loop
that hangs.
"""

from __future__ import annotations

import logging
import socket
from collections.abc import Mapping

MIN_REPORT_PERIOD = 0.2
"""Shortest time between two reports to the watchdog [s]."""
_log = logging.getLogger(__name__)


class Notifier:
    """Reports to systemd, and does nothing without it."""

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
