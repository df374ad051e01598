"""The leader, or a standby, on the bus; and its newest term on disk: its next process draws a later one.

The file is best effort: a term that could not be written or read delays the robots by at most
`formation.protocol.election.TERM_EXPIRY_TIME`.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from formation.leader.core import Leader
from formation.topics import ORDER, STATUS
from formation.transport.runtime.loop import Pauses, Runtime
from formation.transport.security.verifying import Verifier
from formation.wire import Now, Outgoing, Sample

WRITE_PERIOD = 1.0
"""Shortest time between two writes of a term [s]."""
MAX_DIGITS = 19
"""Largest number of digits of a term in a file."""
SaveTerm = Callable[[int, float], None]
"""(newest known term, now [s, monotonic]); it does not delay a beat."""
_log = logging.getLogger(__name__)


class TermFile:
    """One candidate's term file."""

    def __init__(self, folder: Path, name: str) -> None:
        """Make the folder if it is missing. Raises OSError."""
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / f"{name}.term"
        self._saved = 0
        self._due = float("-inf")  # [s, monotonic]
        self._writing: threading.Thread | None = None

    def read(self) -> int:
        """Return the stored term; 0 if there is none or it cannot be read, which is logged."""
        try:
            with self._path.open("rb") as file:
                text = file.read(MAX_DIGITS + 2).strip()
        except FileNotFoundError:
            return 0
        except OSError as error:
            _log.warning("%s cannot be read, the last term is unknown: %s", self._path, error.strerror)
            return 0
        if not text.isdigit() or len(text) > MAX_DIGITS or int(text) >= 2**63:
            _log.warning("%s holds no term of up to %d digits: ignored", self._path, MAX_DIGITS)
            return 0
        self._saved = int(text)
        return self._saved

    def save(self, term: int, mono: float) -> None:
        """Write it in a separate thread, so that a hanging disk delays no beat; `mono` in s."""
        busy = self._writing is not None and self._writing.is_alive()
        if term == self._saved or busy or mono < self._due:
            return
        self._saved, self._due = term, mono + WRITE_PERIOD
        self._writing = threading.Thread(target=self._write, args=(term,), name="term", daemon=True)
        self._writing.start()

    def close(self, patience: float = 1.0) -> None:
        """Wait at most `patience` [s] until the newest term is written."""
        if self._writing is not None:
            self._writing.join(patience)

    def _write(self, term: int) -> None:
        try:
            fresh = self._path.with_suffix(".new")
            fresh.write_text(f"{term}\n", encoding="ascii")
            fresh.replace(self._path)
        except OSError as error:
            _log.warning("%s cannot be written: %s", self._path, error.strerror)


class _LoggedLeader:
    """The leader, logging what changes."""

    def __init__(self, leader: Leader, save: SaveTerm | None) -> None:
        self.began = False
        self._leader, self._save = leader, save
        self.dropped = leader.dropped

    @property
    def due(self) -> float:
        return self._leader.due

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        self.began = True
        outbox = self._leader.step(now, inbox)
        self._write()
        if self._save is not None:
            self._save(self._leader.known, now.mono)
        return outbox

    def halt(self, now: Now, reason: str) -> list[Outgoing]:
        outbox = self._leader.halt(now, reason)
        self._write()
        return outbox

    def _write(self) -> None:
        while self._leader.notes:
            _log.info("%s", self._leader.notes.popleft())


def lead(
    leader: Leader, process: Runtime, verifier: Verifier | None = None, save: SaveTerm | None = None
) -> Pauses:
    """Declare, wait for the monitor, then lead, or stand by, until told to stop.

    `verifier` checks relayed orders if there are certificates; `save` stores the newest term.
    """
    logged = _LoggedLeader(leader, save)

    def answer(request: bytes, received: float) -> bytes:
        if logged.began:  # after a suspension, find out first whether it still leads
            process.bus.send(logged.step(process.clock(), ()))
        return leader.request(request, received)

    process.declare(leader, None if verifier is None else verifier.check)
    process.bus.answer(ORDER.key(leader.name), answer)
    process.ready(STATUS.key(leader.name))
    yield from process.loop(logged)
