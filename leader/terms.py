"""The newest term that a candidate knows, on disk: its next process draws a later one.

Best effort: a term that could not be written or read delays the robots by at most
`formation.protocol.election.TERM_EXPIRY_TIME`.
"""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import Protocol

WRITE_PERIOD = 1.0
"""Shortest time between two writes of a term [s]."""
MAX_DIGITS = 19
"""Largest number of digits of a term in a file."""
_log = logging.getLogger(__name__)


class TermFile(Protocol):
    """Where a running candidate stores the newest term that it knows."""

    def save(self, term: int, mono: float) -> None:
        """Store `term`, known at `mono` [s], without delaying a beat."""


class Terms:
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
            _log.warning("%s cannot be read, so no term is known: %s", self._path, error.strerror)
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
