"""A recording read once, from the first message to the last, into what a report shows.

The figures are the monitor's own, fed as they were fed live, so settling time and final error are those that
the monitor told. Memory is bounded, however long the run was: curves are thinned as they grow, everything
else is counted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from formation.arrays import ComplexArray, FloatArray
from formation.mission import Mission
from formation.topics import CMD_VEL, ERROR
from formation.wire import Now
from monitor.figures.events import Event
from monitor.figures.snapshot import RobotFigures, Snapshot
from monitor.figures.trajectory import Placed
from monitor.recording.reader import Recorded, Recording
from monitor.recording.rerun import Rerun
from monitor.report.doing import Doing, Doings
from monitor.report.judging import GAP, Commands, Judge, Measured, Robot
from monitor.report.latency import Late, Latencies
from monitor.report.reigns import Reign, Reigns
from monitor.report.story import Ordered, Story
from monitor.report.thin import Curves, Extremes, Samples
from monitor.report.traffic import Key, Traffic

LOOK = 0.2
"""Where no formation error was published, because it was not known, robots are looked at this often [s]."""
OFTEN = 2000
"""Messages between two signs of progress."""
NOWHERE = complex(math.nan, math.nan)


class Ways(NamedTuple):
    """Where robots were; T moments of N robots, the leader first. NaN where not known."""

    time: FloatArray
    """[s]; shape (T,)."""
    centres: ComplexArray
    """[m; world frame]; shape (T, N)."""
    points: ComplexArray
    """Control points [m; world frame]; shape (T, N)."""


@dataclass(frozen=True, slots=True)
class Run:
    """A recording, understood. Times are since `start`."""

    recording: Recording
    messages: int
    begin: float
    """Arrival of the first message [s, the recorder's clock]; NaN without one."""
    end: float
    """Arrival of the last."""
    start: float
    """When the formation error was first known [s, the recorder's clock]; else the beginning."""
    snapshot: Snapshot
    """At the end: settling time and final error as the monitor told them."""
    ways: Ways
    formation: Curves
    """Formation error, and the true one [m]."""
    errors: Curves
    """Of each follower [m]."""
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
    late: Mapping[str, Late]
    """Arrival less stamp, by topic [s]."""
    answers: Mapping[str, Late]
    """Odometry to command, by follower [s]."""
    events: tuple[Event, ...]
    untold: int
    """Events that there was no room for."""
    orders: tuple[Ordered, ...]
    reigns: tuple[Reign, ...]
    """Who led."""
    doings: Mapping[str, Doing]
    """What followers did, and how long."""
    apart: float
    """By how much the monitor's own settling time was longer when it last told it [s]; NaN: it told none."""

    @property
    def mission(self) -> Mission:
        """As it was driven."""
        return self.recording.mission

    @property
    def duration(self) -> float:
        """From the first message to the last [s]."""
        return self.end - self.begin if self.messages else 0.0

    @property
    def truth(self) -> bool:
        """Whether anything is known of true headings."""
        return any(robot.heading.whole.count for robot in self.robots.values())

    @property
    def known(self) -> bool:
        """Whether the formation error was ever known."""
        return self.error.whole.count > 0


def gather(recording: Recording, progress: Callable[[int, float], None] = lambda _count, _wall: None) -> Run:
    """Read all of it; `progress` is told now and then how many messages, and up to when [s, system clock]."""
    one = _Gatherer(recording.mission)
    for message in recording.messages():
        one.take(message)
        if one.messages % OFTEN == 0:
            progress(one.messages, message.wall)
    return one.run(recording)


class Known(NamedTuple):
    """What is known at one moment."""

    followers: Mapping[str, RobotFigures]
    errors: tuple[float | None, float | None]
    """The formation error, and the true one [m]."""


class _Gatherer:
    """Takes one message after the other."""

    def __init__(self, mission: Mission) -> None:
        self.messages = 0
        self._mission = mission
        self._rerun = Rerun(mission)
        self._late, self._traffic, self._story = Latencies(mission), Traffic(mission), Story()
        self._reigns, self._doings = Reigns(mission), Doings(mission)
        self._commands = {CMD_VEL.key(name): Commands(mission, name) for name in mission.followers}
        count = len(mission.followers)
        self._ways = Samples(2 * (count + 1))
        self._formation, self._errors, self._headings = Extremes(2), Extremes(count), Extremes(count)
        self._judges = {name: (Judge(), Judge()) for name in mission.followers}
        self._judge, self._true_judge = Judge(), Judge()
        self._offsets = np.array(
            [0.0, *(mission.robots[name].control_point_offset for name in mission.followers)]
        )
        self._same = 0.5 / max(mission.robots[name].rate for name in mission.followers)
        self._begin = self._end = math.nan
        self._looked = self._shown = -math.inf
        self._start: float | None = None
        self._settled_at: float | None = None
        self._now_settled: float | None = None

    def take(self, message: Recorded) -> None:
        key, payload, wall = message.sample.key, message.sample.payload, message.wall
        rejections = self._rerun.metrics.rejections.by_key
        before = rejections[key]
        self._rerun.take(message)
        self.messages += 1
        if self.messages == 1:
            self._begin = wall
        self._end = wall
        self._traffic.take(key, wall)
        if rejections[key] == before:
            self._late.take(key, payload, wall)
            if key in self._commands:
                self._commands[key].take(payload, wall)
        self._story.take(key, payload)
        self._reigns.take(message.sample, wall)
        self._story.check(key, payload, self._now_settled)
        if key == ERROR.key() or wall - self._looked > LOOK:
            self._look(Now(wall, wall))

    def run(self, recording: Recording) -> Run:
        end = 0.0 if math.isnan(self._end) else self._end
        snapshot = self._rerun.metrics.snapshot(Now(end, end))
        start = self._start if self._start is not None else self._begin if self.messages else 0.0
        settled = snapshot.settled_at is not None
        count = len(self._mission.names)
        time, rows = self._ways.taken(start)
        rejected = self._rerun.metrics.rejections.by_key
        return Run(
            recording=recording,
            messages=self.messages,
            begin=self._begin,
            end=self._end,
            start=start,
            snapshot=snapshot,
            ways=Ways(time, rows[:, :count], rows[:, count:]),
            formation=self._formation.curves(start),
            errors=self._errors.curves(start),
            headings=self._headings.curves(start),
            commands={
                name: self._commands[CMD_VEL.key(name)].curves.curves(start)
                for name in self._mission.followers
            },
            error=self._judge.measured(settled=settled),
            true_error=self._true_judge.measured(settled=settled),
            robots={name: self._robot(name, settled=settled) for name in self._mission.followers},
            keys=tuple(self._traffic.keys(snapshot, rejected, start, end)),
            late=self._late.by_topic,
            answers=self._late.answers,
            events=tuple(self._story.events),
            untold=self._story.untold,
            orders=tuple(self._story.orders),
            reigns=tuple(self._reigns.all),
            doings=self._doings.each,
            apart=self._story.apart,
        )

    def _robot(self, name: str, *, settled: bool) -> Robot:
        commands = self._commands[CMD_VEL.key(name)]
        error, heading = self._judges[name]
        return Robot(
            error.measured(settled=settled),
            heading.measured(settled=settled),
            commands.count,
            (commands.share(0), commands.share(1)),
        )

    def _look(self, now: Now) -> None:
        """See how everything is, as the monitor did at this moment."""
        metrics = self._rerun.metrics
        snapshot = metrics.snapshot(now)
        self._looked = now.wall
        self._story.look(now.wall, metrics)
        self._doings.look(now.wall, snapshot.robots)
        if self._start is None and snapshot.formation_error is not None and snapshot.elapsed > 0.0:
            self._start = now.wall - snapshot.elapsed
        self._now_settled = snapshot.settled_at
        if snapshot.settled_at is not None and snapshot.settled_at != self._settled_at:
            self._settled_at = snapshot.settled_at
            for judge in self._all_judges():
                judge.restart()
        moment, placed = metrics.placed(now)
        if not placed:
            moment = now.wall
        if moment <= self._shown:
            return  # nobody has moved on since the last look
        true_error = self._true_error(now, moment, snapshot)
        self._judge_all(snapshot, true_error)
        if moment - self._shown > GAP and self._shown > 0.0:
            self._row(self._shown, {}, Known({}, (None, None)))
        followers = {name: snapshot.robots[name] for name in self._mission.followers}
        self._row(moment, placed, Known(followers, (snapshot.formation_error, true_error)))
        self._shown = moment

    def _all_judges(self) -> list[Judge]:
        return [self._judge, self._true_judge, *(one for both in self._judges.values() for one in both)]

    def _true_error(self, now: Now, moment: float, snapshot: Snapshot) -> float | None:
        """The true formation error [m], if it is of the same `moment` [s] as the error that robots tell."""
        of = self._rerun.metrics.placed(now, truly=True)[0]
        same = snapshot.formation_error is not None and abs(of - moment) < self._same
        return snapshot.formation_error_true if same else None

    def _judge_all(self, snapshot: Snapshot, true_error: float | None) -> None:
        self._judge.add(snapshot.formation_error)
        self._true_judge.add(true_error)
        for name, (error, heading) in self._judges.items():
            error.add(snapshot.robots[name].error)
            heading.add(snapshot.robots[name].heading_error)

    def _row(self, moment: float, placed: Mapping[str, Placed], known: Known) -> None:
        """Add a row to every curve; what is not known leaves a gap in its line."""
        names = self._mission.names
        points = np.array([placed[name].point if name in placed else NOWHERE for name in names])
        headings = np.array([placed[name].heading if name in placed else NOWHERE for name in names])
        robots = [known.followers.get(name) for name in self._mission.followers]
        self._ways.add(moment, np.concatenate([points - self._offsets * headings, points]))
        self._formation.add(moment, [_or_nan(error) for error in known.errors])
        self._errors.add(moment, [_or_nan(robot.error if robot else None) for robot in robots])
        self._headings.add(moment, [_or_nan(robot.heading_error if robot else None) for robot in robots])


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
