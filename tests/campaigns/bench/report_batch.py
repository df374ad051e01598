"""The figures of `bench_batch` as they stand in docs/benchmarks.md."""

from __future__ import annotations

from typing import Any, NamedTuple

from tests.campaigns.figures import judged, markdown, span

OURS, ONE = "formation, many runs", "formation, one formation"
IR_SIM, ROBOTARIUM = "ir-sim", "Robotarium"
COMPARED = (OURS, ONE, IR_SIM, ROBOTARIUM)
"""Sides with a column of their own."""
PAPER, LATE = "paper law", "field law, late and lossy"
"""Many runs, calculated otherwise."""
FIGURE = "figures/bench_batch.svg"
"""Beside the document."""


class Bar(NamedTuple):
    """What a figure is to come to."""

    what: str
    path: tuple[str, ...]
    bound: float
    least: bool
    """Whether the bound is the least, not the most."""
    scale: float
    unit: str


BARS = (
    Bar("6 robots, of ir-sim's speed", ("ratio", IR_SIM, "6"), 100.0, True, 1.0, "×"),
    Bar("6 robots, of the Robotarium's speed", ("ratio", ROBOTARIUM, "6"), 50.0, True, 1.0, "×"),
    Bar("10,000 robots, speed", (OURS, "10000", "robot_steps_per_s"), 10.0, True, 1e-6, " million/s"),
    Bar("1,000,000 robots, memory", (OURS, "1000000", "peak_mib"), 2048.0, False, 1.0, " MiB"),
    Bar("1,000,000 robots, memory over 1,000 steps", ("long", "peak_mib"), 2048.0, False, 1.0, " MiB"),
)


def section(found: dict[str, Any]) -> str:
    """The section in Markdown, from what `bench_batch.measure` found."""
    parts = (_words(found), _bars(found), f"![Robot steps a second and memory]({FIGURE})\n")
    tables = (_speeds(found), _memory(found), *_variants(found), _rest(found))
    return "\n".join((*parts, *tables))


def _words(found: dict[str, Any]) -> str:
    step, sides = 1000.0 * found["step_s"], ", ".join(dict.fromkeys(found["names"].values()))
    rounds = f"about {found['seconds']:g} s each, in {found['rounds']} rounds"
    return f"""Every side steps its robots by {step:g} ms, the Robotarium's own step, in a process of its own;
one after the other on one and the same core, {rounds}: {sides}.

- **formation** simulates the closed loop: odometry, heading observer, what neighbours say over each link and
  how fast they are, the law with its integral and limits, the body, and the formation error of every run at
  every step. *Many runs* are of the six robots, from random starts; only their five followers are counted,
  also at "6". *One formation* drives ten abreast, each robot measuring the two before it.
- **ir-sim** steps differential-drive robots that circle, their command constant: no law, no figure, no
  sensors, no collisions.
- **Robotarium** does the same. It looks for collisions and draws its sensors' noise, which cannot be turned
  off.

What the peers leave undone is in their favour. On no side is making ready counted.
"""


def _bars(found: dict[str, Any]) -> str:
    rows: list[tuple[str, str, str, bool | None]] = []
    for bar in BARS:
        figure: Any = found
        for step in bar.path:
            figure = figure.get(step, {}) if figure else figure
        wanted = f"{'≥' if bar.least else '<'} {bar.bound:g}{bar.unit}"
        if not figure:
            rows.append((bar.what, "not measured", wanted, None))
            continue
        scaled = {key: bar.scale * value for key, value in figure.items()}
        met = scaled["median"] >= bar.bound if bar.least else scaled["median"] < bar.bound
        rows.append((bar.what, span(scaled, 1, bar.unit), wanted, met))
    return judged(rows)


def _speeds(found: dict[str, Any]) -> str:
    return _table(found, "million robot steps a second", "robot_steps_per_s", 1e-6, 3)


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

    def cell(side: str, size: int) -> str:
        figure = found[side].get(str(size))
        if figure is None:
            return ""
        return span({name: scale * value for name, value in figure[key].items()}, digits)

    rows = [[f"{size:,}", *(cell(side, size) for side in sides)] for size in sizes]
    return markdown([f"robots; {title}", *sides], rows)


def _variants(found: dict[str, Any]) -> tuple[str, ...]:
    others = {name: found[name] for name in (PAPER, LATE) if name in found}
    rows = [
        [
            f"{name}, {int(size):,} robots",
            span({key: 1e-6 * value for key, value in figure["robot_steps_per_s"].items()}, 2),
        ]
        for name, sizes in others.items()
        for size, figure in sizes.items()
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
