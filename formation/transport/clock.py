"""The monotonic clock of all processes: it goes on while the machine is suspended, so that old is old.

Python's `time.monotonic` stops meanwhile on Linux. Both agree as long as the machine has not been suspended
since this process started.
"""

from __future__ import annotations

import time

_BOOTTIME = getattr(time, "CLOCK_BOOTTIME", None)  # Linux alone has it


def _since_boot() -> float:
    return time.monotonic() if _BOOTTIME is None else time.clock_gettime(_BOOTTIME)


_SUSPENDED = _since_boot() - time.monotonic()
"""Before this process started [s]."""


def monotonic() -> float:
    """Monotonic time, suspensions of the machine included [s]."""
    return _since_boot() - _SUSPENDED


def wall() -> float:
    """The system clock [s since the epoch]."""
    return time.time()
