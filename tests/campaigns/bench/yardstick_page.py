"""The figures of the yardstick in Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from tests.campaigns.bench.yardstick_trials import LAW, SCENARIOS, TUNED_ON
from tests.campaigns.document import head
from tests.campaigns.figures import filled, markdown

Cell = Mapping[str, Any]
OURS = "field"
LAWS = {
    "field": "ours, `formation/control/laws/field.py`",
    "paper": "Eqs. (7)-(9) as printed, `paper.py` there",
    "proportional + feed-forward": "`proportional.py` there",
    "Robotarium": "consensus through the near-identity mapping, after the Robotarium's public simulator",
    "follower": "turns to the robot before it and keeps a distance, as turtlebot3_follower does",
    "predictive": "a quadratic program over ten intervals in each step, solved by daqp",
}
"""What each law is."""


class Kind(NamedTuple):
    """A figure in which laws are compared."""

    words: str
    scale: float
    unit: str
    least: float
    """Least difference that counts, in this unit."""


KINDS = {
    "rms": Kind("error left", 100.0, "cm", 0.05),
    "median": Kind("median settling", 1.0, "s", 0.1),
    "p95": Kind("p95 of settling", 1.0, "s", 0.1),
    "peak": Kind("peak", 100.0, "cm", 0.1),
}
LEAST_SHARE = 0.05
"""Least relative difference that counts."""

SETTING = """\
Six laws from the same {starts} random starts in ten scenarios, within the same limits and at the same
period of 20 ms. Robots are points that follow commands at once, without collision filter and ramp.
Positions come over the network; all laws but the paper's get the same filtered poses. No law knows the
leader's orders.

- **Six robots** (all lines but the chain): a hexagon with 1 m sides, two neighbours each (one robot has
  one), u_max 1.5 m/s, ω_max 1.5 rad/s, L 0.2 m, the leader at 0.2 m/s; starts within ± 3 m of the slots on
  each axis.
- *Circle*: 1 m radius. *S-curves*: quarters of it, left and right in turn. *Square*: sides of 4 m, corners
  on the spot. *Figure eight*: whole circles of 1 m. *Stop and go*: 16 s each.
- **Chain of 12**: half a metre apart in the direction of travel, one neighbour each, u_max 0.22 m/s, ω_max
  1.5 rad/s, L 0.1 m, the leader at 0.15 and 0.05 m/s, 20 s each; starts within ± 1 m.
- **Error**: |z_ij - z*_ij| of the edges of the scenario's graph. *Left* is its root mean square over edges
  and the last third of the run; the *peak* the greatest of any edge in the second half, in which the leader
  turns corners, stops and goes where its route does. Both are medians of the starts.
- **Settled**: every edge under 5 cm for 10 s; the time is when that begins. A run takes 80 s, of the chain
  120 s.
"""
CELLS = """\
In each cell: error left [cm]; median / 95th percentile of the settling time [s] of those that settle, and
in brackets the share of starts that do, where that is not all (– under half); peak error [cm].
"""
BETTER = """\
By more than 5 %, and by more than 0.5 mm left, 1 mm of peak or 0.1 s:
"""
TUNING = """\
Each law has one set of gains for all scenarios: of the six that are tried the one with the least geometric
mean of error left (at least 1 mm) × median settling time (the horizon, where under half settle) over
{tuned}, from eight other starts. For the follower the error is that of distances. By default the field law's
gain is 10 in these missions.
"""
READING = """\
## What to know when reading it

- **The predictive law** minimises the distance to where its neighbours want it, neighbours predicted at
  constant velocity, and the change of inputs; `k_p` is the number of intervals in a second, `k_i` the
  weight of the change. The unicycle is linearised along a saturated proportional motion, once in each step,
  and nothing is kept from step to step. It uses our filter of poses and our tracks of neighbours. Nothing
  is proved of it.
- **CPU time** is of the law alone, without filter and tracks: compiled as in the simulation, and in Python,
  as agents run laws. The predictive law is written in loops, for the compiler.
- **The field law knows one number more**: it cuts what it feeds forward to the leader's top speed, which
  the mission says, and weighs its neighbours by it.
- Collisions, ramps, wheels that lag and commands in steps are left out: see [benchmarks.md](benchmarks.md).
- **The follower knows no shape**: it measures only the robot before it and keeps a distance to it, so
  errors of displacement count against it in all lines but the chain. Its own measure, RMS in the last
  third:

"""
ADDING = """\
To add a law: its `Controller` and the gains to try, in `LAW` of
`tests/campaigns/bench/yardstick_trials.py`, and a line in `LAWS` of `yardstick_page.py`.
"""


def length(metres: float) -> str:
    """A length in centimetres, to the tenth of a millimetre under 10 cm."""
    value = 100.0 * metres
    return "> 1000" if value > 1000.0 else f"{value:.{2 if value < 9.995 else 0}f}"


def microseconds(time: float) -> str:
    """A time with two digits, without an exponent."""
    return f"{time:.0f}" if time >= 10.0 else f"{time:.2g}"


def words(cell: Cell) -> str:
    """One cell of the table."""
    times = f"{cell['median']:.1f} / {cell['p95']:.1f}" if cell["share"] >= 0.5 else "–"
    share = "" if cell["share"] == 1.0 else f" ({100.0 * cell['share']:.0f} %)"
    return f"{length(cell['rms'])}; {times}{share}; {length(cell['peak'])}"


def table(laws: Mapping[str, Any]) -> str:
    """Scenarios × laws, and the CPU time of a step in the last lines."""
    rows = [[name, *(words(one["cells"][name]) for one in laws.values())] for name in SCENARIOS]
    for key, name in (("compiled", "CPU time of a step, compiled [µs]"), ("python", "– in Python [µs]")):
        rows.append([name, *(microseconds(one["step"][key]) for one in laws.values())])
    return markdown(["", *laws], rows)


def better(laws: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Where another law is better than ours: scenario, law, and in what."""
    for scenario in SCENARIOS:
        ours = laws[OURS]["cells"][scenario]
        for name, one in laws.items():
            found = [_pair(key, one["cells"][scenario], ours) for key in KINDS]
            if any(found):
                yield scenario, name, ", ".join(filter(None, found))


def _pair(key: str, other: Cell, ours: Cell) -> str:
    """One figure of another law and of ours, if the other's is better; else nothing."""
    kind = KINDS[key]
    if key in {"median", "p95"} and min(other["share"], ours["share"]) < 0.5:
        return ""
    theirs, own = kind.scale * other[key], kind.scale * ours[key]
    if own - theirs < max(kind.least, LEAST_SHARE * own):
        return ""
    digits = 2 if kind.unit == "cm" else 1
    return f"{kind.words} {theirs:.{digits}f} instead of {own:.{digits}f} {kind.unit}"


def page(one: Mapping[str, Any]) -> str:
    """docs/yardstick.md."""
    laws = one["laws"]
    took = f"{one['took'] / 60.0:.0f} min"
    kept = [f"{length(cell['distance'])} cm" for cell in laws["follower"]["cells"].values()]
    parts = [
        head("The open yardstick", "yardstick", SETTING.format(starts=one["tries"])),
        f"{one['date']}, commit {one['commit']}, {one['machine']}; {took}.\n",
        f"## The table\n\n{CELLS}",
        table(laws),
        "![Error left, peak and settling time of all laws in all scenarios](figures/yardstick.svg)\n",
        f"## Where another law is better than ours\n\n{BETTER}",
        texts(["scenario", "law", "figures"], better(laws)),
        "## The laws and their gains\n",
        filled(TUNING.format(tuned=", ".join(f"*{name}*" for name in TUNED_ON))),
        texts(["law", "what", "tried", "taken"], _gains(laws)),
        READING + texts(list(SCENARIOS), [kept]),
        ADDING,
    ]
    return "\n".join(parts)


def texts(header: list[str], rows: Any) -> str:
    """A table without numbers."""
    return markdown(header, rows).replace("---:", "---")


def _gains(laws: Mapping[str, Any]) -> Iterator[list[str]]:
    for name, one in laws.items():
        tried = [
            f"{key} {', '.join(f'{value:g}' for value in some)}" for key, some in LAW[name].tried.items()
        ]
        taken = [f"{key} {value:g}" for key, value in one["gains"].items()]
        yield [name, LAWS[name], "; ".join(tried), ", ".join(taken)]
