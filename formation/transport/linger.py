"""Have links to those who are gone closed without waiting for them.

Zenoh (1.10; eclipse-zenoh/zenoh#2350) sets SO_LINGER to 10 s on each of its TCP and TLS sockets. Closing one
whose peer was unplugged then blocks the thread that does it for 10 s, though the link was given up after its
lease of one, and that thread carries every other link of the process: one robot out of the radio's reach made
its neighbours' agents dumb and deaf. There is no setting for it, so the option is taken back from outside.
What was sent before a close is still delivered, by the kernel and in the background.
"""

from __future__ import annotations

import os
import socket
import stat
import struct
from contextlib import suppress

PERIOD = 0.25
"""Sockets are looked at so often [s]: several times within the lease, before which no link is given up."""
_OPEN = "/proc/self/fd"
_LINGER = struct.Struct("ii")
_OFF = _LINGER.pack(0, 0)


class Linger:
    """Takes the option back from sockets as they come; where there is no /proc, nothing is done."""

    def __init__(self) -> None:
        self._due = float("-inf") if os.path.isdir(_OPEN) else float("inf")  # noqa: PTH112 - no file of ours

    def tend(self, now: float) -> None:
        """To be called often, at `now` [s, monotonic]."""
        if now >= self._due:
            self._due = now + PERIOD
            take_back()


def take_back() -> int:
    """Take the option back from every stream socket of this process; how many had it."""
    return sum(_taken_back(int(name)) for name in os.listdir(_OPEN))  # noqa: PTH208 - numbers, not paths


def _taken_back(number: int) -> bool:
    with suppress(OSError):  # it may be closed at any moment
        if not stat.S_ISSOCK(os.fstat(number).st_mode):
            return False
        with socket.socket(fileno=os.dup(number)) as one:
            if one.family not in {socket.AF_INET, socket.AF_INET6} or one.type != socket.SOCK_STREAM:
                return False
            lingers, _ = _LINGER.unpack(one.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.size))
            if lingers:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
            return bool(lingers)
    return False
