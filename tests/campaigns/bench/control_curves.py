"""The curves of the control benchmarks, as SVG: on no ground and in middle tones, labelled where they run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from formation.monitor.exporters.layout import COLOURS
from tests.campaigns.bench.control_trials import SHIPPED, front
from tests.campaigns.plots import INK, panels

BOUND = 0.05
"""Formation error under which the six robots count as settled [m]."""
BLUE, RED, GREEN, PINK, _, SKY, BROWN = COLOURS
COLOUR = {
    "field law": BLUE,
    "paper's law": RED,
    "proportional, gain 10": PINK,
    "proportional, gain 40": GREEN,
    "field law, gentle": SKY,
}
LENGTHS = {1e-4: "≤ 0.1 mm", 1e-3: "1 mm", 1e-2: "1 cm", 1e-1: "10 cm", 1.0: "1 m", 10.0: "10 m"}
LEAST = 1e-4
"""Errors under this are shown as this [m]."""
THICK, WIDE = 1.7, (8.6, 3.5)
SLOWEST = 2.3
"""Of the parameters that are shown, median settling over the bound."""


def draw(found: Mapping[str, Any], folder: Path) -> None:
    """All figures, into `folder`."""

    def side_by_side(
        name: str, count: int, size: tuple[float, float] = WIDE, **options: Any
    ) -> AbstractContextManager[Sequence[Axes]]:
        style = {"svg.hashsalt": "control", "font.size": 9.5}
        return panels(folder / f"bench_control_{name}.svg", count, size, style, **options)

    with side_by_side("time", 2, width_ratios=(3, 2)) as axes:
        over_time(found["laws"], *axes)
    with side_by_side("saturation", 3, width_ratios=(5, 4, 3)) as axes:
        over_saturation(found["saturation"], *axes)
    with side_by_side("conditions", 3, sharey=True) as axes:
        over_conditions(found["conditions"], axes)
    with side_by_side("chain", 2, (8.6, 3.9), sharey=True) as axes:
        over_depth(found["chains"], *axes)
    with side_by_side("parameters", 1, (5.8, 3.6)) as axes:
        over_parameters(found["parameters"], *axes)


def over_time(laws: Mapping[str, Any], error: Axes, share: Axes) -> None:
    """Error over time, median and middle half of all starts; and the share of starts that have settled."""
    moments, percent = np.array(laws["moments"]), np.linspace(0, 100, 21)
    soonest = laws["bounds"]["by distance"]
    error.axvspan(soonest[5], soonest[15], color=INK, alpha=0.25, linewidth=0.0)
    error.axvline(soonest[10], color=INK, linewidth=THICK)
    share.plot(soonest, percent, color=INK, linewidth=THICK)
    for name, colour in COLOUR.items():
        if name not in laws["curves"]:
            continue
        curve = np.array(laws["curves"][name])
        _band(error, moments[: len(curve)], curve.T, colour)
        times = np.array([np.nan if time is None else time for time in laws["found"][name]["times"]])
        share.plot(times, percent, color=colour, linewidth=THICK)
    _settled_line(error)
    error.set(xlim=(0.0, moments[-1]), xlabel="time since the start [s]", ylabel="formation error")
    _lengths(error, 1e-3, 60.0)
    _numbers(share, (1, 2, 5, 10, 20, 50, 100))
    share.set(ylim=(0.0, 100.5), xlabel="settled within [s]", ylabel="starts [%]")
    _label(
        error,
        (5.2, 0.0014, "lower bound", INK),
        (8.6, 0.0075, "field law", BLUE),
        (24.5, 1.3, "paper's law", RED),
        (6.2, 0.125, "proportional, gain 10", PINK),
        (9.4, 0.0295, "proportional, gain 40", GREEN),
        (6.2, 0.0555, "settled under 5 cm", INK),
    )
    _label(
        share,
        (1.05, 84.0, "lower\nbound", INK),
        (5.5, 36.0, "field law", BLUE),
        (5.5, 52.0, "gain 40", GREEN),
        (13.0, 80.0, "paper's", RED),
    )


def over_saturation(found: Mapping[str, Any], settling: Axes, rate: Axes, share: Axes) -> None:
    """Settling time, rate of convergence and share over how much faster the robots are than their leader."""
    ratios = np.array([float(ratio) for ratio in found])
    bound = np.array([[one["bound"][index] for index in (5, 10, 15)] for one in found.values()])
    _band(settling, ratios, bound.T, INK)
    for name in ("field law", "paper's law"):
        colour, cells = COLOUR[name], [one[name] for one in found.values()]
        times = [[cell["settling"][key] for key in ("q25", "median", "q75")] for cell in cells]
        _band(settling, ratios, np.array(times, dtype=float).T, colour)
        _band(rate, ratios, np.array([cell["rate"] or [np.nan] * 3 for cell in cells]).T, colour)
        shares = [100.0 * cell["share"] for cell in cells]
        _dotted(share, ratios, shares, colour)
    _dotted(share, ratios, [100.0 * one[SHIPPED.name]["share"] for one in found.values()], SKY)
    settling.set(yscale="log", ylabel="settling time [s]", ylim=(1.5, 500.0))
    settling.set_yticks((2, 5, 10, 20, 50, 100, 200, 500), ("2", "5", "10", "20", "50", "100", "200", "500"))
    settling.tick_params(axis="y", which="minor", left=False)
    rate.set(ylabel="mean rate of convergence [1/s]", ylim=(0.0, None))
    share.set(ylabel="starts that settle [%]", ylim=(0.0, 102.0))
    for axes in (settling, rate, share):
        _numbers(axes, (1, 2, 5, 10))
        axes.set(xlabel="u_max ÷ leader's speed")
    _label(settling, (2.6, 52.0, "paper's law", RED), (2.9, 6.0, "field law", BLUE))
    _label(settling, (1.5, 1.75, "lower bound", INK))
    _label(rate, (1.1, 1.35, "field law", BLUE), (2.6, 0.3, "paper's law", RED))
    _label(share, (2.0, 86.0, "paper's law", RED), (2.0, 93.0, "field law", BLUE))
    _label(share, (2.0, 73.0, "field law, with\ncollision filter", SKY))


def over_conditions(found: Mapping[str, Any], kinds: Sequence[Axes]) -> None:
    """What error remains under delay, loss and noise."""
    scales = {
        "delay": (1000.0, "age of samples [ms]"),
        "loss": (100.0, "samples lost [%]"),
        "noise": (1000.0, "noise of positions, σ [mm]"),
    }
    for axes, (kind, (scale, label)) in zip(kinds, scales.items(), strict=True):
        values = scale * np.array([float(value) for value in found[kind]])
        for name in next(iter(found[kind].values())):
            remains = np.array([max(cell[name]["rms"], LEAST) for cell in found[kind].values()])
            _dotted(axes, values, remains, COLOUR[name])
        _settled_line(axes)
        axes.set(xlabel=label, xlim=(0.0, values[-1]))
        _lengths(axes, LEAST, 2.0)
    delay, loss, noise = kinds
    delay.set(ylabel="formation error that remains")
    _label(delay, (200.0, 0.00016, "field law", BLUE), (160.0, 0.1, "paper's law", RED))
    _label(delay, (60.0, 0.65, "gain 10", PINK))
    _label(loss, (24.0, 0.0002, "field law", BLUE), (24.0, 0.0085, "paper's law", RED))
    _label(loss, (24.0, 0.145, "gain 10", PINK), (24.0, 0.034, "gain 40", GREEN))
    _label(noise, (3.0, 0.14, "gain 10", PINK), (20.6, 0.1, "paper's law", RED))
    _label(noise, (20.6, 0.06, "gain 40", GREEN), (20.6, 0.036, "field law", BLUE))
    _label(noise, (20.6, 0.021, "– gentle", SKY))


def over_depth(found: Mapping[str, Any], laws: Axes, worse: Axes) -> None:
    """Distance from the slot over hops from the leader: all laws, and the field law in worse worlds."""
    deepest = len(found["field law"])
    hops = np.arange(1, deepest + 1)
    tones = {"300 ms": RED, "30 % lost": GREEN, "TurtleBot3": BROWN}
    for name, errors in found.items():
        law, _, world = name.rpartition(", ") if name.rpartition(", ")[0] in COLOUR else (name, "", "")
        dashed = "--" if world == "100 ms" else "-"
        if world in {"", "100 ms"}:
            laws.plot(hops, errors, color=COLOUR[law], linewidth=THICK, linestyle=dashed)
        if law == "field law":
            worse.plot(hops, errors, color=tones.get(world, BLUE), linewidth=THICK, linestyle=dashed)
    for axes in (laws, worse):
        axes.set(xlabel="hops from the leader", xlim=(1, deepest))
        _lengths(axes, 2e-4, 10.0)
    laws.set(ylabel="distance from the slot, RMS")
    if deepest < 50:
        return
    _label(laws, (30.0, 3.2, "paper's law", RED), (24.0, 0.155, "gain 10", PINK))
    _label(laws, (30.0, 0.052, "gain 40", GREEN), (32.0, 0.0026, "field law", BLUE))
    _label(laws, (18.0, 0.0004, "dashed: samples 100 ms old", INK))
    _label(worse, (3.0, 4.8, "field law", INK))
    _label(worse, (50.6, 0.45, "300 ms old", RED), (50.6, 0.78, "TurtleBot3 body", BROWN))
    _label(worse, (50.6, 0.014, "100 ms old", BLUE), (50.6, 0.07, "30 % lost", GREEN))
    _label(worse, (50.6, 0.002, "perfect", BLUE))


def over_parameters(found: Mapping[str, Any], axes: Axes) -> None:
    """What settles fast against what stays calm in a rough world, for all parameters that were tried."""
    tried, bound = [one for one in found["tried"] if one["calm"]["share"] == 1.0], found["bound"]
    shipped = _places(found["tried"][:1], bound)
    axes.plot(*_places(tried, bound), "o", color=INK, alpha=0.5, markersize=4.0)
    axes.plot(*_places(front(tried), bound), "o-", color=BLUE, markersize=4.5, linewidth=1.2)
    axes.plot(*shipped, "o", color=RED, markersize=7.0)
    axes.axvline(2.0, color=INK, linewidth=0.9, linestyle=":")
    axes.set(xlabel="median settling ÷ lower bound", ylabel="error that remains in a rough world")
    axes.set(ylim=(0.016, 0.022), xlim=(1.5, SLOWEST))
    axes.set_yticks((0.016, 0.018, 0.020, 0.022), ("1.6 cm", "1.8 cm", "2.0 cm", "2.2 cm"))
    _label(axes, (2.01, 0.0217, "target", INK), (shipped[0][0] - 0.09, 0.0188, "shipped", RED))
    _label(axes, (1.75, 0.0179, "nothing tried beats these in both", BLUE))
    if beyond := sum(place > SLOWEST for place in _places(tried, bound)[0]):
        axes.text(SLOWEST, 0.0212, f"{beyond} more beyond →", color=INK, horizontalalignment="right")


def _places(tried: Sequence[Any], bound: float) -> tuple[list[float], list[float]]:
    settling = [one["calm"]["settling"]["median"] / bound for one in tried]
    return settling, [one["rough"]["rms"] for one in tried]


def _dotted(axes: Axes, x: Any, y: Any, colour: str) -> None:
    axes.plot(x, y, "o-", color=colour, linewidth=THICK, markersize=3.5, clip_on=False)


def _band(axes: Axes, x: Any, quartiles: Any, colour: str) -> None:
    """A median with its middle half."""
    axes.fill_between(x, quartiles[0], quartiles[2], color=colour, alpha=0.2, linewidth=0.0)
    axes.plot(x, quartiles[1], color=colour, linewidth=THICK)


def _settled_line(axes: Axes) -> None:
    axes.axhline(BOUND, color=INK, linewidth=0.9, linestyle=":")


def _label(axes: Axes, *labels: tuple[float, float, str, str]) -> None:
    """Words beside a curve, in its colour: where they begin, what they say."""
    for x, y, text, colour in labels:
        axes.text(x, y, text, color=colour, clip_on=False)


def _lengths(axes: Axes, low: float, high: float) -> None:
    """A logarithmic axis of lengths from `low` to `high` [m]."""
    axes.set(yscale="log", ylim=(low, high))
    shown = {length: name for length, name in LENGTHS.items() if low <= length <= high}
    axes.set_yticks(list(shown), list(shown.values()))
    axes.tick_params(axis="y", which="minor", left=False)


def _numbers(axes: Axes, ticks: Sequence[int]) -> None:
    """A logarithmic axis across with these numbers."""
    axes.set(xscale="log", xlim=(ticks[0], ticks[-1]))
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.tick_params(axis="x", which="minor", bottom=False)
