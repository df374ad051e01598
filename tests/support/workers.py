"""Workers of pytest-xdist: which this one is, and what it begins with."""

from __future__ import annotations

import os

WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
"""Number of this worker; 0 also in a run without workers."""
WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
"""How many workers there are."""


def cores() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def begins_with_processes(worker: int, workers: int) -> bool:
    """Whether a worker begins with tests of real processes: those beyond one a core, at least the last."""
    return worker >= workers - max(1, workers - cores())
