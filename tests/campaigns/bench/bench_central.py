"""One node for everybody beside one agent for each: latency, error and cost against the number of robots.

python -m tests.campaigns.bench.bench_central [--quick] [--rounds N] [--json]

The central node (`tests.campaigns.bench.central`) is the paper's architecture with this project's law; the
agents are `python -m formation.agent`, unmodified. Both drive the same simulated robots behind the same
leader, at 10 Hz, over Zenoh on loopback; in each round they take turns at each number of robots.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

from tests.campaigns.bench.fleet import QUICK, RATE, Architecture, Outcome, trials
from tests.campaigns.figures import Column, command, filled, over_rounds, table
from tests.campaigns.plots import BLUE, ORANGE, counted, curve, legend, milliseconds, panels

COUNTS, QUICK_COUNTS = (2, 10, 50), (2, 10)
"""Of followers."""
ARCHITECTURES: tuple[Architecture, ...] = get_args(Architecture)
WORDS = {"agents": "an agent each", "central": "one central node"}
CURVES = "bench_central.svg"
DRIVEN = (
    Column("p50 [ms]", "latency_ms/p50", 2),
    Column("p99 [ms]", "latency_ms/p99", 2),
    Column("max [ms]", "latency_ms/max", 2),
    Column("late", "late_percent", 2, " %"),
    Column("error, RMS [mm]", "error_mm/rms", 2),
    Column("worst [mm]", "error_mm/max", 2),
)
COSTS = (
    Column("CPU of a process", "per_process/cpu_percent", 1, " %"),
    Column("of all", "together/cpu_percent", 0, " %"),
    Column("RSS of a process [MiB]", "per_process/rss_mib", 0),
    Column("PSS of all [MiB]", "together/pss_mib", 0),
    Column("links of a process", "per_process/links", 0, spread=False),
    Column("traffic of a process [kB/s]", "per_process/kilobytes_per_s", 0),
)


def measure(rounds: int, counts: Sequence[int] = COUNTS, **times: float) -> dict[str, Any]:
    """All figures; medians over rounds with their lowest and highest."""

    def turns(number: int) -> list[tuple[int, Architecture]]:
        return [(count, how) for count in counts for how in ARCHITECTURES[:: -1 if number % 2 else 1]]

    seconds, every = trials(rounds, turns, **times)
    found = [
        {str(count): {how: figures(one[count, how]) for how in ARCHITECTURES} for count in counts}
        for one in every
    ]
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
                path, label = f"{how}/latency_ms/{name}", f"{WORDS[how]}, {name}"
                curve(latency, places, robots.values(), path, label, colour, line)
            curve(error, places, robots.values(), f"{how}/error_mm/rms", WORDS[how], colour)
        milliseconds(latency, "odometry → command [ms]")
        error.set_ylabel("error per edge, RMS [mm]")
        error.set_ylim(bottom=0.0)
        for axes in (latency, error):
            counted(axes, places, "robots")
            legend(axes, 2)


def section(found: dict[str, Any]) -> str:
    """The figures in Markdown."""
    rows = {
        f"{count} × {WORDS[how]}": one for count, each in found["robots"].items() for how, one in each.items()
    }
    how = filled(
        """The paper has one computer that receives every robot and commands them all. Here it is a process
        that does so with this project's observers, tracks and law, put together from the same code,
        over Zenoh with a link to each robot; beside it the agents, one process for each robot. Both
        drive""",
        f"""a block of robots that measure two of the row before each, behind a leader on a circle, with
        odometry at {RATE:g} Hz, every robot at a phase of its own. The bodies are one process, and all
        of it shares this machine's processors, where in a fleet of robots each agent has one of its own.
        Each of the {found["rounds"]} rounds measures {found["seconds"]:g} s of each.""",
        """Late is what has no command half a period after its odometry was due; the error is the mean over
        the edges.""",
    )
    return f"""{how}
![Latency and formation error against the number of robots, of both architectures](figures/{CURVES})

{table("robots × driver", rows, DRIVEN)}
What the controllers cost, in percent of one core:

{table("robots × driver", rows, COSTS)}"""


if __name__ == "__main__":
    command(__doc__, measure, section, rounds=2, counts=QUICK_COUNTS, **QUICK)
