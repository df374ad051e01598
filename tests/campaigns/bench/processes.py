"""Processes that are measured: how they are started, and what they have used, as the kernel counts it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections.abc import Iterable
from compileall import compile_dir
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, Any, NamedTuple, Self

import psutil

LISTING = ("ss", "-tniOHp", "state", "established")
"""What lists TCP connections, their processes, and what went over them, each in one line."""


class Link(NamedTuple):
    """One end of a TCP connection, since it was made: bytes, and segments with data.

    What is sent at once, as an express message is, is one segment.
    """

    bytes_sent: int
    bytes_received: int
    data_segs_out: int
    data_segs_in: int


class Account(NamedTuple):
    """One process at one moment."""

    moment: float
    """[s, monotonic]"""
    busy: float
    """What its threads have computed [s]."""
    links: tuple[Link, ...]


_OWNER = re.compile(r"pid=(\d+)")
_COUNT = re.compile(rf"\b({'|'.join(Link._fields)}):(\d+)")


def links(listing: str) -> dict[int, tuple[Link, ...]]:
    """Connections by process id, from what `LISTING` printed."""
    found: dict[int, tuple[Link, ...]] = {}
    for line in listing.splitlines():
        counts = {name: int(count) for name, count in _COUNT.findall(line)}
        link = Link(*(counts.get(name, 0) for name in Link._fields))  # ss leaves out what is zero
        for pid in set(_OWNER.findall(line)):
            found[int(pid)] = (*found.get(int(pid), ()), link)
    return found


def accounts(pids: Iterable[int]) -> dict[int, Account]:
    """The accounts of living processes of ours, by process id."""
    by_process = links(subprocess.run(LISTING, check=True, stdout=subprocess.PIPE, text=True).stdout)
    return {pid: Account(time.monotonic(), busy(pid), by_process.get(pid, ())) for pid in pids}


def busy(pid: int) -> float:
    """What a process has computed so far, to the nanosecond rather than in ticks of the clock [s]."""
    spent = 0
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # a thread may end meanwhile
            spent += int((thread / "schedstat").read_text().split()[0])
    return spent * 1e-9


def used(before: Account, after: Account) -> dict[str, float]:
    """What a process took between two moments, traffic in both directions together."""
    elapsed = after.moment - before.moment

    def more(*fields: str) -> float:
        was, now = (sum(getattr(link, one) for link in of.links for one in fields) for of in (before, after))
        return float(now - was) / elapsed

    return {
        "cpu_percent": 100.0 * (after.busy - before.busy) / elapsed,
        "kilobytes_per_s": more("bytes_sent", "bytes_received") / 1e3,
        "packets_per_s": more("data_segs_out", "data_segs_in"),
        "links": float(len(after.links)),
    }


def memory(process: psutil.Process) -> dict[str, float]:
    """Memory that it occupies [MiB]; of what it shares, PSS counts its share. And its threads."""
    occupied = process.memory_full_info()
    return {
        "rss_mib": occupied.rss / 2**20,
        "pss_mib": occupied.pss / 2**20,
        "threads": float(process.num_threads()),
    }


ROOT = Path(__file__).parents[3]
PACKAGES = ("formation", "agent", "leader", "monitor", "deploy", "tests")


@cache
def ready_to_start() -> None:
    """Compile whatever has changed, also where Python is told to keep nothing that it compiles.

    Call this before the first subject is started, and as often as you like.
    """
    for name in PACKAGES:
        compile_dir(ROOT / name, quiet=1)


class Running:
    """``python -m …``, a child that says JSON lines, and is gone at the end."""

    def __init__(self, *argv: str, log: IO[str] | None = None, stdin: int = subprocess.DEVNULL) -> None:
        """What it writes to stderr goes to `log`, a file with a name, if there is one."""
        ready_to_start()
        command = [sys.executable, "-m", *argv]
        self.process = psutil.Popen(command, stdin=stdin, stdout=subprocess.PIPE, stderr=log, text=True)
        self._log = log

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()

    def wait_for(self, event: str) -> dict[str, Any]:
        """The next event, which must be this one."""
        out: IO[str] = self.process.stdout
        line = json.loads(out.readline() or '{"event": "nothing"}')
        if line["event"] != event:
            wrote = f"; all wrote: {Path(self._log.name).read_text()[-2000:]}" if self._log else ""
            raise RuntimeError(f"waited for {event!r}, was told {line['event']!r}{wrote}")
        return dict(line)
