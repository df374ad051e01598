"""Threads share one heap."""

from __future__ import annotations

import ctypes
import subprocess
import sys

import pytest

COUNTED = """
import ctypes, threading
from formation.transport.bus import share_one_heap
if {shared}:
    assert share_one_heap()
kept = []
threads = [threading.Thread(target=lambda: kept.append([bytes(2000) for _ in range(100)])) for _ in range(4)]
for one in threads:
    one.start()
for one in threads:
    one.join()
libc = ctypes.CDLL(None)
libc.fopen.restype = ctypes.c_void_p
file = ctypes.c_void_p(libc.fopen(b"/dev/stdout", b"w"))
libc.malloc_info(0, file)
libc.fclose(file)
"""


def heaps(*, shared: bool) -> int:
    """Return the number of heaps of a process with threads that allocate."""
    done = subprocess.run(
        (sys.executable, "-c", COUNTED.format(shared=shared)), capture_output=True, text=True, check=True
    )
    return done.stdout.count("<heap nr=")


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_info"), reason="not glibc")
def test_bus_threads_share_one_heap() -> None:
    assert heaps(shared=True) == 1
    assert heaps(shared=False) > 1  # or this test could not fail
