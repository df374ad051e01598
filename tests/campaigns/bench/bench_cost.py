"""What one robot's agent costs, against how many robots there are: it must depend on its neighbours alone.

python -m tests.campaigns.bench.bench_cost [--quick] [--rounds N] [--json]

6 to 100 agents (`python -m formation.agent`, unmodified), each a process of its own with links of its own, at
10 Hz behind a real leader; every one of them measures two others. The bodies are one process, because a
hundred of `python -m formation.agent.simulated` would need more than these processors have. Odd rounds go up,
even ones down.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.campaigns.bench.fleet import QUICK, RATE, Architecture, Outcome, trials
from tests.campaigns.figures import Bar, Column, command, filled, judged, over_rounds, table
from tests.campaigns.plots import BLUE, GREEN, INK, ORANGE, counted, curve, legend, panels

COUNTS, QUICK_COUNTS = (6, 12, 25, 50, 100), (6, 12)
"""Of agents."""
COSTS = {
    "cpu_percent": "CPU",
    "kilobytes_per_s": "bytes/s",
    "packets_per_s": "packets/s",
    "links": "links",
    "rss_mib": "RSS",
    "pss_mib": "PSS",
    "threads": "threads",
}
BAR, LATE_BAR = 0.10, 1.0
"""Per-robot figures of the most agents may be so far above those of the fewest; periods late [%]."""
BARRED = ("links", "kilobytes_per_s", "cpu_percent")
CURVES = "bench_cost.svg"
COST_COLUMNS = (
    Column("CPU of one core", "cost/cpu_percent", 2, " %"),
    Column("RSS [MiB]", "cost/rss_mib", 1),
    Column("PSS [MiB]", "cost/pss_mib", 1),
    Column("threads", "cost/threads", 0, spread=False),
    Column("links", "cost/links", 0, spread=False),
    Column("traffic [kB/s]", "cost/kilobytes_per_s", 1),
    Column("packets/s", "cost/packets_per_s", 0),
)
HELD = (
    Column("late periods", "late_percent", 2, " %"),
    Column("odometry → command, p50 [ms]", "latency_ms/p50", 2),
    Column("p99 [ms]", "latency_ms/p99", 2),
    Column("error per edge, RMS [mm]", "error_mm/rms", 2),
    Column("worst [mm]", "error_mm/max", 2),
    Column("all processes, of one core", "machine_percent", 0, " %"),
    Column("start → all on the way [s]", "start_s", 1),
)


def measure(rounds: int, counts: Sequence[int] = COUNTS, **times: float) -> dict[str, Any]:
    """All figures; medians over rounds with their lowest and highest."""

    def turns(number: int) -> list[tuple[int, Architecture]]:
        return [(count, "agents") for count in counts[:: -1 if number % 2 else 1]]

    seconds, every = trials(rounds, turns, **times)
    found = [compared({str(count): figures(one[count, "agents"]) for count in counts}) for one in every]
    return {"rounds": rounds, "seconds": seconds, "agents": over_rounds(found)}


def figures(outcome: Outcome) -> dict[str, Any]:
    """What one fleet comes to; costs are the median of the agents with two neighbours and two followers."""
    agents = list(outcome.drivers.values())
    return {
        "cost": {
            name: statistics.median(outcome.drivers[robot][name] for robot in outcome.typical)
            for name in COSTS
        },
        "dearest": {name: max(one[name] for one in agents) for name in COSTS},
        **outcome.robots,
        "machine_percent": sum(one["cpu_percent"] for one in agents) + sum(outcome.others.values()),
        "start_s": outcome.start_s,
    }


def compared(each: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """The same with each cost as a multiple of what it is with the fewest agents, in the same round."""
    fewest = next(iter(each.values()))["cost"]
    return {
        count: {**one, "relative": {name: one["cost"][name] / fewest[name] for name in COSTS}}
        for count, one in each.items()
    }


def draw(found: dict[str, Any], folder: Path) -> None:
    """Costs relative to the fewest agents', late periods, and the error, against the number of agents."""
    agents = found["agents"]
    places = [float(count) for count in agents]
    lines = {"cpu_percent": BLUE, "kilobytes_per_s": ORANGE, "links": INK, "rss_mib": GREEN}
    with panels(folder / CURVES, 3) as (cost, late, error):
        cost.axhspan(1.0 - BAR, 1.0 + BAR, color=INK, alpha=0.12, linewidth=0.0)
        for name, colour in lines.items():
            curve(cost, places, agents.values(), f"relative/{name}", COSTS[name], colour)
        cost.set_ylabel(f"per agent, of that with {places[0]:g}")
        cost.set_ylim(0.0, 2.0)
        legend(cost, 2)
        curve(late, places, agents.values(), "late_percent", "late", BLUE)
        late.axhline(LATE_BAR, color=ORANGE, linewidth=1.0, linestyle="--")
        curve(error, places, agents.values(), "error_mm/rms", "error", BLUE)
        for axes, label in ((late, "late periods [%]"), (error, "error per edge, RMS [mm]")):
            axes.set_ylabel(label)
            axes.set_ylim(0.0, None)
        for axes in (cost, late, error):
            counted(axes, places, "agents")


def section(found: dict[str, Any]) -> str:
    """The figures in Markdown."""
    agents = found["agents"]
    how = filled(
        f"""Every agent is a real process (`python -m formation.agent`) at {RATE:g} Hz that measures two
        robots of the row before it, and two of the row behind measure it: four links in the fleet and one
        to its robot, and no monitor.""",
        """Costs are the median over the agents of which that is so. Traffic is both directions together,
        as the kernel counts it; a packet is a segment with data, which is a message or a few. PSS falls
        as more processes share the same libraries.""",
        f"""All agents, the leader and the bodies, which are one process, share this machine. In each of
        {found["rounds"]} rounds every number of agents is measured for {found["seconds"]:g} s.""",
    )
    return f"""{how}
![Cost per agent, late periods and formation error against the number of agents](figures/{CURVES})

{judged(bar.row(agents) for bar in _bars(list(agents)))}
{_full(agents)}{table("agents", agents, COST_COLUMNS)}
Late is a period whose command was not there half a period after its odometry was due; the error is the mean
over the edges, behind a leader on a circle:

{table("agents", agents, HELD)}"""


def _bars(counts: list[str]) -> list[Bar]:
    fewest, most = counts[0], counts[-1]
    costs = [
        Bar(f"{COSTS[name]} per agent, {most} of {fewest}", f"{most}/relative/{name}", "≤", 1.0 + BAR, 3, "×")
        for name in BARRED
    ]
    return [*costs, Bar(f"late periods, {most} agents", f"{most}/late_percent", "<", LATE_BAR, 2, " %")]


def _full(agents: dict[str, Any]) -> str:
    """That more agents than these processors have time for cost what is left to them, if it is so."""
    in_time = [count for count, one in agents.items() if one["late_percent"]["median"] < LATE_BAR]
    most = list(agents)[-1]
    if most in in_time:
        return ""
    full = f"With {most} agents the processors are full, and what an agent costs is what it gets."
    if not in_time:
        return filled(full) + "\n"
    relative = agents[in_time[-1]]["relative"]
    each = ", ".join(f"{COSTS[name]} {relative[name]['median']:.2f}×" for name in BARRED)
    in_time_at = f"The most that were in time are {in_time[-1]}; per agent, of {next(iter(agents))}: {each}."
    return filled(full, in_time_at) + "\n"


if __name__ == "__main__":
    command(__doc__, measure, section, rounds=2, counts=QUICK_COUNTS, **QUICK)
