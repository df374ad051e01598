"""One node for everybody beside one agent for each: latency, error and cost against the number of robots.

python -m tests.campaigns.bench.bench_central [--quick] [--rounds N] [--seconds S] [--json] [--draw FOLDER]

The central node (`tests.campaigns.bench.central`) is the paper's architecture with this project's law; the
agents are `python -m formation.agent`, unmodified. Both drive the same simulated robots behind the same
leader, at 10 Hz, over Zenoh on loopback; in each round they take turns at each number of robots.
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any, get_args

from tests.campaigns.bench.fleet import RATE, Architecture, Fleet, Outcome, command
from tests.campaigns.figures import filled, markdown, over_rounds, progress, span
from tests.campaigns.plots import BLUE, ORANGE, counted, curve, legend, milliseconds, panels

COUNTS, QUICK_COUNTS = (2, 10, 50), (2, 10)
"""Of followers."""
ARCHITECTURES: tuple[Architecture, ...] = get_args(Architecture)
WORDS = {"agents": "an agent each", "central": "one central node"}
CURVES = "bench_central.svg"


def measure(counts: tuple[int, ...], rounds: int, settle: float, seconds: float) -> dict[str, Any]:
    """All figures; medians over rounds with their lowest and highest."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            turns = ARCHITECTURES if number % 2 == 0 else ARCHITECTURES[::-1]
            one: dict[str, Any] = {}
            for count in counts:
                progress(f"round {number + 1} of {rounds}: {count} robots …")
                each = {how: figures(Fleet(count, how, Path(folder)).run(settle, seconds)) for how in turns}
                one[str(count)] = {how: each[how] for how in ARCHITECTURES}
            found.append(one)
    return {"rounds": rounds, "seconds": seconds, "robots": over_rounds(found)}


def figures(outcome: Outcome) -> dict[str, Any]:
    """What one fleet comes to."""
    drivers = outcome.drivers.values()
    return {
        **outcome.robots,
        "per_process": {
            name: statistics.median(one[name] for one in drivers)
            for name in ("cpu_percent", "kilobytes_per_s", "links", "rss_mib")
        },
        "together": {name: sum(one[name] for one in drivers) for name in ("cpu_percent", "pss_mib")},
        "bodies_cpu_percent": outcome.others["bodies"],
    }


def draw(found: dict[str, Any], folder: Path) -> None:
    """Latency and error against the number of robots, of both architectures."""
    robots = found["robots"]
    places = [float(count) for count in robots]
    with panels(folder / CURVES, 2) as (latency, error):
        for how, colour in zip(ARCHITECTURES, (BLUE, ORANGE), strict=True):
            for name, line in (("p50", "-"), ("p99", "--")):
                took = [one[how]["latency_ms"][name] for one in robots.values()]
                curve(latency, places, took, f"{WORDS[how]}, {name}", colour, line)
            curve(error, places, [one[how]["error_mm"]["rms"] for one in robots.values()], WORDS[how], colour)
        milliseconds(latency, "odometry → command [ms]")
        error.set_ylabel("error per edge, RMS [mm]")
        error.set_ylim(bottom=0.0)
        for axes in (latency, error):
            counted(axes, places, "robots")
            legend(axes, 2)


def section(found: dict[str, Any]) -> str:
    """The figures in Markdown."""
    driven, costs = [], []
    for count, each in found["robots"].items():
        for how, one in each.items():
            latency, error, cost, whole = (
                one[key] for key in ("latency_ms", "error_mm", "per_process", "together")
            )
            name = f"{count} × {WORDS[how]}"
            driven.append(
                [
                    name,
                    *(span(latency[at], 2) for at in ("p50", "p99", "max")),
                    span(one["late_percent"], 2, " %"),
                    span(error["rms"], 2),
                    span(error["max"], 2),
                ]
            )
            costs.append(
                [
                    name,
                    span(cost["cpu_percent"], 1, " %"),
                    span(whole["cpu_percent"], 0, " %"),
                    span(cost["rss_mib"], 0),
                    span(whole["pss_mib"], 0),
                    f"{cost['links']['median']:.0f}",
                    span(cost["kilobytes_per_s"], 0),
                ]
            )
    latencies = markdown(
        (
            "robots × who drives them",
            "p50 [ms]",
            "p99 [ms]",
            "max [ms]",
            "late",
            "error, RMS [mm]",
            "worst [mm]",
        ),
        driven,
    )
    taken = markdown(
        (
            "robots × who drives them", "CPU of a process", "of all", "RSS of a process [MiB]",
            "PSS of all [MiB]", "links of a process", "traffic of a process [kB/s]",
        ),
        costs,
    )  # fmt: skip
    how = filled(
        """The paper has one computer that hears every robot and commands them all. Here it is a process
        that does so with this project's observers, tracks and law, put together from the same code,
        over Zenoh with a link to each robot; beside it the agents, one process for each robot. Both
        drive""",
        f"""a block of robots that measure two of the row before each, behind a leader on a circle, with
        odometry at {RATE:g} Hz, every robot at a phase of its own. The bodies are one process, and all
        of it shares this machine's processors, where on a team of robots each agent has one of its own.
        Each of the {found["rounds"]} rounds measures {found["seconds"]:g} s of each.""",
        """Late is what has no command half a period after its odometry was due; the error is the mean over
        the edges.""",
    )
    return f"""{how}
![Latency and formation error against the number of robots, of both architectures](figures/{CURVES})

{latencies}
What the controllers cost, in percent of one core:

{taken}"""


def main() -> None:
    """Print the figures."""
    command(__doc__, measure, COUNTS, QUICK_COUNTS, draw, section)


if __name__ == "__main__":
    main()
