"""Recordings made as the monitor makes them, of a fleet that does whatever a test wants."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from formation.mission.file import parse, read
from formation.monitor.core import Monitor
from formation.monitor.metrics.keys import OWN, watched
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.recording.reader import read as read_back
from formation.monitor.recording.recorder import Recorder
from formation.monitor.recording.scan import footer
from formation.monitor.report.gather import Run, gather
from formation.wire import Now, Outgoing, Sample
from tests.support.monitored import EPOCH, Fleet, command, odometry, status

PERIOD = 0.02
"""Of the monitor's loop [s]."""
START = 10.0
"""When a fleet's time begins [s]."""


def coming_in(robot: str, time: float) -> complex:
    """How far off its slot a robot is that comes into formation within seconds [m]."""
    return 0j if robot == "robot1" else 1.5 * 2.0 ** -(time - START) * (1.0 + 1.0j)


def talk(fleet: Fleet, seconds: float, *, truth: bool = True) -> list[Sample]:
    """All that a fleet says in so many seconds, in order of arrival; each arrives 2 ms after its stamp."""
    end, result = START + seconds, list[Sample]()
    for name in fleet.mission.names:
        result += [status(name, START + 0.5 * i, "run", "") for i in range(round(2.0 * seconds))]
        for time in fleet.times(name, START, end):
            result.append(fleet.position(name, time))
            if name != fleet.mission.leader:
                result += [command(name, time, 0.2, 0.1), odometry(name, time)._replace(arrived=time + 0.001)]
            if truth and name != fleet.mission.leader:
                result.append(fleet.truth(name, time, turned=0.1))
    late = [sample._replace(arrived=sample.arrived + 0.002) for sample in result]
    return sorted(late, key=lambda sample: sample.arrived)


def record(
    path: Path,
    result: Iterable[Sample],
    text: str = "",
    law: str = "field",
    clock_set: Callable[[float], float] = lambda _time: 0.0,
) -> Snapshot:
    """Record what is said, and the monitor's metrics, as its loop does; what it knows at the end.

    By `clock_set` [s] the monitor's system clock has been set until a time.
    """
    text = text or read("six_robots")[0]
    mission = parse(text, "a test")
    monitor, inbox, time = Monitor(mission), list[Sample](), START

    def at(time: float) -> Now:
        return Now(time, time + EPOCH + clock_set(time))

    with Recorder(path, mission.name, text, law, (*watched(mission), *OWN)) as recorder:

        def write(outbox: Iterable[Outgoing], moment: Now) -> None:
            for out in outbox:
                recorder.write(Sample(out.key, out.payload, out.attachment, moment.mono), moment.wall)

        def step() -> None:
            moment = at(time)
            write(monitor.watch_clock(moment), moment)
            for sample in inbox:
                recorder.write(sample, sample.arrived + EPOCH + clock_set(time))
            write(monitor.step(moment, inbox), moment)
            inbox.clear()

        for sample in result:
            while sample.arrived > time:
                step()
                time += PERIOD
            inbox.append(sample)
        step()
    return monitor.metrics.snapshot(at(time))


def gathered(path: Path) -> Run:
    return gather(read_back(path))


def run_of(folder: Path, result: Iterable[Sample], text: str = "", law: str = "field") -> Run:
    """The run of a recording in `folder` of what is said."""
    record(folder / "run.mcap", result, text, law)
    return gathered(folder / "run.mcap")


def has_end(path: Path) -> bool:
    """Whether a file was ended properly; it may be damaged before that."""
    with path.open("rb") as file:
        return footer(file) is not None
