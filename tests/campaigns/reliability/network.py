"""Lost and late packets: how well, and how soon, the same fleet stands in formation."""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from tests.campaigns.document import Found
from tests.campaigns.parts import table
from tests.campaigns.plots import BLUE, ORANGE, panels
from tests.campaigns.reliability import judge
from tests.campaigns.reliability.campaign import Options, span, tell
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.judge import middle
from tests.campaigns.reliability.missions import STRAIGHT

TITLE = "Network"
CONDITIONS = "figures/reliability_network.svg"
MISSION = "patrol"
ROBOT = {
    "control_point_offset": 0.1, "max_speed": 0.8, "max_turn_rate": 2.0,
    "radius": 0.1, "rate": 10.0, "ramp": 0.5,
}  # fmt: skip
CHANGES = {**STRAIGHT, "turning": False, "takeover": 6.0, "robot": ROBOT}
"""For bad air: three periods are 0.3 s then, and a leader's lease outlives some rounds that are lost.

All drive the same, however long it takes to converge.
"""
AS_SHIPPED = {**STRAIGHT, "turning": False}  # as the mission ships: TCP alone, 20 Hz, a lease of 1 s
LONGEST = 90.0  # for the formation to stand, from the moment that all robots are seen [s]
HELD = 10.0  # how long the error is looked at from then on [s]
ABOUT = """\
A new fleet for each try, from the mission's own starts; as soon as all have found each other, every packet
that arrives at any computer is lost with the probability given (nft, `numgen random`), and all take so much
longer on their way (an access point in Python, because this kernel has no `netem`; loss comes on top, and
hits what has waited). Robots talk to their own agents on their own computers, which no radio loses. The
fleet is set up for bad air, also in the loss-free run: beside each TCP link one by UDP for what may be lost
(`-e udp/…?rel=0`, `--cfg transport/unicast/max_links:2`), a lease of 10 s, a rate of 10 Hz and
`takeover = 6`. *As shipped* is TCP alone, 20 Hz, a lease and a `takeover` of 1 s: there what is lost comes
seconds later and holds up what follows, links are given up, and another candidate takes over. *Converges* is
from the first moment at which all robots are received until the error stays under 2 cm; *settled* is the
error in the 10 s after that, or in the last 10 of 90 s, median and worst over all tries."""


class Cell(NamedTuple):
    """One condition."""

    name: str
    loss: float  # probability
    delay: float = 0.0  # one way [s]
    must: bool = True  # whether the formation has to converge
    shipped: bool = False  # whether the fleet is set up as its mission ships, and not for bad air


CELLS = (
    Cell("none", 0.0),
    Cell("loss1", 0.01),
    Cell("loss10", 0.10),
    Cell("loss30", 0.30),
    Cell("loss50", 0.50, must=False),
    Cell("delay20", 0.0, 0.02),
    Cell("delay100", 0.0, 0.10),
    Cell("delay300", 0.0, 0.30),
    Cell("both", 0.30, 0.10),
    Cell("tcp-none", 0.0, shipped=True),
    Cell("tcp-loss1", 0.01, shipped=True),
    Cell("tcp-loss10", 0.10, must=False, shipped=True),
    Cell("tcp-loss30", 0.30, must=False, shipped=True),
    Cell("tcp-delay100", 0.0, 0.10, must=False, shipped=True),
)
NAMES = [cell.name for cell in CELLS]


def run(options: Options) -> Found:
    chosen = [cell for cell in CELLS if options.chosen(cell.name)]
    results: dict[str, list[dict[str, Any]]] = {cell.name: [] for cell in chosen}
    todo = chosen * max(1, options.tries // 7)  # a fleet of its own each time, so not as often as a fault
    with ThreadPoolExecutor(options.fields) as pool:
        for cell, one in zip(todo, pool.map(_tried, todo), strict=True):
            results[cell.name].append(one)
    cells = {cell.name: _summary(cell, results[cell.name]) for cell in chosen}
    return {"cells": cells, "well": all(cell["well"] == cell["tries"] for cell in cells.values())}


def section(found: Found) -> str:
    cells = found["cells"]
    free = [cells.get(name, {}).get("settled") for name in ("none", "tcp-none")]
    header = (
        "set up | lost | delay | converges | in | settled error | of the loss-free | largest command | jump"
    )
    rows = [
        f"{'as shipped' if cell['shipped'] else 'for bad air'} | {100 * cell['loss']:g} % | "
        f"{1000 * cell['delay']:g} ms | {cell['converged']} of {cell['tries']} | "
        f"{span(cell['converges'], 's', 1) or 'never'} | {span(cell['settled'], 'mm', 1, 1000.0)} | "
        f"{_ratio(cell['settled'], free[cell['shipped']])} | {100 * cell['peak']:.0f} % | "
        f"{100 * cell['jump']:.0f} %"
        for cell in cells.values()
    ]
    wrong = sorted({word for cell in cells.values() for word in cell["wrong"]})
    picture = f"\n![Settled error and time to converge, by loss and delay]({CONDITIONS})\n"
    return table(header, rows) + picture + "".join(f"\n- {word}" for word in wrong) + "\n"


def draw(found: Found, docs: Path) -> None:
    """Settled error of every condition, median and worst, and the time that it took to converge."""
    names = [_words(cell) for cell in found["cells"].values()]
    places = range(len(names))
    with panels(docs / CONDITIONS, 2, (7.0, 3.4), sharey=True) as (error, duration):
        for axes, key, scale, label in (
            (error, "settled", 1000.0, "settled error [mm]"),
            (duration, "converges", 1.0, "converges in [s]"),
        ):
            for place, cell in zip(places, found["cells"].values(), strict=True):
                if (figure := cell[key]) is None:
                    axes.text(0.0, place, " never", color=ORANGE, verticalalignment="center")
                    continue
                centre, worst = scale * figure["median"], scale * figure["worst"]
                axes.plot([centre, worst], [place, place], color=BLUE, alpha=0.5, linewidth=2.0)
                axes.plot([centre], [place], "o", color=BLUE, markersize=5.0)
            axes.set_xlabel(label)
            axes.set_xlim(left=0.0)
        error.set_xscale("symlog", linthresh=1.0)
        error.axvline(1000.0 * judge.NEAR, color=ORANGE, linewidth=1.0, linestyle="--")
        error.set_yticks(places, names)
        error.invert_yaxis()


def _words(cell: Mapping[str, Any]) -> str:
    parts = [f"{100 * cell['loss']:g} % lost"] if cell["loss"] else []
    parts += [f"{1000 * cell['delay']:g} ms"] if cell["delay"] else []
    return ("TCP: " if cell.get("shipped") else "") + (", ".join(parts) or "as it is")


def _ratio(settled: dict[str, float], free: dict[str, float] | None) -> str:
    return f"{settled['median'] / free['median']:.1f}×" if free else ""


def _tried(cell: Cell) -> dict[str, Any]:
    changes = AS_SHIPPED if cell.shipped else CHANGES
    with (
        TemporaryDirectory(prefix="reliability-") as folder,
        Fleet(MISSION, Path(folder), changes, lossy=not cell.shipped) as fleet,
    ):
        fleet.begin()
        if cell.delay:
            fleet.delay(cell.delay)
        if cell.loss:
            fleet.lose(cell.loss)
        one = _watched(fleet, cell)
    tell(f"{cell.name}: {one}")
    return one


def _watched(fleet: Fleet, cell: Cell) -> dict[str, Any]:
    begin = time.monotonic()
    fleet.settles(LONGEST, since=begin)
    times = judge.grid(begin, fleet.seen.now)
    settled = judge.settled_at(times, fleet.seen.errors(times))
    if settled is not None:
        time.sleep(max(0.0, settled + HELD - time.monotonic()))
    fleet.seen.read_on()
    end = fleet.seen.now
    start = end - HELD if settled is None else settled
    errors = fleet.seen.errors(judge.grid(start, min(end, start + HELD)))
    motion = judge.motion(fleet.seen, begin)
    wrong = [*judge.faults(motion), *(f"{name} ended" for name in fleet.lost())]
    if settled is None and cell.must:
        wrong.append("did not converge")
    return {
        "converges": None if settled is None else settled - begin,
        "settled": float(np.median(errors)),
        "worst": float(errors.max()),
        "peak": motion.peak,
        "jump": motion.jump,
        "wrong": wrong,
    }


def _summary(cell: Cell, tries: list[dict[str, Any]]) -> dict[str, Any]:
    converged = [one["converges"] for one in tries if one["converges"] is not None]
    settled = float(np.median([one["settled"] for one in tries]))
    return {
        "loss": cell.loss,
        "delay": cell.delay,
        "shipped": cell.shipped,
        "tries": len(tries),
        "well": sum(not one["wrong"] for one in tries),
        "converged": len(converged),
        "converges": middle(converged),
        "settled": {"median": settled, "worst": max(one["worst"] for one in tries)},
        "peak": max(one["peak"] for one in tries),
        "jump": max(one["jump"] for one in tries),
        "wrong": [f"{cell.name}: {word}" for one in tries for word in one["wrong"]],
    }
