"""The monotonic clock of all processes: it continues while the machine is suspended, so ages stay right.

Python's `time.monotonic` stops meanwhile on Linux. Both agree as long as the machine has not been
suspended since this process started.
"""

from __future__ import annotations

import time

_BOOTTIME = getattr(time, "CLOCK_BOOTTIME", None)  # Linux alone has it


def _since_boot() -> float:
    return time.monotonic() if _BOOTTIME is None else time.clock_gettime(_BOOTTIME)


def _offset() -> float:
    """Return boot time less monotonic time [s], from the closest of ten pairs of readings."""
    pairs = []
    for _ in range(10):
        before, boot, after = time.monotonic(), _since_boot(), time.monotonic()
        pairs.append((after - before, boot - before))
    return min(pairs)[1]


_SUSPENDED = _offset()
"""Before this process started [s]."""


def suspended() -> int:
    """How long the machine was suspended before this process started [s]: `monotonic` leaves that out.

    So times of two processes can be compared only if this is the same for both.
    """
    return round(_SUSPENDED)


def monotonic() -> float:
    """Monotonic time, suspensions of the machine included [s]."""
    return _since_boot() - _SUSPENDED


def wall() -> float:
    """The system clock [s since the epoch]."""
    return time.time()
