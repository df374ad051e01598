"""One heap for all threads of a process.

glibc gives each thread that allocates a heap of its own, and gives memory back from none but the first. What
Zenoh's threads hold for links that come and go then tears their heaps apart: a process grows with every
outage, without leaking (docs/decisions/0033).
"""

from __future__ import annotations

import ctypes
import sys

_M_ARENA_MAX = -8
"""Of glibc's malloc.h."""


def share_one_heap() -> bool:
    """Give no thread a heap of its own from now on; whether the C library knows how. Before threads begin."""
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has one heap anyway
    return mallopt is not None and mallopt(_M_ARENA_MAX, 1) == 1
