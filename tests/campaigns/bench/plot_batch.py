"""The curves of `bench_batch`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from tests.campaigns.bench.report_batch import IR_SIM, ONE, OURS, ROBOTARIUM
from tests.campaigns.plots import BLUE, INK, ORANGE, panels

LINES = {
    OURS: (BLUE, "-", "many runs"),
    ONE: (BLUE, "--", "one formation"),
    IR_SIM: (ORANGE, "-", "ir-sim"),
    ROBOTARIUM: (INK, "-", "Robotarium"),
}
"""Colour, stroke and label of each side."""


def draw(found: Mapping[str, Any], path: Path) -> None:
    """Robot steps a second, and memory per robot, against robots."""
    with panels(path, 2, style={"svg.hashsalt": "bench"}) as (speed, memory):
        _curves(speed, found, lambda _robots, one: one["robot_steps_per_s"]["median"], below=True)
        _curves(memory, found, lambda robots, one: 1024.0 * one["peak_mib"]["median"] / robots, below=False)
        speed.set_ylabel("robot steps a second")
        memory.set_ylabel("memory of the process per robot [KiB]")


def _curves(
    axes: Axes, found: Mapping[str, Any], height: Callable[[int, Any], float], *, below: bool
) -> None:
    """A curve for each side; `below` is whether the label of one formation has its room there, or above."""
    for side, (colour, stroke, label) in LINES.items():
        if side not in found:
            continue
        sizes = sorted(int(size) for size in found[side])
        heights = [height(size, found[side][str(size)]) for size in sizes]
        axes.plot(sizes, heights, stroke, color=colour, marker="o", markersize=3.0, linewidth=1.5)
        aside = (5, 0) if side != ONE else (-10, -12) if below else (-10, 12)
        axes.annotate(
            label, (sizes[-1], heights[-1]), aside, textcoords="offset points", color=colour, va="center"
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.minorticks_off()
    axes.set_xlabel("robots")
    axes.margins(x=0.12)
