"""What the edge costs: one agent beside Zenoh without an agent, at several rates, in the same rounds.

python -m tests.campaigns.bench.bench_agent [--quick] [--rounds N] [--json]

Three processes take turns, each a third of a period after the other:

- agent: `python -m formation.agent`, unmodified, with two neighbours and a monitor
- copy:  a bare Zenoh script with the agent's sessions, links, keys, rates and messages that computes nothing
- echo:  the same script with one key to hear and one to answer on

All three get the same odometry from this process and answer with a command. A latency is the time from `put`
of the odometry to the command in this process's receive callback; the next odometry waits until the last one
is answered, so every answer has its question. Each round starts all three anew at each rate. As fast as it
goes (rate 0) they take turns by the half second, and the next odometry follows upon the command; all else is
as at 50 Hz. A round before, at 50 Hz, replaces the agent by one with stopwatches at its interfaces.
"""

from __future__ import annotations

import gc
import json
import subprocess
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from formation.topics import CMD_VEL, ODOM
from formation.transport.bus import Bus, BusConfig
from tests.campaigns.bench import edge
from tests.campaigns.bench.processes import busy, memory
from tests.campaigns.bench.scene import ROBOTS, Robots, Scene, Subject
from tests.campaigns.figures import (
    Bar,
    Column,
    command,
    filled,
    judged,
    markdown,
    over_rounds,
    progress,
    span,
    tail,
)  # fmt: skip
from tests.campaigns.plots import BLUE, INK, ORANGE, curve, legend, milliseconds, panels

FASTEST = "as fast as it goes"
"""What stands for a rate then."""
JUDGED = "50"
"""At this rate the bars stand [Hz]."""
CURVES = "bench_agent.svg"


BARS = (
    Bar("odometry → command, p50, of the echo's", "ratio/latency to echo/p50", "≤", 1.15, 2, "×"),
    Bar("odometry → command, p99, of the echo's", "ratio/latency to echo/p99", "≤", 1.5, 2, "×"),
    Bar("CPU at 50 Hz, of the copy's", "ratio/cost to copy/cpu_percent", "≤", 1.3, 2, "×"),
    Bar("resident memory", "agent/cost/rss_mib", "≤", 48.0, 1, " MiB"),
    Bar("start → first command of the law", "agent/start_s/first motion", "≤", 0.5, 2, " s"),
)
SUBJECTS = ("agent", "copy", "echo")
TAIL = ("p50", "p90", "p99", "max")
LINES = {"p50": "-", "p99": "--"}


def section(found: dict[str, Any]) -> str:
    """The section in Markdown, from what `bench_agent.measure` found."""
    rounds = f"{found['rounds']} rounds of {found['seconds']:g} s"
    at_bar = found["rates"].get(JUDGED)
    who = filled(
        """Three processes take turns in the same run, on loopback: the **agent**
        (`python -m formation.agent`, unmodified, two neighbours with a live order at the same rate, a
        monitor that listens), a **copy** (bare Zenoh with the agent's sessions, links, keys, rates,
        sizes and quality of service, which computes nothing) and an **echo** (bare Zenoh, one key in, one
        out, straight in the callback). All have the same settings: a client of the robot's router and, but
        for the echo,
        a sparse peer in the fleet.""",
        f"""Each of the {rounds} starts all three anew at each rate. As fast as it goes they take turns by
        the half second, each with the next odometry upon its command and all else as at 50 Hz.""",
    )
    return f"""{who}
![Latency of agent, copy and echo, and what the agent adds, against the rate of odometry](figures/{CURVES})

{judged(bar.row(at_bar) for bar in BARS) if at_bar else ""}
{_latency(found["rates"])}
{_cost(at_bar) if at_bar else ""}
{_profile(found)}"""


def draw(found: dict[str, Any], folder: Path) -> None:
    """Latencies, and the agent's as a multiple of the echo's, against the rate; the fastest stands last."""
    rates = found["rates"]
    places = [float(place) for place in range(len(rates))]
    marks = ["fastest" if name == FASTEST else name for name in rates]
    with panels(folder / CURVES, 2) as (latency, ratio):
        for subject, colour in zip(SUBJECTS, (BLUE, ORANGE, INK), strict=True):
            for name, line in LINES.items():
                path = f"{subject}/latency_ms/{name}"
                curve(latency, places, rates.values(), path, f"{subject}, {name}", colour, line)
        for name, line in LINES.items():
            curve(ratio, places, rates.values(), f"ratio/latency to echo/{name}", name, BLUE, line)
        for bar, (name, line) in zip(BARS, LINES.items(), strict=False):
            label = f"{name} wanted at {JUDGED} Hz"
            ratio.axhline(bar.bound, color=ORANGE, linewidth=1.0, linestyle=line, label=label)
        milliseconds(latency, "odometry → command [ms]")
        ratio.set_ylabel("agent's of the echo's")
        ratio.set_ylim(bottom=0.0)
        for axes in (latency, ratio):
            axes.set_xticks(places, marks)
            axes.set_xlabel("odometry [Hz]")
        legend(latency, 3)
        legend(ratio, 2)


def _latency(rates: dict[str, Any]) -> str:
    rows = []
    for rate, one in rates.items():
        name = rate if rate == FASTEST else f"{rate} Hz"
        for subject in SUBJECTS:
            latency, answers = one[subject]["latency_ms"], one[subject]["answers"]
            fast = f", {one[subject]['speed']['answers_per_s']['median']:,.0f}/s" if rate == FASTEST else ""
            lost = f"{answers['lost']['median']:.0f} of {answers['counted']['median']:.0f}"
            rows.append([f"{name}: {subject}{fast}", *(span(latency[part], 2) for part in TAIL), lost])
        for other in ("echo", "copy"):
            ratio = one["ratio"][f"latency to {other}"]
            rows.append([f"{name}: agent ÷ {other}", *(span(ratio[part], 2, "×") for part in TAIL), ""])
    return "From `put` of the odometry to the command in the receive callback [ms]:\n\n" + markdown(
        ("", *TAIL, "lost"), rows
    )


COSTS = (
    Column("CPU of one core", "cost/cpu_percent", 1, " %"),
    Column("RSS [MiB]", "cost/rss_mib", 1),
    Column("PSS [MiB]", "cost/pss_mib", 1),
    Column("threads", "cost/threads", 0, spread=False),
    Column("start → first command [s]", "start_s/first command", 2),
    Column("→ first that moves [s]", "start_s/first motion", 2),
)


def _cost(found: dict[str, Any]) -> str:
    rows = [[subject, *(one.cell(found[subject]) for one in COSTS)] for subject in SUBJECTS]
    ratio = {"cost": found["ratio"]["cost to copy"]}
    times = [one._replace(digits=1, unit="×").cell(ratio) for one in COSTS[:4]]
    header = ["", *(one.head for one in COSTS)]
    return "What each costs at 50 Hz, traffic to the monitor included:\n\n" + markdown(
        header, [*rows, ["agent ÷ copy", *times, "", ""]]
    )


def _profile(found: dict[str, Any]) -> str:
    profile = found["profile_us"]
    total = sum(part["p50"] for part in profile.values())
    rows = [
        (part, f"{took['p50']:.0f}", f"{100.0 * took['p50'] / total:.0f} %", f"{took['p99']:.0f}")
        for part, took in profile.items()
    ]
    return f"""Where the agent's time goes, in a round with stopwatches at its interfaces, which take time
themselves (the medians add up to {total:.0f} µs) [µs]:

{markdown(("part", "p50", "share", "p99"), rows)}
The longest pause of the garbage collector in that round took {found["longest_collection_us"]:.0f} µs.
"""


RATES = (20.0, 50.0, 200.0, 0.0)
"""Of odometry [Hz]; 0 is as fast as it goes."""
WARM_UP = 2.0
"""[s]"""
INSIDE = {
    "decode odometry": ("decode",),
    "observer": ("observer",),
    "failsafe table": ("failsafe",),
    "law": ("law",),
    "collision filter": ("collision filter",),
    "encode command and sign of life": ("encode Twist", "encode Number"),
    "encode position and order": ("encode Pose", "encode Order"),
}
"""Parts of a step, and the stopwatches of `profiled_agent` that tell them."""


@contextmanager
def surrounded(scene: Scene) -> Iterator[Bus]:
    """The neighbours and the monitor, alive; the bus of the robots, which are their own router."""
    others = subprocess.Popen(scene.surroundings(), stdout=subprocess.PIPE, stdin=subprocess.DEVNULL)
    try:
        assert others.stdout is not None
        if not others.stdout.readline():
            raise RuntimeError("the neighbours did not come up")
        with Bus(BusConfig(listen=(scene.robot,), mode="router")) as bus:
            for robot in ROBOTS.values():
                bus.advertise(ODOM, ODOM.key(robot))
                bus.subscribe(CMD_VEL.key(robot))
            yield bus
    finally:
        others.kill()
        others.communicate()


Figures = dict[str, dict[str, dict[str, float]]]
"""By subject and kind."""


def one_round(bus: Bus, scene: Scene, subjects: Sequence[Subject], seconds: float) -> Figures:
    """Start all subjects, measure them at the scene's rate for so long and end them."""
    with started(bus, scene, subjects) as robots:
        before, start = [busy(subject.pid) for subject in subjects], time.monotonic()
        robots.drive_for(seconds)
        after, elapsed = [busy(subject.pid) for subject in subjects], time.monotonic() - start
        shares = np.subtract(after, before) / elapsed
        return {
            subject.name: {
                **latencies(subject),
                "cost": {"cpu_percent": 100.0 * share, **memory(psutil.Process(subject.pid))},
                "start_s": {
                    "first command": subject.first - subject.started,
                    "first motion": subject.moving - subject.started,
                },
            }
            for subject, share in zip(subjects, shares.tolist(), strict=True)
        }


def one_race(bus: Bus, scene: Scene, subjects: Sequence[Subject], seconds: float) -> Figures:
    """Start all subjects, have each answer as fast as it goes for a third of so long and end them."""
    with started(bus, scene, subjects) as robots:
        rates = robots.race(seconds)
        return {
            subject.name: {**latencies(subject), "speed": {"answers_per_s": rates[subject.name]}}
            for subject in subjects
        }


@contextmanager
def started(bus: Bus, scene: Scene, subjects: Sequence[Subject]) -> Iterator[Robots]:
    """All subjects, started one after the other and warm; they are ended at the end."""
    bus.drain()  # last words of the round before
    robots = Robots(bus, subjects, scene.origin, scene.rate)
    try:
        for subject in subjects:
            subject.start()
            robots.drive(subject.has_moved)
        robots.drive_for(WARM_UP)
        for subject in subjects:
            subject.forget()
        yield robots
    finally:
        for subject in subjects:
            subject.end()


def latencies(subject: Subject) -> dict[str, dict[str, float]]:
    """What became of the odometry that counts."""
    return {
        "latency_ms": tail([(one.answered - one.sent) * 1e3 for one in subject.exchanges]),
        "answers": {"counted": float(len(subject.exchanges)), "lost": float(subject.lost)},
    }


def with_ratios(figures: Figures) -> dict[str, Any]:
    """A round's figures with what the agent takes relative to the others in the same round."""

    def ratios(other: str, kind: str) -> dict[str, float]:
        own, others = figures["agent"].get(kind, {}), figures[other].get(kind, {})
        return {name: own[name] / others[name] for name in own}

    return {
        **figures,
        "ratio": {
            "latency to echo": ratios("echo", "latency_ms"),
            "latency to copy": ratios("copy", "latency_ms"),
            "cost to copy": ratios("copy", "cost"),
        },
    }


def where_it_goes(profile: dict[str, Any], agent: Subject) -> dict[str, Any]:
    """The parts of each exchange of the profiled agent [µs]."""
    parts = defaultdict[str, list[float]](list)
    steps = {step["arrived"]: step for step in profile["steps"] if "sent" in step}
    arrivals = np.array(sorted(steps))
    for sent, answered in agent.exchanges:
        index = int(np.searchsorted(arrivals, sent))
        if index == len(arrivals) or arrivals[index] > answered:
            continue
        step = steps[arrivals[index]]
        inside = {part: sum(step.get(name, 0.0) for name in names) for part, names in INSIDE.items()}
        whole = {
            "odometry to the agent": step["arrived"] - sent,
            "wake-up of its main thread": step["begin"] - step["arrived"],
            **inside,
            "rest of the step": step["end"] - step["begin"] - sum(inside.values()),
            "command to the robot": answered - step["end"],
        }
        for part, took in whole.items():
            parts[part].append(took * 1e6)
    return {part: {"mean": float(np.mean(took)), **tail(took)} for part, took in parts.items()}


def profiled(folder: Path, seconds: float) -> dict[str, Any]:
    """A round with stopwatches inside the agent."""
    scene, file = Scene(folder, edge.RATE), folder / "profile.json"
    agent = Subject("agent", ROBOTS["agent"], scene.profiled_agent(file))
    echo = Subject("echo", ROBOTS["echo"], scene.echo())
    with surrounded(scene) as bus:
        one_round(bus, scene, [agent, echo], seconds)
    profile = json.loads(file.read_text())
    return {
        "profile_us": where_it_goes(profile, agent),
        "longest_collection_us": max(profile["pauses"], default=0.0) * 1e6,
    }


def measure(rounds: int, seconds: float = 15.0) -> dict[str, Any]:
    """All figures of the edge at each rate; medians over rounds with their lowest and highest."""
    found: dict[str, list[dict[str, Any]]] = {f"{rate:g}" if rate else FASTEST: [] for rate in RATES}
    with tempfile.TemporaryDirectory() as folder:
        progress("where the time goes …")
        profile = profiled(Path(folder), seconds)
        for number in range(rounds):
            for rate, (name, rounds_at) in zip(RATES, found.items(), strict=True):
                progress(f"round {number + 1} of {rounds}: {name} …")
                scene = Scene(Path(folder), rate or edge.RATE)
                subjects = scene.subjects(number)
                with surrounded(scene) as bus:
                    gc.freeze()  # what stands by now needs no more collecting in the middle of a measurement
                    figures = (one_round if rate else one_race)(bus, scene, subjects, seconds)
                rounds_at.append(with_ratios(figures))
    rates_found = {name: over_rounds(rounds_at) for name, rounds_at in found.items()}
    return {"rounds": rounds, "seconds": seconds, "rates": rates_found, **profile}


if __name__ == "__main__":
    command(__doc__, measure, section, rounds=3, seconds=2.0)
