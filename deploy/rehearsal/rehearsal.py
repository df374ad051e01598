"""One rehearsal of a mission from one seed, its verdict, and the fewest faults that break the same rule."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from formation.agent.simulated.faults import Fault
from formation.deploy.rehearsal.air import Weather
from formation.deploy.rehearsal.engine import EPOCH
from formation.deploy.rehearsal.faults import SENSORS, begins_or_ends, draw, inject, spelled
from formation.deploy.rehearsal.fleet import Fleet, WorldName
from formation.deploy.rehearsal.operator import Operator
from formation.deploy.rehearsal.rules.judge import LOOK_PERIOD, Judge, Violation
from formation.mission.model import Mission
from formation.monitor.metrics.keys import OWN, watched
from formation.monitor.process import STOP_TIMEOUT_SECONDS
from formation.monitor.recording.recorder import Recorder

START_TIME = 15.0
"""The formation need not settle before this [s]."""
SETTLE_PERIOD = 0.5
"""Period of the checks whether the formation has settled [s]."""
Progress = Callable[[float], None]


class Plan(NamedTuple):
    """What is rehearsed, the same for every seed."""

    mission: Mission
    kinds: tuple[str, ...] = ()
    """Kinds of faults that are drawn."""
    faults: tuple[Fault, ...] = ()
    """Faults of every run."""
    weather: Weather = Weather()
    """Of all links, always."""
    seconds: float = 0.0
    """Shortest run [s]."""
    world: WorldName = "kinematic"
    """Of the simulated robots."""
    signed: bool = False
    """Whether orders are signed, as where processes have certificates."""
    monitored: bool = False
    """Whether a monitor runs; the run is the same with and without it."""
    record: Path | None = None
    """File for the monitor's recording, which must not exist."""
    text: str = ""
    """The mission's file, for the recording."""


class Verdict(NamedTuple):
    """The result of one rehearsal."""

    seed: int
    faults: tuple[Fault, ...]
    violations: tuple[Violation, ...]
    settled_at: float | None
    """When the formation settled after the last fault [s]; None if it did not."""
    nearest: float
    """Least distance between two bodies [m]; infinite for one robot."""
    seconds: float
    """Rehearsed time [s]."""
    blind_path: float = 0.0
    """Longest path of a robot with a frozen or late position [m]."""

    @property
    def broken(self) -> set[str]:
        """The broken rules."""
        return {one.rule for one in self.violations}

    def as_json(self) -> dict[str, Any]:
        """The result for programs."""
        return {
            "seed": self.seed,
            "faults": [spelled(one) for one in self.faults],
            "violations": [one._asdict() for one in self.violations],
            "settled_at": self.settled_at,
            "nearest": self.nearest if self.nearest < math.inf else None,
            "seconds": self.seconds,
            "blind_path": self.blind_path,
        }


def rehearse(plan: Plan, seed: int, progress: Progress | None = None) -> Verdict:
    """Rehearse `plan` with the faults that `seed` draws."""
    return run(plan, seed, (*plan.faults, *draw(plan.mission, plan.kinds, seed)), progress)


def run(plan: Plan, seed: int, faults: Sequence[Fault], progress: Progress | None = None) -> Verdict:
    """Rehearse `plan` with `faults`, until the formation has settled or should have.

    `progress` is called with the share of the rehearsed time until the last fault that is over. Raises
    RecordingError if the recording cannot be started.
    """
    of_sensors = [one for one in faults if one.kind in SENSORS]
    fleet = Fleet(plan.mission, seed, plan.weather, of_sensors, plan.world, signed=plan.signed)
    operator = Operator(fleet)
    judge = Judge(fleet, faults, plan.weather.delay + plan.weather.jitter)
    operator.listeners.append(judge.answered)
    operator.order_listeners.append(judge.ordered)
    inject(faults, fleet, operator)
    recorder = None if plan.record is None else _recorder(plan, plan.record, seed)
    if plan.monitored or recorder is not None:
        fleet.start_monitor(recorder)
    last = max([START_TIME, plan.seconds, *map(begins_or_ends, faults)])
    forever = any(one.lasts == math.inf for one in faults)
    time, checked = 0.0, last
    while not judge.broken:
        time += LOOK_PERIOD
        fleet.engine.run(time)
        judge.look()
        if progress is not None:
            progress(min(time / last, 1.0))
        if forever and time > last + START_TIME:
            break
        if not forever and time >= checked:
            checked += SETTLE_PERIOD
            if judge.look_settled(last):
                break
    if fleet.watched is not None:
        fleet.watched.process.stop.reason = "the rehearsal ends"
        fleet.engine.run(time + STOP_TIMEOUT_SECONDS)
    if recorder is not None:
        recorder.close()
        judge.look_recorded(recorder)
    for process in fleet.processes:
        process.kill()
    return Verdict(
        seed, tuple(faults), tuple(judge.violations), judge.settled_at, judge.nearest, time, judge.blind_path
    )


def _recorder(plan: Plan, path: Path, seed: int) -> Recorder:
    """Begin the recording, with nothing in it that differs between two runs of a seed."""
    mission = plan.mission
    name = f"{mission.fingerprint}-{seed}"
    began = datetime.fromtimestamp(EPOCH, UTC).isoformat(timespec="seconds")
    # versions of Python have numpy versions of their own
    metadata = {"recording": name, "recorded_at": began, "python": "", "numpy": ""}
    keys = (*watched(mission), *OWN)
    recorder = Recorder(
        path, mission.name, plan.text, mission.law.kind, keys, metadata=metadata, in_step=True
    )
    for _ in recorder.notices():  # that it has begun, with a path
        pass
    return recorder


def shrunk(plan: Plan, verdict: Verdict) -> tuple[Fault, ...]:
    """Return the fewest of the faults of `verdict` that still break one of its rules with its seed."""
    faults = list(verdict.faults)
    for fault in verdict.faults:
        fewer = [one for one in faults if one is not fault]
        if run(plan, verdict.seed, fewer).broken & verdict.broken:
            faults = fewer
    return tuple(faults)
