"""Sensors that freeze or tremble, in runs of real processes: how far do robots drive on?"""

from __future__ import annotations

import random
import subprocess
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise, product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from formation.mission.file import load
from formation.mission.file import read as read_mission
from formation.monitor.recording.reader import read
from formation.ros2.messages import Pose, decode
from formation.topics import GROUND_TRUTH
from tests.campaigns.reliability.campaign import tell
from tests.campaigns.reliability.commands import module
from tests.campaigns.reliability.part import Found, Options
from tests.campaigns.reliability.placed import dumped
from tests.campaigns.reliability.table import failures, summary, table
from tests.campaigns.reliability.trial import Try
from tests.support.sensing import FAULTS, GRACE, MISSIONS, SOURCES

TITLE = "Sensors"
BOUND, ON_THE_WAY = 0.1, 0.3
"""Longest way from `GRACE` after the fault on; shortest way after it that shows that a robot goes on [m]."""
LASTS, AFTER = 8.0, 18.0
"""How long a fault lasts, and a run after it [s]."""
ABOUT = f"""\
`formation run` of a shipped mission, with `--fault`: the sensor of a random robot freezes, or trembles around
one place, at a random moment, for {LASTS:g} s. *Driven* is the true way from {GRACE:g} s after the fault
began until it ended, by ground truth in the recording. The robot is to drive less than {100 * BOUND:g} cm,
and to go on by itself afterwards. Tries take the four missions in turn."""


class Row(NamedTuple):
    """One kind of fault of one source of positions."""

    source: str
    kind: str
    size: float

    @property
    def name(self) -> str:
        """On the command line."""
        return f"{self.source}-{self.kind}{f'-{1e6 * self.size:g}um' if self.size else ''}"

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.source} {self.kind}{f' {1e6 * self.size:g} µm' if self.size else ''}"


ROWS = tuple(Row(source, kind, size) for source, (kind, size) in product(SOURCES, FAULTS))


def run(options: Options) -> Found:
    """Try every row."""
    chosen = [row for row in ROWS if options.chosen(row.name)]
    todo = [(row, MISSIONS[number % len(MISSIONS)]) for number in range(options.tries) for row in chosen]
    with ThreadPoolExecutor(options.fields) as pool:
        tries = list(pool.map(lambda one: attempt(*one), todo))
    found = {row.name: summary(row.title, [one for one in tries if one.row == row.name]) for row in chosen}
    return {"rows": found, "well": all(not one.wrong for one in tries)}


def attempt(row: Row, mission: str) -> Try:
    """One run."""
    robot, since = random.choice(load(mission).followers), random.uniform(5.0, 15.0)
    one = Try(row.name)
    with TemporaryDirectory(prefix="sensors-") as folder:
        recording = Path(folder) / "run.mcap"
        words = [
            "run", str(_written(mission, row.source, Path(folder))), "--record", str(recording), "--json",
            "--duration", f"{since + LASTS + AFTER:.1f}", "--no-page",
            "--fault", f"{robot}:{row.kind}={row.size:g}@{since:.2f}+{LASTS:g}",
        ]  # fmt: skip
        done = subprocess.run(
            [*module("formation.deploy"), *words], capture_output=True, text=True, check=False
        )
        if not recording.exists():
            one.wrong.append(f"no recording: {done.stderr[-200:]}")
            return one
        ways = dict(_ways(recording, robot, since))
    one.figures["driven [m]"] = ways["during"]
    if ways["during"] >= BOUND:
        one.wrong.append(f"{mission}: drove {BOUND:g} m or more")
    if ways["after"] < ON_THE_WAY:
        one.wrong.append(f"{mission}: did not go on")
    tell(f"{row.name} {mission} {robot}: {100 * ways['during']:.1f} cm, then {ways['after']:.2f} m")
    return one


def _written(mission: str, source: str, folder: Path) -> Path:
    data = tomllib.loads(read_mission(mission)[0])
    data["robot"] = {**data.get("robot", {}), "localisation": source}
    path = folder / f"{mission}.toml"
    path.write_text(dumped(data), encoding="utf-8")
    return path


def _ways(recording: Path, robot: str, since: float) -> Iterator[tuple[str, float]]:
    """True way of the robot during the fault and after it [m]; the world begins with its first truth."""
    truths = [
        decode(Pose, one.sample.payload)
        for one in read(recording).messages()
        if one.sample.key == GROUND_TRUTH.key(robot)
    ]
    begin = truths[0].stamp + since
    spans: Mapping[str, tuple[float, float]] = {
        "during": (begin + GRACE, begin + LASTS),
        "after": (begin + LASTS, float("inf")),
    }
    for name, (first, last) in spans.items():
        points = [one.position for one in truths if first <= one.stamp < last]
        yield name, sum(abs(b - a) for a, b in pairwise(points))


def names() -> Sequence[str]:
    """Its rows."""
    return [row.name for row in ROWS]


def seconds(options: Options) -> float:
    """What it takes."""
    return 45.0 * len(ROWS) * options.tries / options.fields


def section(found: Found) -> str:
    """For people."""
    every = found["rows"].values()
    return f"{table(every)}\n{failures(every)}"
