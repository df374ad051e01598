"""The edge's figures as they stand in docs/benchmarks.md."""

from __future__ import annotations

from typing import Any, NamedTuple

from tests.bench.figures import markdown, span


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


def section(found: dict[str, Any]) -> str:
    """The section in Markdown, from what `bench_agent.measure` found."""
    rounds = f"{found['rounds']} rounds of {found['seconds']:g} s"
    return f"""Three processes take turns in the same run, on loopback, each at 50 Hz: the **agent**
(`python -m agent`, unmodified, two neighbours at 50 Hz with a live order, a monitor that listens), a **copy**
(bare Zenoh with the agent's sessions, links, keys, rates, sizes and quality of service, which computes
nothing) and an **echo** (bare Zenoh, one key in, one out, straight in the callback). All have the same
settings: a client of the robot's router and, but for the echo, a sparse peer in the fleet, on one runtime
thread. Each of the {rounds} starts all three anew.

{_targets(found)}
{_latency(found)}
{_cost(found)}
{_profile(found)}"""


def _targets(found: dict[str, Any]) -> str:
    rows = []
    for target in TARGETS:
        figure: Any = found
        for step in target.path:
            figure = figure[step]
        verdict = "met" if figure["median"] <= target.most else "falls short"
        rows.append(
            (
                target.what,
                span(figure, target.digits, target.unit),
                f"≤ {target.most:g}{target.unit}",
                verdict,
            )
        )
    return markdown(("figure", "today", "target", ""), rows)


def _latency(found: dict[str, Any]) -> str:
    rows = []
    for subject in SUBJECTS:
        latency, answers = found[subject]["latency_ms"], found[subject]["answers"]
        rows.append(
            (
                subject,
                *(span(latency[name], 2) for name in ("p50", "p90", "p99", "max")),
                f"{answers['lost']['median']:.0f} of {answers['counted']['median']:.0f}",
            )
        )
    ratio = found["ratio"]["latency to echo"]
    rows.append(("agent ÷ echo", *(span(ratio[name], 2, "×") for name in ("p50", "p90", "p99", "max")), ""))
    return "From `put` of the odometry to the command in the receive callback [ms]:\n\n" + markdown(
        ("", "p50", "p90", "p99", "max", "lost"), rows
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
    return "What each costs, traffic to the monitor included:\n\n" + markdown(header, rows)


def _profile(found: dict[str, Any]) -> str:
    profile = found["profile_us"]
    total = sum(part["p50"] for part in profile.values())
    rows = [
        (part, f"{took['p50']:.0f}", f"{100.0 * took['p50'] / total:.0f} %", f"{took['p99']:.0f}")
        for part, took in profile.items()
    ]
    return f"""Where the agent's time goes, in a round with stopwatches at its seams, which take time
themselves (the medians add up to {total:.0f} µs) [µs]:

{markdown(("part", "p50", "share", "p99"), rows)}
The longest pause of the garbage collector in that round took {found["longest_collection_us"]:.0f} µs.
"""
