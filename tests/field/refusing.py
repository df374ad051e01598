"""A process on a secured bus that talks all the time: ``python -m tests.field.refusing FILE TEAM``."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

import psutil

from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig
from formation.transport.runtime.process import log_to_stderr, say

PERIOD = 0.005
"""How often it says something [s]."""


def main(file: str, team: str) -> None:
    """Say how often others were refused, over and over, until told to stop."""
    over: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: over.append(number))
    log_to_stderr("robot3", "info")
    process, longest = psutil.Process(), 0.0
    with Bus(BusConfig(config_file=Path(file), namespace=team)) as bus:
        bus.subscribe("robot2/position")
        say("ready")
        memory, number = process.memory_info().rss, 0
        while not over:
            before = time.monotonic()
            say("turn", number=number, refused=bus.refused)
            longest = max(longest, time.monotonic() - before)
            number += 1
            time.sleep(PERIOD)
        grown = process.memory_info().rss - memory
        say("end", number=number, refused=bus.refused, received=bus.received, grown=grown, longest=longest)


if __name__ == "__main__":
    main(*sys.argv[1:])
