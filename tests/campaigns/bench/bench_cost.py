"""What one robot's agent costs, against how many robots there are: it must depend on its neighbours alone.

python -m tests.campaigns.bench.bench_cost [--quick] [--rounds N] [--seconds S] [--json] [--draw FOLDER]

6 to 100 agents (`python -m formation.agent`, unmodified), each a process of its own with links of its own, at
10 Hz behind a real leader; every one of them measures two others. The bodies are one process, because a
hundred of `python -m formation.agent.simulated` would need more than these processors have. Odd rounds go up,
even ones down.
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any

from tests.campaigns.bench.fleet import RATE, Fleet, Outcome, command
from tests.campaigns.figures import filled, judged, markdown, over_rounds, progress, span
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


def measure(counts: tuple[int, ...], rounds: int, settle: float, seconds: float) -> dict[str, Any]:
    """All figures; medians over rounds with their lowest and highest."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            each = {}
            for count in counts if number % 2 == 0 else counts[::-1]:
                progress(f"round {number + 1} of {rounds}: {count} agents …")
                each[count] = figures(Fleet(count, "agents", Path(folder)).run(settle, seconds))
            found.append(compared({str(count): each[count] for count in counts}))
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
            relative = [one["relative"][name] for one in agents.values()]
            curve(cost, places, relative, COSTS[name], colour)
        cost.set_ylabel(f"per agent, of that with {places[0]:g}")
        cost.set_ylim(0.0, 2.0)
        legend(cost, 2)
        curve(late, places, [one["late_percent"] for one in agents.values()], "late", BLUE)
        late.axhline(LATE_BAR, color=ORANGE, linewidth=1.0, linestyle="--")
        late.set_ylabel("late periods [%]")
        late.set_ylim(0.0, None)
        curve(error, places, [one["error_mm"]["rms"] for one in agents.values()], "error", BLUE)
        error.set_ylabel("error per edge, RMS [mm]")
        error.set_ylim(0.0, None)
        for axes in (cost, late, error):
            counted(axes, places, "agents")


def section(found: dict[str, Any]) -> str:
    """The figures in Markdown."""
    agents = found["agents"]
    costs = markdown(
        (
            "agents", "CPU of one core", "RSS [MiB]", "PSS [MiB]", "threads", "links", "traffic [kB/s]",
            "packets/s",
        ),
        [_costs(count, one["cost"]) for count, one in agents.items()],
    )  # fmt: skip
    held = markdown(
        (
            "agents", "late periods", "odometry → command, p50 [ms]", "p99 [ms]", "error per edge, RMS [mm]",
            "worst [mm]", "all processes, of one core", "start → all on the way [s]",
        ),
        [_held(count, one) for count, one in agents.items()],
    )  # fmt: skip
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

{_bars(agents)}
{_full(agents)}{costs}
Late is a period whose command was not there half a period after its odometry was due; the error is the mean
over the edges, behind a leader on a circle:

{held}"""


def _bars(agents: dict[str, Any]) -> str:
    count, most = next(reversed(agents.items()))
    fewest = next(iter(agents))
    relative, late = most["relative"], most["late_percent"]
    return judged(
        [
            *(
                (
                    f"{COSTS[name]} per agent, {count} of {fewest}",
                    span(relative[name], 3, "×"),
                    f"≤ {1.0 + BAR:g}×",
                    relative[name]["median"] <= 1.0 + BAR,
                )
                for name in BARRED
            ),
            (
                f"late periods, {count} agents",
                span(late, 2, " %"),
                f"< {LATE_BAR:g} %",
                late["median"] < LATE_BAR,
            ),
        ]
    )


def _full(agents: dict[str, Any]) -> str:
    """That more agents than these processors have time for cost what is left to them, if it is so."""
    count, most = next(reversed(agents.items()))
    if most["late_percent"]["median"] < LATE_BAR:
        return ""
    full = f"With {count} agents the processors are full, and what an agent costs is what it gets."
    in_time = [count for count, one in agents.items() if one["late_percent"]["median"] < LATE_BAR]
    if not in_time:
        return filled(full) + "\n"
    relative = agents[in_time[-1]]["relative"]
    each = ", ".join(f"{COSTS[name]} {relative[name]['median']:.2f}×" for name in BARRED)
    in_time_at = f"The most that were in time are {in_time[-1]}; per agent, of {next(iter(agents))}: {each}."
    return filled(full, in_time_at) + "\n"


def _costs(count: str, cost: dict[str, dict[str, float]]) -> list[str]:
    return [
        count,
        span(cost["cpu_percent"], 2, " %"),
        span(cost["rss_mib"], 1),
        span(cost["pss_mib"], 1),
        f"{cost['threads']['median']:.0f}",
        f"{cost['links']['median']:.0f}",
        span(cost["kilobytes_per_s"], 1),
        span(cost["packets_per_s"], 0),
    ]


def _held(count: str, one: dict[str, Any]) -> list[str]:
    return [
        count,
        span(one["late_percent"], 2, " %"),
        span(one["latency_ms"]["p50"], 2),
        span(one["latency_ms"]["p99"], 2),
        span(one["error_mm"]["rms"], 2),
        span(one["error_mm"]["max"], 2),
        span(one["machine_percent"], 0, " %"),
        span(one["start_s"], 1),
    ]


def main() -> None:
    """Print the figures."""
    command(__doc__, measure, COUNTS, QUICK_COUNTS, draw, section)


if __name__ == "__main__":
    main()
