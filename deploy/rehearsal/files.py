"""What rehearsed processes store, on a disk in memory that survives them."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

from formation.agent.persistence.state import Json


@dataclass
class Disk:
    """The disk of one machine."""

    files: dict[str, bytes] = field(default_factory=dict)
    is_full: bool = False


class AgentFiles:
    """The files of one agent, in place of `formation.agent.persistence.store.Store`."""

    def __init__(self, disk: Disk, robot: str) -> None:
        self.stops = Path(f"{robot}.stops.json")
        self.failure = ""
        """Why the newest write failed; empty if it did not."""
        self.is_open = True
        """Whether its process lives; nothing is written afterwards."""
        self._disk, self._state = disk, f"{robot}.state"

    def written(self, patience: float) -> bool:  # noqa: ARG002 - this disk is fast
        """Whether the newest stops are written."""
        return not self.failure

    def write_stops(self, stops: Json) -> None:
        """Write the stops."""
        self._write(self.stops.name, stops)

    def write_state(self, state: Json) -> None:
        """Write the saved state."""
        self._write(self._state, state)

    def read_stops(self) -> bytes | None:
        """Return the stored stops; None if there are none."""
        return self._disk.files.get(self.stops.name)

    def read_state(self) -> bytes | None:
        """Return the saved state; None if there is none."""
        return self._disk.files.get(self._state)

    def set_state_aside(self) -> Path | None:
        """Rename the saved state, so that no agent finds it."""
        state = self._disk.files.pop(self._state, None)
        return None if state is None else Path(f"{self._state}.failed")

    def _write(self, name: str, data: Json) -> None:
        if not self.is_open:
            return
        self.failure = "no space left on device" if self._disk.is_full else ""
        if not self.failure:
            self._disk.files[name] = json.dumps(data, allow_nan=False).encode()


class CandidateTerms:
    """The term file of one candidate: in place of `formation.leader.process.Terms`."""

    def __init__(self, disk: Disk, name: str) -> None:
        self.is_open = True
        """Whether its process lives; nothing is written afterwards."""
        self._disk, self._name = disk, f"{name}.term"

    def read(self) -> int:
        """Return the stored term; 0 if there is none."""
        return int(self._disk.files.get(self._name, b"0"))

    def save(self, term: int, mono: float) -> None:  # noqa: ARG002 - this disk is fast
        """Store `term`."""
        if self.is_open and not self._disk.is_full:
            self._disk.files[self._name] = b"%d" % term
