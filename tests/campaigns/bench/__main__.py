"""All benchmarks, or those that are named, into docs/benchmarks.md, its figures and benchmarks.json.

python -m tests.campaigns.bench [PART …] [--quick] [--peers FOLDER [--robotarium CHECKOUT]]

Each part is a process of its own, so that none measures what another left behind, and written as soon as it
has ended. Those that are not named keep the figures they had. Full, all take about 40 minutes, on a machine
that should have nothing else to do.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tests.campaigns.bench import (
    bench_agent,
    bench_batch,
    bench_central,
    bench_control,
    bench_cost,
    bench_law,
    bench_monitor,
    bench_signing,
    bench_startup,
    bench_step,
    control_curves,
)
from tests.campaigns.document import DOCS, head, one_of, section, stamp, update

JSON, TEXT = "benchmarks.json", "benchmarks.md"
HEAD = """\
Figures are medians over rounds, in brackets the lowest and the highest round. On another machine the
milliseconds will differ; compare the ratios, whose two sides come from the same rounds.
"""


class Part(NamedTuple):
    """One benchmark."""

    title: str
    module: Any
    quick: tuple[str, ...] = ("--quick",)
    draw: Callable[[Any, Path], None] | None = None
    """Puts its curves into a folder."""


PARTS = {
    "agent": Part("The edge: one agent", bench_agent, draw=bench_agent.draw),
    "step": Part("One step of an agent", bench_step, ("--rounds", "1")),
    "signing": Part("Signed orders", bench_signing, ("--rounds", "1")),
    "law": Part("One step of the mathematics", bench_law, ("--rounds", "1")),
    "central": Part("One node for all robots", bench_central, draw=bench_central.draw),
    "cost": Part("What a robot costs in a larger fleet", bench_cost, draw=bench_cost.draw),
    "startup": Part("Starting", bench_startup),
    "control": Part("How well it drives", bench_control, draw=control_curves.draw),
    "batch": Part(
        "The simulation", bench_batch, draw=lambda found, to: bench_batch.draw(found, to / "bench_batch.svg")
    ),
    "monitor": Part(
        "The monitor: a hundred robots",
        bench_monitor,
        ("--rounds", "1", "--seconds", "5", "--step-seconds", "5"),
    ),
}


def measured(part: Part, more: tuple[str, ...]) -> dict[str, Any]:
    """What a part finds, with when and where."""
    load, began = os.getloadavg()[0], time.monotonic()
    command = [sys.executable, "-m", part.module.__name__, "--json", *more]
    result = subprocess.run(command, check=False, stdout=subprocess.PIPE)
    if result.returncode != 0:
        raise SystemExit(result.returncode)  # why, it has said itself
    stamped = stamp({"found": json.loads(result.stdout)}, 0, time.monotonic() - began)
    return {**stamped, "load": load}


def document(every: Mapping[str, Any]) -> str:
    """docs/benchmarks.md."""
    sections = [
        section("bench", name, part.title, every[name], part.module.section(every[name]["found"]))
        for name, part in PARTS.items()
        if name in every
    ]
    return "\n".join([head("Benchmarks", "benchmarks", HEAD), *sections])


def main() -> None:
    """Run benchmarks and write what they found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "part",
        nargs="*",
        metavar="PART",
        type=one_of(PARTS),
        help=f"of {', '.join(PARTS)}; all by default",
    )
    parser.add_argument("--quick", action="store_true", help="short, printed only; the figures mean little")
    parser.add_argument("--peers", metavar="FOLDER", help="the virtual environment of ir-sim, for `batch`")
    parser.add_argument("--robotarium", metavar="CHECKOUT", help="of the Robotarium's simulator, for `batch`")
    given = parser.parse_args()
    peers = [f"--{name}={getattr(given, name)}" for name in ("peers", "robotarium") if getattr(given, name)]
    quick = {}
    for name in given.part or PARTS:
        print(f"{name} …", file=sys.stderr)
        part = PARTS[name]
        one = measured(part, (*(part.quick if given.quick else ()), *(peers if name == "batch" else ())))
        if given.quick:
            quick[name] = one
        else:
            write(name, one)
    if quick:
        print(document(quick))


def write(name: str, one: Mapping[str, Any]) -> None:
    """Put what a part found where the figures are; other parts keep theirs."""
    if draw := PARTS[name].draw:
        draw(one["found"], DOCS / "figures")
    (DOCS / TEXT).write_text(document(update(DOCS / JSON, {name: one}, PARTS)))


if __name__ == "__main__":
    main()
