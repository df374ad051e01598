"""What processes have used so far, as the kernel counts it: processor, memory, threads, links and traffic."""

from __future__ import annotations

import re
import subprocess
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

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
