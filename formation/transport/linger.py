"""Close links to dead peers without waiting for them.

Zenoh (1.10; eclipse-zenoh/zenoh#2350) sets SO_LINGER to 10 s on each of its TCP and TLS sockets. Closing
the socket of an unplugged peer then blocks its thread for 10 s, though the link was given up after its
lease of one, and that thread serves every other link of the process: one robot out of radio range blocked
the agents of its neighbours. There is no setting for it, so the option is reset from outside. Data sent
before a close are still delivered, by the kernel and in the background.
"""

from __future__ import annotations

import os
import socket
import stat
import struct
from contextlib import suppress

CHECK_PERIOD = 0.25
"""Period of checking the sockets [s]: several times within the lease, before which no link is given up."""
_OPEN = "/proc/self/fd"
_LINGER = struct.Struct("ii")
_OFF = _LINGER.pack(0, 0)


class Linger:
    """Resets the option on new sockets; without /proc, it does nothing."""

    def __init__(self) -> None:
        self._due = float("-inf") if os.path.isdir(_OPEN) else float("inf")  # noqa: PTH112 - no file of ours

    def tend(self, now: float) -> None:
        """Reset the option when due; call this often, at `now` [s, monotonic]."""
        if now >= self._due:
            self._due = now + CHECK_PERIOD
            take_back()


def take_back() -> int:
    """Reset the option on every stream socket of this process; return how many had it."""
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
