"""The edge's figures as they stand in docs/benchmarks.md, and its curves."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from tests.campaigns.figures import filled, judged, markdown, span
from tests.campaigns.plots import BLUE, INK, ORANGE, curve, legend, milliseconds, panels

FASTEST = "as fast as it goes"
"""What stands for a rate then."""
JUDGED = "50"
"""At this rate the bars stand [Hz]."""
CURVES = "bench_agent.svg"


class Target(NamedTuple):
    """What a figure is to come to."""

    what: str
    path: tuple[str, ...]
    most: float
    digits: int
    unit: str


TARGETS = (
    Target("odometry → command, p50, of the echo's", ("ratio", "latency to echo", "p50"), 1.15, 2, "×"),
    Target("odometry → command, p99, of the echo's", ("ratio", "latency to echo", "p99"), 1.5, 2, "×"),
    Target("CPU at 50 Hz, of the copy's", ("ratio", "cost to copy", "cpu_percent"), 1.3, 2, "×"),
    Target("resident memory", ("agent", "cost", "rss_mib"), 48.0, 1, " MiB"),
    Target("start → first command of the law", ("agent", "start_s", "first motion"), 0.5, 2, " s"),
)
SUBJECTS = ("agent", "copy", "echo")
TAIL = ("p50", "p90", "p99", "max")


def section(found: dict[str, Any]) -> str:
    """The section in Markdown, from what `bench_agent.measure` found."""
    rounds = f"{found['rounds']} rounds of {found['seconds']:g} s"
    judged = found["rates"].get(JUDGED)
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

{_targets(judged) if judged else ""}
{_latency(found["rates"])}
{_cost(judged) if judged else ""}
{_profile(found)}"""


def draw(found: dict[str, Any], folder: Path) -> None:
    """Latencies, and the agent's as a multiple of the echo's, against the rate; the fastest stands last."""
    rates = found["rates"]
    places = [float(place) for place in range(len(rates))]
    marks = ["fastest" if name == FASTEST else name for name in rates]
    with panels(folder / CURVES, 2) as (latency, ratio):
        for subject, colour in zip(SUBJECTS, (BLUE, ORANGE, INK), strict=True):
            for name, line in (("p50", "-"), ("p99", "--")):
                took = [one[subject]["latency_ms"][name] for one in rates.values()]
                curve(latency, places, took, f"{subject}, {name}", colour, line)
        for name, line in (("p50", "-"), ("p99", "--")):
            times = [one["ratio"]["latency to echo"][name] for one in rates.values()]
            curve(ratio, places, times, name, BLUE, line)
        for target, name, line in zip(TARGETS, ("p50", "p99"), ("-", "--"), strict=False):
            label = f"{name} wanted at {JUDGED} Hz"
            ratio.axhline(target.most, color=ORANGE, linewidth=1.0, linestyle=line, label=label)
        milliseconds(latency, "odometry → command [ms]")
        ratio.set_ylabel("agent's of the echo's")
        ratio.set_ylim(bottom=0.0)
        for axes in (latency, ratio):
            axes.set_xticks(places, marks)
            axes.set_xlabel("odometry [Hz]")
        legend(latency, 3)
        legend(ratio, 2)


def _targets(found: dict[str, Any]) -> str:
    rows = []
    for target in TARGETS:
        figure: Any = found
        for step in target.path:
            figure = figure[step]
        today, most = span(figure, target.digits, target.unit), f"≤ {target.most:g}{target.unit}"
        rows.append((target.what, today, most, figure["median"] <= target.most))
    return judged(rows)


def _latency(rates: dict[str, Any]) -> str:
    rows = []
    for rate, one in rates.items():
        name = rate if rate == FASTEST else f"{rate} Hz"
        for subject in SUBJECTS:
            latency, answers = one[subject]["latency_ms"], one[subject]["answers"]
            fast = f", {one[subject]['speed']['answers_per_s']['median']:,.0f}/s" if rate == FASTEST else ""
            rows.append(
                (
                    f"{name}: {subject}{fast}",
                    *(span(latency[at], 2) for at in TAIL),
                    f"{answers['lost']['median']:.0f} of {answers['counted']['median']:.0f}",
                )
            )
        for other in ("echo", "copy"):
            ratio = one["ratio"][f"latency to {other}"]
            rows.append((f"{name}: agent ÷ {other}", *(span(ratio[at], 2, "×") for at in TAIL), ""))
    return "From `put` of the odometry to the command in the receive callback [ms]:\n\n" + markdown(
        ("", *TAIL, "lost"), rows
    )


def _cost(found: dict[str, Any]) -> str:
    rows = []
    for subject in SUBJECTS:
        cost, start = found[subject]["cost"], found[subject]["start_s"]
        rows.append(
            (
                subject,
                span(cost["cpu_percent"], 1, " %"),
                span(cost["rss_mib"], 1),
                span(cost["pss_mib"], 1),
                f"{cost['threads']['median']:.0f}",
                span(start["first command"], 2),
                span(start["first motion"], 2),
            )
        )
    ratio = found["ratio"]["cost to copy"]
    rows.append(
        (
            "agent ÷ copy",
            span(ratio["cpu_percent"], 1, "×"),
            span(ratio["rss_mib"], 1, "×"),
            span(ratio["pss_mib"], 1, "×"),
            f"{ratio['threads']['median']:.1f}×",
            "",
            "",
        )
    )
    header = (
        "", "CPU of one core", "RSS [MiB]", "PSS [MiB]", "threads", "start → first command [s]",
        "→ first that moves [s]",
    )  # fmt: skip
    return "What each costs at 50 Hz, traffic to the monitor included:\n\n" + markdown(header, rows)


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
