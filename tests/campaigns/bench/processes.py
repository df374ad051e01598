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
from types import TracebackType
from typing import IO, Any, NamedTuple, Self

import psutil

LISTING = ("ss", "-tniOHp", "state", "established")
"""What lists TCP connections, who has them, and what went over them, each in one line."""


class Link(NamedTuple):
    """One end of a TCP connection, since it was made."""

    sent: int
    """[bytes]"""
    received: int
    """[bytes]"""
    segments_out: int
    """Segments with data: what is sent at once, as an express message is, is one."""
    segments_in: int


class Account(NamedTuple):
    """One process at one moment."""

    moment: float
    """[s, monotonic]"""
    busy: float
    """What its threads have computed [s]."""
    links: tuple[Link, ...]


_OWNER = re.compile(r"pid=(\d+)")
_COUNTS = ("bytes_sent", "bytes_received", "data_segs_out", "data_segs_in")
_COUNT = re.compile(rf"\b({'|'.join(_COUNTS)}):(\d+)")


def links(listing: str) -> dict[int, tuple[Link, ...]]:
    """Connections by process id, from what `LISTING` printed."""
    found: dict[int, list[Link]] = {}
    for line in listing.splitlines():
        counts = {name: int(count) for name, count in _COUNT.findall(line)}
        link = Link(*(counts.get(name, 0) for name in _COUNTS))  # ss leaves out what is zero
        for pid in set(_OWNER.findall(line)):
            found.setdefault(int(pid), []).append(link)
    return {pid: tuple(each) for pid, each in found.items()}


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
        was, now = (
            sum(float(getattr(link, field)) for link in account.links for field in fields)
            for account in (before, after)
        )
        return (now - was) / elapsed

    return {
        "cpu_percent": 100.0 * (after.busy - before.busy) / elapsed,
        "kilobytes_per_s": more("sent", "received") / 1e3,
        "packets_per_s": more("segments_out", "segments_in"),
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
    """Call this before the first subject is started, and as often as you like."""
    compile_modules(ROOT / name for name in PACKAGES)


def compile_modules(folders: Iterable[Path]) -> None:
    """Compile whatever has changed in these; also where Python is told to keep nothing that it compiles."""
    for folder in folders:
        compile_dir(folder, quiet=1)


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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
