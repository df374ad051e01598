"""One heap for all threads of a process.

glibc gives each thread that allocates a heap of its own, and returns memory of none but the first. Memory
of Zenoh's threads for links that come and go then fragments their heaps: a process grows with every
outage, without leaking (docs/decisions/0033).
"""

from __future__ import annotations

import ctypes
import sys

_M_ARENA_MAX = -8
"""Of glibc's malloc.h."""


def share_one_heap() -> bool:
    """Use one heap for all threads from now on; whether the C library can. Call this before threads start."""
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has one heap anyway
    return mallopt is not None and mallopt(_M_ARENA_MAX, 1) == 1
