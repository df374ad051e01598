"""A fleet that says whatever a test wants, in the bytes of the wire."""

from __future__ import annotations

import cmath
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from formation.mission.file import load, parse, read
from formation.mission.model import Mission
from formation.monitor.core import Monitor
from formation.monitor.metrics.event import Event, from_message
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.snapshot import Snapshot
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Mode, Order
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import AgentState, AgentStatus, AnyStatus, LeaderState, LeaderStatus
from formation.protocol.status_codec import to_message
from formation.ros2.messages import LogEntry, Message, Odometry, Pose, Twist, TwistStamped, decode, encode
from formation.slots.shape import PlacedShape
from formation.topics import CMD_VEL, EVENTS, GROUND_TRUTH, ODOM, POSITION, STATUS
from formation.wire import Now, Sample

EPOCH = 1000.0
"""System clock less monotonic clock [s]: small, so that stamps are exact to far less than a nanometre."""
HEADING = cmath.rect(1.0, 0.5)
VELOCITY = 0.2 * HEADING
"""Of all robots [m/s]."""


def with_standbys() -> Mission:
    """The six robots, with two processes that may take the leader's place."""
    text, name = read("six_robots")
    return parse(f"{text}\n[standbys.spare1]\n[standbys.spare2]\n", name)


def now(mono: float) -> Now:
    return Now(mono, mono + EPOCH)


@dataclass
class Fleet:
    """Robots of the six-robot mission; each is sampled at times of its own."""

    mission: Mission = field(default_factory=lambda: load("six_robots"))
    shape: str = "hexagon"
    mode: Mode = "run"
    away: Callable[[str, float], complex] = lambda _robot, _time: 0j
    """How far off its slot a robot is [m]."""
    epoch: float = EPOCH
    """System clock when the fleet's time is 0 [s]."""
    beat: int = 0
    term: int = 1
    wants: Callable[[float], Mapping[str, Any]] = lambda _time: {}
    """What else stands in the order of a moment."""

    def phase(self, robot: str) -> float:
        """Share of a period by which this robot is sampled later than the first."""
        return 0.137 * self.mission.names.index(robot)

    def times(self, robot: str, start: float, end: float) -> Iterator[float]:
        period = 1.0 / self.mission.robots[robot].rate
        sample = 0
        while (time := start + (sample + self.phase(robot)) * period) <= end:
            yield time
            sample += 1

    def point(self, robot: str, time: float) -> complex:
        """Control point [m; world frame]."""
        slot = PlacedShape.of(self.order(time)).slot(self.mission, robot)
        return VELOCITY * time + slot + self.away(robot, time)

    def order(self, time: float) -> Order:
        wanted = {"mode": self.mode, "shape": self.shape, **self.wants(time)}
        return Order(term=self.term, beat=self.beat, **wanted)

    def pose(self, robot: str, time: float, heading: complex = HEADING, clock: float = 0.0) -> bytes:
        leads = robot == self.mission.leader
        offset = 0.0 if leads else self.mission.robots[robot].control_point_offset
        return encode(Pose(time + self.epoch + clock, self.point(robot, time) - offset * heading, heading))

    def position(self, robot: str, time: float, clock: float = 0.0) -> Sample:
        attachment = None
        if robot == self.mission.leader:
            self.beat += 1
            decoded = PositionAttachment(
                publisher_id=f"leader{self.term}", count=self.beat, order=self.order(time)
            )
            attachment = json_message.encode(decoded)
        return Sample(POSITION.key(robot), self.pose(robot, time, clock=clock), attachment, time)

    def truth(self, robot: str, time: float, turned: float = 0.0) -> Sample:
        heading = HEADING * cmath.rect(1.0, turned)
        return Sample(GROUND_TRUTH.key(robot), self.pose(robot, time, heading), None, time)

    def positions(self, start: float, end: float, *, without: str = "") -> list[Sample]:
        """Those of all robots, in order of arrival."""
        samples = [
            self.position(robot, time)
            for robot in self.mission.names
            if robot != without
            for time in self.times(robot, start, end)
        ]
        return sorted(samples, key=lambda sample: sample.arrived)


def sample_of(topic_key: str, message: Message, at: float) -> Sample:
    return Sample(topic_key, encode(message), None, at)


def odometry(robot: str, at: float, epoch: float = EPOCH) -> Sample:
    return sample_of(ODOM.key(robot), Odometry(at + epoch, 0j, HEADING, 0.0, 0.0), at)


def command(robot: str, at: float, speed: float, turn_rate: float, *, stamped: bool = False) -> Sample:
    message = TwistStamped(at + EPOCH, speed, turn_rate) if stamped else Twist(speed, turn_rate)
    return sample_of(CMD_VEL.key(robot), message, at)


def status(
    robot: str, at: float, state: str, reason: str | Reason = "", epoch: float = EPOCH, **more: Any
) -> Sample:
    """What its process says of itself; `robot1`, `leader` and `spare…` are processes that may lead."""
    why = reason if isinstance(reason, Reason) else Reason.of(Code.DETAIL, detail=reason)
    one: AnyStatus
    if robot in {"robot1", "leader"} or robot.startswith("spare"):
        one = LeaderStatus(**{"robot": robot, "state": LeaderState(state), "reason": why, **more})
    else:
        one = AgentStatus(**{"robot": robot, "state": AgentState(state), "reason": why, **more})
    return sample_of(STATUS.key(robot), to_message(one, at + epoch), at)


def receive(metrics: Metrics, samples: list[Sample]) -> None:
    for sample in samples:
        metrics.process_sample(sample, sample.arrived + EPOCH)


def received(fleet: Fleet, *samples: Sample) -> Metrics:
    """New metrics that have received these."""
    metrics = Metrics(fleet.mission)
    receive(metrics, list(samples))
    return metrics


def driven(
    fleet: Fleet,
    until: float,
    metrics: Metrics | None = None,
    since: float = 10.0,
    *,
    silent: str = "",
    gone: float = 0.0,
) -> Metrics:
    """Metrics that observed a fleet ten times a second, the robot `silent` only until `gone` [s]."""
    metrics = metrics or Metrics(fleet.mission)
    samples = [
        one
        for one in fleet.positions(since, until)
        if not silent or silent not in one.key or one.arrived <= gone
    ]
    for tick in range(1, round((until - since) * 10) + 1):
        due = [one for one in samples if one.arrived <= since + tick / 10]
        samples = samples[len(due) :]
        receive(metrics, due)
        metrics.observe(now(since + tick / 10))
    return metrics


class Watcher:
    """A monitor that is stepped fifty times a second, and the events that it reports."""

    def __init__(self, fleet: Fleet | None = None) -> None:
        self.fleet = fleet or Fleet()
        self.monitor = Monitor(self.fleet.mission)
        self.reported: list[Event] = []
        self.at = 10.0

    @property
    def seen(self) -> Snapshot:
        return self.monitor.metrics.snapshot(now(self.at))

    def run_until(self, until: float, samples: list[Sample]) -> list[Event]:
        """Pass the time until `until`; return the events of that time."""
        samples = sorted(samples, key=lambda sample: sample.arrived)
        before = len(self.reported)
        while self.at < until - 1e-9:
            self.at += 0.02
            due = [sample for sample in samples if sample.arrived <= self.at]
            samples = samples[len(due) :]
            for out in self.monitor.step(now(self.at), due):
                if out.key == EVENTS.key():
                    self.reported.append(from_message(decode(LogEntry, out.payload)))
        return self.reported[before:]

    def drive(self, until: float, *more: Sample, without: str = "") -> list[Event]:
        """As `run_until`, with the positions of all robots except `without`."""
        return self.run_until(until, [*self.fleet.positions(self.at, until, without=without), *more])


def of(events: list[Event], *kinds: str) -> list[Event]:
    return [event for event in events if event.kind in kinds]
