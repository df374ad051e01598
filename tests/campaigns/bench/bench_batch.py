"""How fast many robots are simulated, and in how much memory, beside ir-sim and the Robotarium's simulator.

python -m tests.campaigns.bench.bench_batch [--peers FOLDER [--robotarium CHECKOUT]] [--rounds N] [--quick]
[--json]

The peers are installed into FOLDER, a virtual environment that is made if there is none; the checkout is of
github.com/robotarium/robotarium_python_simulator. In each round every size is measured on all sides, one
process after the other, all on the same one core. All step by the Robotarium's 33 ms, which it cannot change.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import tomllib
import venv
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from matplotlib.axes import Axes

from tests.campaigns.figures import Bar, at, flags, judged, markdown, over_rounds, show, span
from tests.campaigns.plots import BLUE, INK, ORANGE, panels

GROUP = "bench"
"""The dependency group in pyproject.toml that names them."""


def interpreter(folder: Path) -> Path:
    """The Python of the peers' environment in `folder`, which is made or completed where need be."""
    python = folder.absolute() / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    pyproject = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8"))
    install = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*install, *pyproject["dependency-groups"][GROUP]], check=True)
    return python


OURS, FILTERED, ONE = "formation, law alone", "formation, with filter", "formation, one formation"
IR_SIM, ROBOTARIUM = "ir-sim", "Robotarium"
COMPARED = (OURS, FILTERED, ONE, IR_SIM, ROBOTARIUM)
"""Sides with a column of their own."""
PAPER, LATE = "paper law", "field law, late and lossy"
"""Many runs, calculated otherwise."""
BARS = (
    Bar("6 robots, of ir-sim's speed", f"ratio/{IR_SIM}/6", "≥", 100.0, 1, "×"),
    Bar("6 robots, of the Robotarium's speed", f"ratio/{ROBOTARIUM}/6", "≥", 50.0, 1, "×"),
    Bar("10,000 robots, speed", f"{OURS}/10000/robot_steps_per_s", "≥", 10.0, 1, " million/s", 1e-6),
    Bar("the same with the filter", f"{FILTERED}/10000/robot_steps_per_s", "≥", 3.0, 1, " million/s", 1e-6),
    Bar("1,000,000 robots, memory", f"{OURS}/1000000/peak_mib", "<", 2048.0, 1, " MiB"),
    Bar("1,000,000 robots, memory over 1,000 steps", "long/peak_mib", "<", 2048.0, 1, " MiB"),
)


def section(found: dict[str, Any]) -> str:
    """The section in Markdown, from what `measure` found."""
    parts = (
        _words(found),
        judged(bar.row(found) for bar in BARS),
        "![Robot steps a second and memory](figures/bench_batch.svg)\n",
        _table(found, "million robot steps a second", "robot_steps_per_s", 1e-6, 3),
        _memory(found),
        *_variants(found),
        _rest(found),
    )
    return "\n".join(parts)


def _words(found: dict[str, Any]) -> str:
    step, sides = 1000.0 * found["step_s"], ", ".join(dict.fromkeys(found["names"].values()))
    rounds = f"about {found['seconds']:g} s each, in {found['rounds']} rounds"
    return f"""Every side steps its robots by {step:g} ms, the Robotarium's own step, in a process of its own;
one after the other on one and the same core, {rounds}: {sides}.

- **formation** simulates the closed loop: odometry, pose filter, what neighbours publish over each link and
  how fast they are, the law with its limits, the body, and the formation error of every run at every step.
  *Law alone* and *with filter* are many runs of the six robots, from random starts, without the collision
  filter and with it; only their five followers are counted, also at "6". *One formation* drives ten abreast,
  each robot measuring the two before it.
- **ir-sim** steps differential-drive robots that circle, their command constant: no law, no figure, no
  sensors, no collisions.
- **Robotarium** does the same. It looks for collisions and draws its sensors' noise, which cannot be turned
  off.

What the peers leave undone is in their favour. On no side is making ready counted.
"""


def _memory(found: dict[str, Any]) -> str:
    table = _table(found, "peak memory of the process [MiB]", "peak_mib", 1.0, 0)
    largest = found[OURS].get("1000000")
    if largest is None:
        return table
    each = 1024.0 * largest["peak_mib"]["median"] / 1e6
    return f"{table}\nA million robots take {each:.2f} KiB each, over {largest['steps']['median']:g} steps.\n"


def _table(found: dict[str, Any], title: str, key: str, scale: float, digits: int) -> str:
    sides = [side for side in COMPARED if side in found]
    sizes = sorted({int(size) for side in sides for size in found[side]})
    figures = [[at(found, f"{side}/{size}/{key}") for side in sides] for size in sizes]
    rows = [
        [f"{size:,}", *(span(one, digits, scale=scale) if one else "" for one in row)]
        for size, row in zip(sizes, figures, strict=True)
    ]
    return markdown([f"robots; {title}", *sides], rows)


def _variants(found: dict[str, Any]) -> tuple[str, ...]:
    rows = [
        [f"{name}, {int(size):,} robots", span(figure["robot_steps_per_s"], 2, scale=1e-6)]
        for name in (PAPER, LATE)
        for size, figure in found.get(name, {}).items()
    ]
    return (markdown(["many runs; million robot steps a second", ""], rows),) if rows else ()


def _rest(found: dict[str, Any]) -> str:
    ours = found[OURS]
    words = (
        f"The first simulation of a process takes {ours['6']['first_s']['median']:.2f} s, and "
        f"{found['cold_first_s']:.1f} s where nothing has been compiled yet.\n"
    )
    if "1000000" in ours:
        million = ours["1000000"]["first_s"]["median"]
        words += f"With a million robots it takes {million:.1f} s, two steps among them.\n"
    left_out = [f"- {what}: {why}\n" for what, why in found["left_out"].items()]
    return words + ("\nLeft out:\n\n" + "".join(left_out) if left_out else "")


LINES = {
    OURS: (BLUE, "-", "law alone"),
    FILTERED: (BLUE, ":", "with filter"),
    ONE: (BLUE, "--", "one formation"),
    IR_SIM: (ORANGE, "-", "ir-sim"),
    ROBOTARIUM: (INK, "-", "Robotarium"),
}
"""Colour, stroke and label of each side."""


def draw(found: Mapping[str, Any], folder: Path) -> None:
    """Robot steps a second, and memory per robot, against robots."""
    with panels(folder / "bench_batch.svg", 2, style={"svg.hashsalt": "bench"}) as (speed, memory):
        _curves(speed, found, "robot_steps_per_s", "robot steps a second")
        _curves(memory, found, "peak_mib", "memory of the process per robot [KiB]")


def _curves(axes: Axes, found: Mapping[str, Any], key: str, label: str) -> None:
    """A curve for each side."""
    for side, (colour, stroke, name) in LINES.items():
        if side not in found or (side == FILTERED and key == "peak_mib"):  # the memory of the law alone
            continue
        sizes = sorted(int(size) for size in found[side])
        heights = [found[side][str(size)][key]["median"] for size in sizes]
        if key == "peak_mib":
            heights = [1024.0 * height / size for height, size in zip(heights, sizes, strict=True)]
        axes.plot(sizes, heights, stroke, color=colour, marker="o", markersize=3.0, linewidth=1.5)
        aside = (5, 0) if side != ONE else (-10, 12)
        axes.annotate(
            name, (sizes[-1], heights[-1]), aside, textcoords="offset points", color=colour, va="center"
        )
    axes.set(xscale="log", yscale="log", xlabel="robots", ylabel=label)
    axes.minorticks_off()
    axes.margins(x=0.12)


STEP = 0.033
"""Of every side [s]."""
SIZES = (6, 20, 100, 1_000, 10_000, 100_000, 1_000_000)
LONG = 1_000
"""Steps of one long run of the most robots, for the memory that it takes."""
PATIENCE = 120.0
"""What would take longer is left out [s]."""


class Side(NamedTuple):
    """The programs that are measured, and with how many robots."""

    name: str
    side: str
    """Of `batch_side`."""
    sizes: tuple[int, ...]
    quick: tuple[int, ...] = ()
    """The sizes with --quick."""
    python: str = sys.executable
    plan: Mapping[str, Any] = MappingProxyType({})


FORMATION = "formation"
SIDES = (
    Side(OURS, FORMATION, SIZES, (6, 1_000, 10_000, 1_000_000), plan={"avoid": False}),
    Side(FILTERED, FORMATION, SIZES[:5], (6, 10_000)),
    Side(ONE, FORMATION, (100, 1_000, 10_000, 100_000), (1_000,), plan={"one_formation": True}),
    Side(PAPER, FORMATION, (10_000,), plan={"law": "paper"}),
    Side(LATE, FORMATION, (10_000,), plan={"avoid": False, "delay": 0.1, "loss": 0.1}),
)


def peer_sides(folder: Path | None, checkout: Path | None) -> Iterator[Side]:
    """Those of the peers that were asked for."""
    if folder is None:
        return
    python = str(interpreter(folder))
    yield Side(IR_SIM, "irsim", (6, 20, 100, 1_000, 10_000), (6, 1_000), python)
    if checkout is not None:
        plan = {"checkout": str(checkout.absolute())}
        yield Side(ROBOTARIUM, "robotarium", (6, 20, 50), (6,), python, plan)


def process(side: Side, robots: int, cache: Path, **plan: Any) -> dict[str, Any]:
    """What a process of its own found of a side with so many robots."""
    plan = {"robots": robots, "step": STEP, **side.plan, **plan}
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "MPLBACKEND": "Agg"}
    command = [side.python, "-m", "tests.campaigns.bench.batch_side", side.side, json.dumps(plan)]
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
        cold = process(SIDES[0], SIZES[0], cache, seconds=seconds)["first_s"]
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
    setting = {"rounds": rounds, "seconds": seconds, "step_s": STEP, "names": names, "left_out": left_out}
    return {**setting, "cold_first_s": cold, "long": long, **medians}


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
    """Every side at every size, size by size; none is first in every round."""
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
    parser = flags(__doc__, rounds=3)
    parser.add_argument("--peers", type=Path, metavar="FOLDER", help="their virtual environment")
    parser.add_argument("--robotarium", type=Path, metavar="CHECKOUT", help="its simulator, besides ir-sim")
    given = parser.parse_args()
    if given.robotarium and given.peers is None:
        parser.error("--robotarium needs --peers FOLDER: that is where what it imports is installed")
    if given.robotarium and not (given.robotarium / "rps" / "robotarium.py").is_file():
        parser.error(f"--robotarium {given.robotarium}: no rps/robotarium.py in it; must be a checkout")
    sides = [*SIDES, *peer_sides(given.peers, given.robotarium)]
    if given.quick:
        sides = [side._replace(sizes=side.quick) for side in sides]
    found = measure(sides, *((1, 0.2) if given.quick else (given.rounds, 0.5)))
    show(found, section, as_json=given.json)


if __name__ == "__main__":
    main()
