"""All benchmarks, or those that are named, into docs/benchmarks.md, its figures and benchmarks.json.

python -m tests.campaigns.bench [PART …] [--quick] [--peers FOLDER [--robotarium CHECKOUT]]

Each part is a process of its own, so that none measures what another left behind, and written as soon as it
has ended. Those that are not named keep the figures they had. Full, all take about 40 minutes, on a machine
that should have nothing else to do.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from tests.campaigns.document import DOCS, head, one_of, section, stamp, update
from tests.campaigns.figures import progress, worded

HEAD = """\
Figures are medians over rounds, in brackets the lowest and the highest round. On another machine the
milliseconds will differ; compare the ratios, whose two sides come from the same rounds.
"""
PARTS = {
    "agent": "The edge: one agent",
    "step": "One step of an agent",
    "signing": "Signed orders",
    "law": "One step of the mathematics",
    "central": "One node for all robots",
    "cost": "What a robot costs in a larger fleet",
    "startup": "Starting",
    "control": "How well it drives",
    "batch": "The simulation",
    "monitor": "The monitor: a hundred robots",
}
"""Titles. The module ``bench_NAME`` measures, has a ``section`` and, if it has figures to draw, ``draw``."""


def module(name: str) -> Any:
    """The module of a part."""
    return import_module(f"tests.campaigns.bench.bench_{name}")


def measured(name: str, more: list[str]) -> dict[str, Any]:
    """What a part finds, with when and where."""
    load, began = os.getloadavg()[0], time.monotonic()
    command = [sys.executable, "-m", f"tests.campaigns.bench.bench_{name}", "--json", *more]
    result = subprocess.run(command, check=False, stdout=subprocess.PIPE)
    if result.returncode != 0:
        raise SystemExit(result.returncode)  # why, it has said itself
    return {**stamp({"found": json.loads(result.stdout)}, 0, time.monotonic() - began), "load": load}


def document(every: Mapping[str, Any]) -> str:
    """docs/benchmarks.md."""
    sections = [
        section("bench", name, title, every[name], module(name).section(every[name]["found"]))
        for name, title in PARTS.items()
        if name in every
    ]
    return "\n".join([head("Benchmarks", "benchmarks", HEAD), *sections])


def main() -> None:
    """Run benchmarks and write what they found."""
    parser = worded(__doc__)
    words = f"of {', '.join(PARTS)}; all by default"
    parser.add_argument("part", nargs="*", metavar="PART", type=one_of(PARTS), help=words)
    parser.add_argument("--quick", action="store_true", help="short, printed only; the figures mean little")
    parser.add_argument("--peers", metavar="FOLDER", help="the virtual environment of ir-sim, for `batch`")
    parser.add_argument("--robotarium", metavar="CHECKOUT", help="of the Robotarium's simulator, for `batch`")
    given = parser.parse_args()
    peers = [f"--{name}={getattr(given, name)}" for name in ("peers", "robotarium") if getattr(given, name)]
    quick = {}
    for name in given.part or PARTS:
        progress(f"{name} …")
        one = measured(name, ["--quick"] * given.quick + peers * (name == "batch"))
        if given.quick:
            quick[name] = one
        else:
            write(name, one)
    if quick:
        print(document(quick))


def write(name: str, one: Mapping[str, Any]) -> None:
    """Put what a part found where the figures are; other parts keep theirs."""
    if draw := getattr(module(name), "draw", None):
        draw(one["found"], DOCS / "figures")
    every = update(DOCS / "benchmarks.json", {name: one}, PARTS)
    (DOCS / "benchmarks.md").write_text(document(every))


if __name__ == "__main__":
    main()
