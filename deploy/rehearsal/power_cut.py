"""What a power cut leaves of a file that an agent is writing: found by the agent's own writer."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path, PosixPath

from formation.agent.persistence.store import Store

PATIENCE_SECONDS = 30.0
"""Longest time that the writer may take; a healthy disk needs a thousandth of it."""


class FailingPath(PosixPath):
    """A path at which each text is cut off in the middle."""

    def write_text(self, data: str, *args: object, **options: object) -> int:  # noqa: ARG002
        """Write half of `data`. Raises OSError then."""
        super().write_text(data[: len(data) // 2], encoding="utf-8")
        raise OSError("the power was cut")


def cut_stops(robot: str, before: bytes) -> bytes:
    """Return what remains of an agent's file of stops if a write of the same stops is cut off."""
    with tempfile.TemporaryDirectory(prefix="power-cut-") as folder:
        store = Store(FailingPath(folder), robot)
        try:
            Path(store.stops).write_bytes(before)
            store.write_stops(json.loads(before))
            store.written(PATIENCE_SECONDS)
            return store.read_stops() or b""
        finally:
            store.close()
