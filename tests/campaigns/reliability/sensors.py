"""Sensors that freeze, tremble or are late, in runs of real processes: how far do robots drive on?"""

from __future__ import annotations

import random
import subprocess
import tomllib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise, product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import tomlkit

from formation.agent.simulated.faults import Fault
from formation.deploy.rehearsal.rules.blind import MAX_BLIND_PATH, blind_faults
from formation.mission.file import load
from formation.mission.file import read as read_mission
from formation.mission.model import Mission
from formation.monitor.recording.reader import read
from formation.ros2.messages import Pose, decode
from formation.topics import GROUND_TRUTH
from tests.campaigns.document import Found
from tests.campaigns.reliability.campaign import Options, summaries, tell
from tests.campaigns.reliability.fleet import module
from tests.campaigns.reliability.trial import Try
from tests.support.sensing import FAULTS, GRACE, MISSIONS, SOURCES

TITLE = "Sensors"
ON_THE_WAY = 0.05  # shortest way after a fault that shows that a robot goes on [m]
FIRST, LASTS, AFTER = 8.0, 6.0, 14.0  # first fault of a run, length of each fault, time after it [s]
MOMENT = 2.0  # a fault begins at any moment of so long [s]
ABOUT = f"""\
`formation run` of a shipped mission, with `--fault`: the sensor of a random robot freezes, trembles around
one place, or is late, at a random moment, for {LASTS:g} s; every kind of fault once in each run, in random
order, {AFTER:g} s apart. *Driven* is the true way from {GRACE:g} s after the robot first drove with the fault
until that ended, by ground truth in the recording; late positions count where they are older than the robot
must bear. The robot is to drive less than {100 * MAX_BLIND_PATH:g} cm, and to go on by itself afterwards.
Runs take the four missions in turn."""


class Row(NamedTuple):
    """One kind of fault of one source of positions."""

    source: str
    kind: str
    size: float

    @property
    def name(self) -> str:
        """On the command line."""
        return self.title.replace(" ", "-")

    @property
    def title(self) -> str:
        return f"{self.source} {self.kind}{f' {self.size:g}' if self.size else ''}"


ROWS = tuple(Row(source, kind, size) for source, (kind, size) in product(SOURCES, FAULTS))
NAMES = [row.name for row in ROWS]


def run(options: Options) -> Found:
    """Try every row."""
    chosen = [row for row in ROWS if options.chosen(row.name)]
    todo = [
        (MISSIONS[number % len(MISSIONS)], source, [row for row in chosen if row.source == source])
        for number in range(options.tries)
        for source in SOURCES
    ]
    with ThreadPoolExecutor(options.fields) as pool:
        tries = [one for tried in pool.map(lambda run: attempts(*run), todo) for one in tried]
    return summaries({row.name: row.title for row in chosen}, tries)


def attempts(mission: str, source: str, rows: Sequence[Row]) -> list[Try]:
    """One run with each of `rows`, in random order."""
    order = random.sample(rows, len(rows))
    spans = [FIRST + number * (LASTS + AFTER) + random.uniform(0.0, MOMENT) for number in range(len(order))]
    with TemporaryDirectory(prefix="sensors-") as folder:
        file, recording = _written(mission, source, Path(folder)), Path(folder) / "run.mcap"
        driven = load(file)
        faults = [
            Fault(random.choice(driven.followers), row.kind, row.size, round(since, 2), LASTS)
            for row, since in zip(order, spans, strict=True)
        ]
        words = ["run", str(file), "--record", str(recording), "--json", "--no-page"]
        words += ["--duration", f"{FIRST + len(order) * (LASTS + AFTER):.1f}"]
        for one in faults:
            words += ["--fault", f"{one.robot}:{one.kind}={one.size:g}@{one.since:g}+{LASTS:g}"]
        command = [*module("formation.deploy"), *words]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        tries = [Try(row.name) for row in order]
        if not recording.exists():
            tries[0].wrong.append(f"no recording: {done.stderr[-200:]}")
            return tries[:1]
        for tried, fault in zip(tries, faults, strict=True):
            _judge(tried, mission, driven, fault, recording)
    return tries


def _judge(one: Try, name: str, mission: Mission, fault: Fault, recording: Path) -> None:
    truths = _truths(recording, fault.robot)
    end = fault.since + fault.lasts
    (blind,) = blind_faults(mission, [fault])
    for moment, place in truths:
        blind.drove_on(place, moment)
    after = [place for moment, place in truths if end <= moment < end + AFTER]
    way = sum(abs(b - a) for a, b in pairwise(after))
    one.figures["driven [m]"] = blind.path
    if blind.path >= MAX_BLIND_PATH:
        one.wrong.append(f"{name}: drove {MAX_BLIND_PATH:g} m or more")
    if way < ON_THE_WAY:
        one.wrong.append(f"{name}: did not go on")
    tell(f"{one.row} {name} {fault.robot}: {100 * blind.path:.1f} cm, then {way:.2f} m")


def _written(mission: str, source: str, folder: Path) -> Path:
    data = tomllib.loads(read_mission(mission)[0])
    data["robot"] = {**data.get("robot", {}), "localisation": source}
    path = folder / f"{mission}.toml"
    path.write_text(tomlkit.dumps(data), encoding="utf-8")
    return path


def _truths(recording: Path, robot: str) -> list[tuple[float, complex]]:
    """True places of the robot [m], by time since its world began [s]."""
    truths = [
        decode(Pose, one.sample.payload)
        for one in read(recording).messages()
        if one.sample.key == GROUND_TRUTH.key(robot)
    ]
    return [(one.stamp - truths[0].stamp, one.position) for one in truths]
