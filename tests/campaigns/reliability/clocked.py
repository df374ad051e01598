"""A process of the project on a computer whose system clock can be set: ``clocked FILE MODULE ARGUMENTS``.

A network namespace shares the machine's clock, which must not be stepped. So here the process alone is told
another time: later by as many seconds as FILE says, 0 if there is none. It is looked at on every call.
"""

from __future__ import annotations

import runpy
import sys
import time
from pathlib import Path

_time, _time_ns = time.time, time.time_ns


class Clock:
    """The system's clock, and how far it is off."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._until, self._off = 0.0, 0.0

    def off(self) -> float:
        """By how much [s]; read anew each millisecond at most."""
        now = time.monotonic()
        if now >= self._until:
            self._until = now + 0.001
            try:
                self._off = float(self._file.read_text(encoding="ascii") or 0.0)
            except FileNotFoundError:
                self._off = 0.0
        return self._off

    def time(self) -> float:
        """As `time.time`."""
        return _time() + self.off()

    def time_ns(self) -> int:
        """As `time.time_ns`."""
        return _time_ns() + round(self.off() * 1e9)


if __name__ == "__main__":
    clock = Clock(Path(sys.argv[1]))
    time.time, time.time_ns = clock.time, clock.time_ns
    module, sys.argv = sys.argv[2], sys.argv[2:]
    runpy.run_module(module, run_name="__main__", alter_sys=True)
