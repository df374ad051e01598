"""Single keys from a terminal, as they are pressed."""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from types import TracebackType
from typing import Any, Self, TextIO

NAMED = {
    b"\x1b[C": "right", b"\x1bOC": "right", b"\x1b[D": "left", b"\x1bOD": "left", b"\x1b": "escape",
    b" ": "space",
}  # fmt: skip
"""Byte sequences of terminals for keys without a character."""
MAX_KEY_BYTES = 64
"""Number of bytes read at once: far more than is typed between two looks."""


class Keys:
    """Read keys from `stream` without echo; nothing if it is no terminal.

    A context manager: outside it the terminal is as it was.
    """

    def __init__(self, stream: TextIO = sys.stdin) -> None:
        self._number = stream.fileno() if stream.isatty() else None
        self._before: list[Any] | None = None

    def __enter__(self) -> Self:
        if self._number is not None:
            self._before = termios.tcgetattr(self._number)
            tty.setcbreak(self._number, termios.TCSANOW)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._number is not None and self._before is not None:
            termios.tcsetattr(self._number, termios.TCSANOW, self._before)

    def wait(self, seconds: float) -> list[str]:
        """Return the keys pressed within that time [s], as soon as there are any."""
        if self._number is None:
            time.sleep(seconds)
            return []
        ready, _, _ = select.select([self._number], [], [], seconds)
        if not ready:
            return []
        data = os.read(self._number, MAX_KEY_BYTES)
        if not data:  # the terminal has gone
            self._number = None
        return named(data)


def named(data: bytes) -> list[str]:
    """Return keys by name, or by character, from a terminal's bytes."""
    keys = []
    while data:
        length = next((n for n in (3, 1) if data[:n] in NAMED), 1)
        keys.append(NAMED.get(data[:length], data[:length].decode("latin-1")))
        data = data[length:]
    return keys
