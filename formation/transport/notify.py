"""What systemd wants to hear of a service: that it is ready, that its main loop turns, and that it stops.

The protocol of sd_notify(3): datagrams to the Unix socket that ``NOTIFY_SOCKET`` names. Without that variable
nothing is sent. Only the main loop may call `alive`, so that a loop that hangs starves systemd's watchdog.
"""

from __future__ import annotations

import logging
import socket
from collections.abc import Mapping

PERIOD = 0.2
"""The watchdog is fed at most so often [s]."""
_log = logging.getLogger(__name__)


class Notifier:
    """Tells systemd; nobody else who started this process is bothered."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        """`environment` is the process's."""
        self._address = environment.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        self._fed = float("-inf")  # [s, monotonic]
        self._complained = False
        if self._address:
            if self._address.startswith("@"):  # the way to write a name in the abstract namespace
                self._address = "\0" + self._address[1:]
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)  # a watchdog that does not listen holds up no robot

    def ready(self) -> None:
        """Everything is declared."""
        self._send("READY=1")

    def alive(self, now: float) -> None:
        """The main loop has come round, at `now` [s, monotonic]."""
        if self._socket is not None and now - self._fed >= PERIOD:
            self._fed = now
            self._send("WATCHDOG=1")

    def stopping(self, why: str) -> None:
        """The end has begun, because of `why`; nothing is sent after this."""
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
