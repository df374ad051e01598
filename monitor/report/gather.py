"""Read a recording once, from the first message to the last, into the data of a report.

The metrics are the monitor's own, fed as they were fed live, so settling time and final error are those that
the monitor published. Memory is bounded for any length of the run: curves are thinned as they grow, all else
is counted. Times are by the recorder's system clock as if it had not been set since the recording began.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

import numpy as np

from formation.control.arrays import ComplexArray, FloatArray
from formation.mission.model import Mission
from formation.monitor.metrics.snapshot import RobotMetrics, Snapshot
from formation.monitor.metrics.trajectory import Placed
from formation.monitor.recording.reader import Condition, Recorded, Recording, Rerun
from formation.monitor.report.leader_terms import LeaderTerm, LeaderTerms
from formation.monitor.report.story import Activities, Activity, Story
from formation.monitor.report.thin import (
    MAX_LINE_GAP,
    Commands,
    Curves,
    Extremes,
    Measured,
    Robot,
    Samples,
)
from formation.monitor.report.traffic import Delays, Key, Latencies, Traffic
from formation.topics import CMD_VEL, ERROR
from formation.wire import Now

LOOK_PERIOD = 0.2
"""Time between two looks while no formation error was published because it was unknown [s]."""
PROGRESS_MESSAGES = 2000
"""Number of messages between two calls of progress."""
NOWHERE = complex(math.nan, math.nan)


class Paths(NamedTuple):
    """Positions of N robots at T moments, the leader first. NaN if unknown."""

    time: FloatArray
    """[s]; shape (T,)."""
    centres: ComplexArray
    """[m; world frame]; shape (T, N)."""
    points: ComplexArray
    """Control points [m; world frame]; shape (T, N)."""


@dataclass(frozen=True, slots=True)
class Run:
    """The data of a recording. Times are since `start`."""

    recording: Recording
    condition: Condition
    """What of the recording cannot be read."""
    messages: int
    begin: float
    """Arrival of the first message [s, the recorder's clock]; NaN without one."""
    end: float
    """Arrival of the last message [s, that clock as if it had not been set since]."""
    start: float
    """When the formation error was first known [s, the recorder's clock]; else the beginning."""
    snapshot: Snapshot
    """At the end: settling time and final error as the monitor published them."""
    paths: Paths
    formation: Curves
    """Formation error, and the true one [m]."""
    errors: Curves
    """Error of each follower [m]."""
    headings: Curves
    """Heading error of each follower [rad]."""
    commands: Mapping[str, Curves]
    """Forward speed [m/s] and turn rate [rad/s], by follower."""
    error: Measured
    """The formation error [m]."""
    true_error: Measured
    robots: Mapping[str, Robot]
    """The followers."""
    keys: tuple[Key, ...]
    delays: Mapping[str, Delays]
    """Arrival less stamp, by topic [s]."""
    answers: Mapping[str, Delays]
    """Odometry to command, by follower [s]."""
    story: Story
    """Events and orders."""
    leader_terms: tuple[LeaderTerm, ...]
    activities: Mapping[str, Activity]
    """Followers' times by activity."""

    @property
    def mission(self) -> Mission:
        """The mission as driven."""
        return self.recording.mission

    @property
    def duration(self) -> float:
        """From the first message to the last [s]."""
        return self.end - self.begin if self.messages else 0.0

    @property
    def truth(self) -> bool:
        """Whether any true heading is known."""
        return any(robot.heading.whole.count for robot in self.robots.values())

    @property
    def known(self) -> bool:
        """Whether the formation error was ever known."""
        return self.error.whole.count > 0


def gather(recording: Recording, progress: Callable[[int, float], None] = lambda _count, _at: None) -> Run:
    """Read all of it; `progress` gets at times the number of messages, and up to when [s]."""
    one = _Gatherer(recording.mission)
    for message in recording.messages():
        one.process_message(message)
        if one.messages % PROGRESS_MESSAGES == 0:
            progress(one.messages, message.sample.arrived)
    return one.run(recording)


class _Gatherer:
    def __init__(self, mission: Mission) -> None:
        self.messages = 0
        self._mission = mission
        self._rerun = Rerun(mission)
        self._latencies, self._traffic, self._story = Latencies(mission), Traffic(mission), Story()
        self._leader_terms, self._activities = LeaderTerms(mission), Activities(mission)
        self._commands = {CMD_VEL.key(name): Commands(mission, name) for name in mission.followers}
        count = len(mission.followers)
        self._paths = Samples(2 * (count + 1))
        self._formation, self._errors, self._headings = Extremes(2), Extremes(count), Extremes(count)
        self._error, self._true_error = Measured(), Measured()
        self._robots = {name: (Measured(), Measured()) for name in mission.followers}  # error and heading
        self._offsets = np.array(
            [0.0, *(mission.robots[name].control_point_offset for name in mission.followers)]
        )
        self._moment_tolerance = 0.5 / max(mission.robots[name].rate for name in mission.followers)
        self._begin = math.nan
        self._end = Now(0.0, 0.0)
        self._looked = self._shown = -math.inf
        self._start: float | None = None
        self._settled_at: float | None = None

    def process_message(self, message: Recorded) -> None:
        key, payload, now = message.sample.key, message.sample.payload, message.now
        rejections = self._rerun.metrics.rejections.by_key
        before = rejections[key]
        self._rerun.process_message(message)
        self.messages += 1
        if self.messages == 1:
            self._begin = now.mono
        self._end = now
        self._traffic.count_message(key, now.mono)
        if rejections[key] == before:
            self._latencies.process_message(key, payload, now.wall)
            if key in self._commands:
                self._commands[key].process_command(payload, now.mono)
        self._story.process_message(message, self._start)
        self._leader_terms.process_sample(message.sample, now.mono)
        if key == ERROR.key() or now.mono - self._looked > LOOK_PERIOD:
            self._look(now)

    def run(self, recording: Recording) -> Run:
        snapshot = self._rerun.metrics.snapshot(self._end)
        start = self._start if self._start is not None else self._begin if self.messages else 0.0
        if snapshot.settled_at is None:
            self._restart()
        count = len(self._mission.names)
        time, rows = self._paths.rows(start)
        rejected = self._rerun.metrics.rejections.by_key
        return Run(
            recording=recording,
            condition=recording.condition(),
            messages=self.messages,
            begin=self._begin,
            end=self._end.mono if self.messages else math.nan,
            start=start,
            snapshot=snapshot,
            paths=Paths(time, rows[:, :count], rows[:, count:]),
            formation=self._formation.curves(start),
            errors=self._errors.curves(start),
            headings=self._headings.curves(start),
            commands={
                name: self._commands[CMD_VEL.key(name)].curves.curves(start)
                for name in self._mission.followers
            },
            error=self._error,
            true_error=self._true_error,
            robots={
                name: Robot(error, heading, self._commands[CMD_VEL.key(name)].shares)
                for name, (error, heading) in self._robots.items()
            },
            keys=tuple(self._traffic.keys(snapshot, rejected, start, self._end.mono)),
            delays=self._latencies.by_topic,
            answers=self._latencies.answers,
            story=self._story,
            leader_terms=tuple(self._leader_terms.all),
            activities=self._activities.each,
        )

    def _look(self, now: Now) -> None:
        metrics = self._rerun.metrics
        snapshot = metrics.snapshot(now)
        self._looked = now.mono
        self._story.look(now.mono, metrics.orders)
        self._activities.look(now.mono, snapshot.robots)
        if self._start is None and snapshot.formation_error is not None and snapshot.elapsed > 0.0:
            self._start = now.mono - snapshot.elapsed
        if snapshot.settled_at is not None and snapshot.settled_at != self._settled_at:
            self._settled_at = snapshot.settled_at
            self._restart()
        compared, placed = metrics.placed(now)
        moment = (compared if placed else now.wall) - (now.wall - now.mono)
        if moment <= self._shown:
            return  # no new positions since the last look
        true_moment = metrics.placed(now, truly=True)[0]  # the true error counts if it is of the same moment
        same = snapshot.formation_error is not None and abs(true_moment - compared) < self._moment_tolerance
        true_error = snapshot.formation_error_true if same else None
        self._error.add(snapshot.formation_error)
        self._true_error.add(true_error)
        for name, (error, heading) in self._robots.items():
            error.add(snapshot.robots[name].error)
            heading.add(snapshot.robots[name].heading_error)
        if moment - self._shown > MAX_LINE_GAP and self._shown > 0.0:
            self._row(self._shown, {}, {}, (None, None))
        self._row(moment, placed, snapshot.robots, (snapshot.formation_error, true_error))
        self._shown = moment

    def _restart(self) -> None:
        """Measure anew what is measured since the formation has settled."""
        for one in (self._error, self._true_error, *chain.from_iterable(self._robots.values())):
            one.restart()

    def _row(
        self,
        moment: float,
        placed: Mapping[str, Placed],
        robots: Mapping[str, RobotMetrics],
        errors: tuple[float | None, float | None],
    ) -> None:
        """Add a row to every curve; unknown values leave a gap in the line."""
        names = self._mission.names
        points = np.array([placed[name].point if name in placed else NOWHERE for name in names])
        headings = np.array([placed[name].heading if name in placed else NOWHERE for name in names])
        self._paths.add(moment, np.concatenate([points - self._offsets * headings, points]))
        self._formation.add(moment, np.array(errors, float))
        followers = [robots.get(name) for name in self._mission.followers]
        self._errors.add(moment, np.array([one and one.error for one in followers], float))
        self._headings.add(moment, np.array([one and one.heading_error for one in followers], float))
