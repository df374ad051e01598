"""The newest term that a candidate knows, on disk: its next process draws a later one.

Best effort: a term that could not be written, or read, costs the robots at most `formation.election.EXPIRY`.
"""

from __future__ import annotations

import logging
import threading
from pathlib import Path

PERIOD = 1.0
"""A term is written at most so often [s]."""
MAX_DIGITS = 19
"""Of a term, in a file."""
_log = logging.getLogger(__name__)


class Terms:
    """One candidate's file."""

    def __init__(self, folder: Path, name: str) -> None:
        """The folder is made if there is none. Raises OSError."""
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / f"{name}.term"
        self._kept = 0
        self._due = float("-inf")  # [s, monotonic]
        self._writing: threading.Thread | None = None

    def read(self) -> int:
        """The term that was kept; 0 for none, or one that cannot be read, which is logged."""
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
        self._kept = int(text)
        return self._kept

    def keep(self, term: int, mono: float) -> None:
        """Have it written, by a thread of its own: a disk that hangs holds up no beat. `mono` in s."""
        busy = self._writing is not None and self._writing.is_alive()
        if term == self._kept or busy or mono < self._due:
            return
        self._kept, self._due = term, mono + PERIOD
        self._writing = threading.Thread(target=self._write, args=(term,), name="term", daemon=True)
        self._writing.start()

    def close(self, patience: float = 1.0) -> None:
        """Wait for the newest to be written, for at most so long [s]."""
        if self._writing is not None:
            self._writing.join(patience)

    def _write(self, term: int) -> None:
        try:
            fresh = self._path.with_suffix(".new")
            fresh.write_text(f"{term}\n", encoding="ascii")
            fresh.replace(self._path)
        except OSError as error:
            _log.warning("%s cannot be written: %s", self._path, error.strerror)
