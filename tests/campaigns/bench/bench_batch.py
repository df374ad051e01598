"""How fast many robots are simulated, and in how much memory, beside ir-sim and the Robotarium's simulator.

python -m tests.campaigns.bench.bench_batch [--peers FOLDER [--robotarium CHECKOUT]] [--rounds N] [--quick]
[--json]

The peers are installed into FOLDER, a virtual environment that is made if there is none; the checkout is of
github.com/robotarium/robotarium_python_simulator. In each round every size is measured on all sides, one
process after the other, all on the same one core. All step by the Robotarium's 33 ms, which it cannot change.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from tests.campaigns.bench import peers
from tests.campaigns.bench.plot_batch import draw
from tests.campaigns.bench.report_batch import IR_SIM, LATE, ONE, OURS, PAPER, ROBOTARIUM, section
from tests.campaigns.figures import flags, over_rounds, show

STEP = 0.033
"""Of every side [s]."""
SIZES = (6, 20, 100, 1_000, 10_000, 100_000, 1_000_000)
LONG = 1_000
"""Steps of one long run of the most robots, for the memory that it takes."""
PATIENCE = 120.0
"""What would take longer is left out [s]."""


class Side(NamedTuple):
    """Who is measured, and with how many robots."""

    name: str
    module: str
    sizes: tuple[int, ...]
    quick: tuple[int, ...] = ()
    """The sizes with --quick."""
    python: str = sys.executable
    plan: Mapping[str, Any] = MappingProxyType({})


FORMATION = "tests.campaigns.bench.batch_formation"
SIDES = (
    Side(OURS, FORMATION, SIZES, (6, 1_000, 10_000, 1_000_000)),
    Side(ONE, FORMATION, (100, 1_000, 10_000, 100_000), (1_000,), plan={"one_formation": True}),
    Side(PAPER, FORMATION, (10_000,), plan={"law": "paper"}),
    Side(LATE, FORMATION, (10_000,), plan={"delay": 0.1, "loss": 0.1}),
)


def peer_sides(folder: Path | None, checkout: Path | None) -> Iterator[Side]:
    """Those of the peers that were asked for."""
    if folder is None:
        return
    python = str(peers.interpreter(folder))
    yield Side(IR_SIM, "tests.campaigns.bench.batch_irsim", (6, 20, 100, 1_000, 10_000), (6, 1_000), python)
    if checkout is not None:
        plan = {"checkout": str(checkout.absolute())}
        yield Side(ROBOTARIUM, "tests.campaigns.bench.batch_robotarium", (6, 20, 50), (6,), python, plan)


def process(side: Side, robots: int, cache: Path, **plan: Any) -> dict[str, Any]:
    """What a process of its own found of a side with so many robots."""
    plan = {"robots": robots, "step": STEP, **side.plan, **plan}
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "MPLBACKEND": "Agg"}
    command = [side.python, "-m", side.module, json.dumps(plan)]
    output = subprocess.run(command, check=True, stdout=subprocess.PIPE, env=environment).stdout
    found: dict[str, Any] = json.loads(output.splitlines()[-1])  # ir-sim has more to say before
    return found


def measure(sides: Sequence[Side], rounds: int, seconds: float) -> dict[str, Any]:
    """All figures; medians over rounds with their lowest and highest."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # of those that it starts as well
    names: dict[str, str] = {}
    left_out: dict[str, str] = {}
    found: list[dict[str, dict[str, Any]]] = []
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder)
        cold = process(SIDES[0], SIZES[0], cache, seconds=seconds)
        for number in range(rounds):
            one: dict[str, dict[str, Any]] = defaultdict(dict)
            for side, size in _turns(sides, number):
                what = f"{side.name}, {size:,} robots"
                if what in left_out:
                    continue
                result = process(side, size, cache, seconds=seconds)
                names[side.name] = result.pop("name")
                if "refused" in result:
                    left_out[what] = result["refused"]
                else:
                    one[side.name][str(size)] = result
            found.append({**one, "ratio": _ratios(one)})
        medians = over_rounds(found)
        long = _long(medians, cache, left_out) if rounds > 1 else {}
    return {
        "rounds": rounds,
        "seconds": seconds,
        "step_s": STEP,
        "names": names,
        "left_out": left_out,
        "cold_first_s": cold["first_s"],
        "long": long,
        **medians,
    }


def _long(found: dict[str, Any], cache: Path, left_out: dict[str, str]) -> dict[str, Any]:
    """One long run of the most robots; nothing where it would take too long."""
    speed = found[OURS][str(SIZES[-1])]["robot_steps_per_s"]["median"]
    expected = LONG * SIZES[-1] / speed
    if expected > PATIENCE:
        left_out[f"{OURS}, {SIZES[-1]:,} robots over {LONG:,} steps"] = f"would take {expected:.0f} s"
        return {}
    result = process(SIDES[0], SIZES[-1], cache, steps=LONG)
    return {key: over_rounds([result[key]]) for key in ("robot_steps_per_s", "peak_mib")}


def _turns(sides: Sequence[Side], number: int) -> Iterator[tuple[Side, int]]:
    """Every side at every size, size by size; nobody is first in every round."""
    for size in sorted({size for side in sides for size in side.sizes}):
        there = [side for side in sides if size in side.sizes]
        begin = number % len(there)
        yield from ((side, size) for side in there[begin:] + there[:begin])


def _ratios(one: dict[str, dict[str, Any]]) -> dict[str, dict[str, float]]:
    """How many times as many robot steps a second as each peer, at every size that both have."""
    return {
        peer: {
            size: one[OURS][size]["robot_steps_per_s"] / theirs["robot_steps_per_s"]
            for size, theirs in one[peer].items()
            if size in one[OURS]
        }
        for peer in (IR_SIM, ROBOTARIUM)
        if peer in one
    }


def main() -> None:
    """Print the figures."""
    parser = flags(__doc__)
    parser.set_defaults(rounds=3)
    parser.add_argument("--peers", type=Path, metavar="FOLDER", help="their virtual environment")
    parser.add_argument("--robotarium", type=Path, metavar="CHECKOUT", help="its simulator, besides ir-sim")
    parser.add_argument("--quick", action="store_true", help="one short round of few sizes")
    parser.add_argument("--figure", type=Path, metavar="SVG", help="draw the curves into this file")
    given = parser.parse_args()
    _check(parser, given)
    sides = [*SIDES, *peer_sides(given.peers, given.robotarium)]
    if given.quick:
        sides = [side._replace(sizes=side.quick) for side in sides]
    found = measure(sides, 1 if given.quick else given.rounds, 0.2 if given.quick else 0.5)
    if given.figure:
        draw(found, given.figure)
    show(found, section, as_json=given.json)


def _check(parser: argparse.ArgumentParser, given: argparse.Namespace) -> None:
    if given.robotarium is None:
        return
    if given.peers is None:
        parser.error("--robotarium needs --peers FOLDER: that is where what it imports is installed")
    if not (given.robotarium / "rps" / "robotarium.py").is_file():
        parser.error(f"--robotarium {given.robotarium}: no rps/robotarium.py in it; must be a checkout")


if __name__ == "__main__":
    main()
