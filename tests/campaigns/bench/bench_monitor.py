"""What one monitor bears: a hundred robots whose every message is recorded, while the page is open.

python -m tests.campaigns.bench.bench_monitor [--rounds N] [--quick] [--json]

A real `formation monitor` hears the robots' agents over real Zenoh, each on a link of its own, and records
them; a client reads the page's stream all the while. First at 20 Hz, for a minute. Then the rate rises, from
run to run, until messages are lost or the robots themselves cannot speak as fast any more.
"""

from __future__ import annotations

import http.client
import json
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any
from urllib.parse import urlsplit

from tests.campaigns.bench.crowd import mission, names
from tests.campaigns.bench.processes import Running
from tests.campaigns.figures import command, filled, markdown, over_rounds, verdict
from tests.support.child import free_endpoint

ROBOTS, RATE, TOPICS = 100, 20.0, 3
STEPS = (30.0, 40.0, 50.0, 60.0, 80.0, 100.0)
"""Rates that are tried next [Hz]."""
SPEAKERS, LINKS = 2, 50
"""Processes, and links of each: as many as there are robots."""
SHARE = 0.97
"""A crowd that says less of what it should cannot be measured by."""
PAGE = 5.0
"""Updates a second that a page must get."""
PATIENCE = 60.0
"""[s]"""


class Process(Running):
    """A child that is told what to do on stdin."""

    def __init__(self, *argv: str) -> None:
        super().__init__(*argv, stdin=subprocess.PIPE)

    def tell(self, line: str) -> None:
        into: IO[str] = self.process.stdin
        into.write(line + "\n")
        into.flush()

    @property
    def memory(self) -> float:
        """What it occupies [MiB]."""
        return float(self.process.memory_info().rss / 2**20)

    @property
    def busy(self) -> float:
        """What it has computed so far [s]."""
        times = self.process.cpu_times()
        return float(times.user + times.system)


@dataclass
class Look:
    """A viewer of the page: counts what its stream brings."""

    address: str
    frames: list[float] = field(default_factory=list)
    """When each came [s, monotonic]."""
    ended: bool = False

    def watch(self) -> None:
        """Read until told to end, or hung up on."""
        where = urlsplit(self.address)
        connection = http.client.HTTPConnection(str(where.hostname), where.port, timeout=PATIENCE)
        with closing(connection):
            connection.request("GET", "/stream")
            with connection.getresponse() as stream:
                while not self.ended and (line := stream.readline()):
                    if line.startswith(b"event: frame"):
                        self.frames.append(time.monotonic())

    def rates(self, start: float, end: float) -> list[int]:
        """Updates in each whole second of an interval [s, monotonic]."""
        seconds = [int(at - start) for at in self.frames if start <= at < end]
        return [seconds.count(second) for second in range(int(end - start))]


def plans(rate: float, links: int, *, waits: bool) -> list[dict[str, Any]]:
    """Robots by link: every link has as many as the others."""
    everybody = list(enumerate(names(ROBOTS)))
    linked = [everybody[i :: SPEAKERS * links] for i in range(SPEAKERS * links)]
    return [
        {
            "rate": rate,
            "phase": i / SPEAKERS,
            "waits": waits,
            "robots": {free_endpoint(): link for link in linked[i::SPEAKERS]},
        }
        for i in range(SPEAKERS)
    ]


def one_run(
    rate: float, seconds: float, folder: Path, links: int = LINKS, *, waits: bool = False
) -> dict[str, float]:
    """A monitor from its start to its end, and what became of every message.

    Robots that `waits` makes wait lose nothing themselves, however late they are.
    """
    file, recording = folder / "crowd.toml", folder / f"{time.monotonic_ns()}.mcap"
    file.write_text(mission(ROBOTS, rate))
    speakers = plans(rate, links, waits=waits)
    dial = [word for plan in speakers for end in plan["robots"] for word in ("-e", end)]
    flags = ["--no-stage", "--page", "127.0.0.1:0", "--record", str(recording), "--log-level", "error"]
    with ExitStack() as stack:
        crowd = [
            stack.enter_context(Process("tests.campaigns.bench.crowd", json.dumps(plan))) for plan in speakers
        ]
        monitor = stack.enter_context(Process("formation.monitor", str(file), *dial, *flags))
        look = Look(monitor.wait_for("ready")["page"])
        looking = threading.Thread(target=look.watch, daemon=True)
        looking.start()
        for one in crowd:
            one.wait_for("ready")
        figures = watched(crowd, monitor, look, seconds)
        monitor.process.send_signal(signal.SIGTERM)
        summary = monitor.wait_for("summary")
        look.ended = True
        looking.join(PATIENCE)
    published = {key: n for spoken in figures.pop("spoken") for key, n in spoken["published"].items()}
    parts = list(folder.glob(f"{recording.stem}*"))
    size = sum(path.stat().st_size for path in parts)
    for path in parts:
        path.unlink()
    sent = sum(published.values())
    return {
        "rate_hz": rate,
        "wanted_per_s": ROBOTS * rate * TOPICS,
        **figures,
        "sent": float(sent),
        "sent_per_s": sent / seconds,
        "received": float(sum(summary["received"].values())),
        "lost": float(sum(max(0, n - summary["recorded"].get(key, 0)) for key, n in published.items())),
        "overflowed": float(summary["dropped"]["overflowed"]),
        "rejected": float(sum(summary["rejected"].values())),
        "recording_mib": size / 2**20,
    }


def watched(crowd: Sequence[Process], monitor: Process, look: Look, seconds: float) -> dict[str, Any]:
    """Have the crowd speak; what the monitor takes meanwhile, and what the page gets."""
    before, start, memory = monitor.busy, time.monotonic(), [monitor.memory]
    others = sum(one.busy for one in crowd)
    for one in crowd:
        one.tell(str(seconds))
    while (now := time.monotonic()) < start + seconds:
        time.sleep(min(0.5, start + seconds - now))
        memory.append(monitor.memory)
    end, busy = time.monotonic(), monitor.busy - before
    spoken = [one.wait_for("spoken") for one in crowd]
    others = sum(one.busy for one in crowd) - others
    rates = look.rates(start + 1.0, end)  # whoever has just opened the page begins with the second second
    return {
        "spoken": spoken,
        "cpu_percent": 100.0 * busy / (end - start),
        "crowd_cpu_percent": 100.0 * others / (end - start),
        "rss_mib": memory[0],
        "rss_after_mib": memory[-1],
        "page_lowest": float(min(rates)),
        "page_mean": sum(rates) / len(rates),
        "crowd_late_s": max(one["late"] for one in spoken),
        "crowd_took_s": max(one["took"] for one in spoken),
    }


def keeps_up(run: dict[str, float], seconds: float) -> bool:
    """Whether the crowd spoke as fast as it should: if not, the run says nothing of the monitor."""
    return run["crowd_took_s"] <= seconds / SHARE


def measure(rounds: int, seconds: float = 60.0, step_seconds: float = 20.0) -> dict[str, Any]:
    """The load of the bar, and how much more it may be."""
    with tempfile.TemporaryDirectory() as folder:
        at_bar = over_rounds([one_run(RATE, seconds, Path(folder)) for _ in range(rounds)])
        steps = []
        for rate in STEPS:
            steps.append(one_run(rate, step_seconds, Path(folder)))
            if steps[-1]["lost"] or not keeps_up(steps[-1], step_seconds):
                break
    return {"rounds": rounds, "seconds": seconds, "step_seconds": step_seconds, "bar": at_bar, "steps": steps}


def section(found: dict[str, Any]) -> str:
    """The figures in Markdown."""
    bar = found["bar"]
    lost, lowest = bar["lost"]["high"], bar["page_lowest"]["low"]
    borne = [step for step in found["steps"] if not step["lost"] and keeps_up(step, found["step_seconds"])]
    best = max((step["sent_per_s"] for step in borne), default=bar["sent_per_s"]["median"])
    runs = [({key: one["median"] for key, one in bar.items()}, found["seconds"])]
    runs += [(step, found["step_seconds"]) for step in found["steps"]]
    head = [
        "robots × rate × topics", "messages/s", "for [s]", "lost", "page, lowest (mean) [1/s]",
        "CPU of one core", "memory, before → after [MiB]", "recording [MiB]",
    ]  # fmt: skip
    words = (
        f"{ROBOTS} robots at {RATE:g} Hz, {TOPICS} topics each (odometry, commands with their trace,",
        "positions with the order), besides those every robot's status and the leader; over loopback,",
        f"recorded, with a page open, for {found['seconds']:g} s. Of {bar['sent']['median']:,.0f} messages",
        f"{lost:,.0f} were lost, and the page got {lowest:.0f} updates in its worst second (wanted: none",
        f"lost, {PAGE:g} a second): **{verdict(not lost and lowest >= PAGE)}**. The highest rate",
        f"without loss that was tried is {best:,.0f} messages a second.",
    )
    how = (
        f"The robots are {SPEAKERS} processes on the same cores, every robot with a link of its own. Lost is",
        "what they handed to Zenoh less what is in the recording, key by key. Where robots were late, they",
        "and not the monitor were too slow.",
    )
    return f"{filled(*words)}\n{markdown(head, [_row(*run) for run in runs])}\n{filled(*how)}"


def _row(run: dict[str, float], seconds: float) -> list[str]:
    late = "" if keeps_up(run, seconds) else " (robots late)"
    return [
        f"{ROBOTS} × {run['rate_hz']:g} Hz × {TOPICS}{late}",
        f"{run['sent_per_s']:,.0f}",
        f"{seconds:g}",
        f"{run['lost']:,.0f}",
        f"{run['page_lowest']:.0f} ({run['page_mean']:.1f})",
        f"{run['cpu_percent']:.0f} %",
        f"{run['rss_mib']:.0f} → {run['rss_after_mib']:.0f}",
        f"{run['recording_mib']:.0f}",
    ]


if __name__ == "__main__":
    command(__doc__, measure, section, rounds=1, seconds=5.0, step_seconds=5.0)
