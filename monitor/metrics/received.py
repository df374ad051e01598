"""The messages of one robot: positions, truth, command, status, and the reception of each key."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

from formation.control.zones import Zone
from formation.mission.model import Mission
from formation.monitor.metrics.attachments import PositionAttachments
from formation.monitor.metrics.candidates import ballots_of
from formation.monitor.metrics.feed import CLOCK_AGREES, Feed
from formation.monitor.metrics.keys import Watched
from formation.monitor.metrics.known import KnownError
from formation.monitor.metrics.requests import Requests
from formation.monitor.metrics.snapshot import KeyMetrics, RobotMetrics
from formation.monitor.metrics.statuses import Handler, Statuses
from formation.monitor.metrics.trajectory import Placed, Trajectory
from formation.protocol.status import AgentState, AgentStatus, CollisionMode, LeaderStatus
from formation.ros2.messages import (
    Displacement,
    Odometry,
    Pose,
    Twist,
    TwistStamped,
    decode,
)
from formation.topics import BALLOT, CMD_VEL, GROUND_TRUTH, ODOM, POSE, POSITION, RELATIVE, STATUS
from formation.wire import BadMessage, Now, Sample

MAX_STAMP_LEAD = 0.1
"""Largest lead of a sample's stamp on its arrival [s]; one further ahead would outrank all that follow."""
ZONES = {Zone.SLOW: "slowed", Zone.STOP: "blocked"}
"""By protective zone, its effect on a robot's command: a key of `snapshot.AVOIDING`."""
MOST_DEADLOCKS = 1_000_000


class Tracked(NamedTuple):
    """A robot's trajectory from one key."""

    feed: Feed
    trajectory: Trajectory

    def fresh(self, mono: float) -> bool:
        """Return whether the newest position is fresh."""
        return self.feed.fresh(mono)


class ReceivedOfRobot:
    """One robot of the mission."""

    def __init__(
        self, mission: Mission, name: str, keys: Sequence[Watched], slowest: float, requests: Requests
    ) -> None:
        """`keys` are the robot's own; `slowest` [s] is the longest silence of any robot still fresh.

        `requests` takes the operator requests in the leader's statuses.
        """
        self.name = name
        self._spec = mission.robots[name]
        self._offset = 0.0 if name == mission.leader else self._spec.control_point_offset
        self._keys = keys
        self._feeds = {one.key: Feed(one.rate) for one in keys}
        self._command: tuple[Feed, float, float] | None = None
        by_topic = {one.topic.name: self._feeds[one.key] for one in keys}
        kind = LeaderStatus if name == mission.leader else AgentStatus
        self.statuses = Statuses(kind, by_topic[STATUS.name], partial(requests.add_from_status, name))
        """The statuses of its process."""
        self._ballots = ballots_of(mission, name)
        self.attachments = PositionAttachments()
        """The attachments of its positions."""
        self.place = self._tracked(by_topic[POSITION.name], slowest)
        self.place_it = _placing(self.place, self._offset)
        """Take in one of its positions. Raises BadMessage."""
        truth = by_topic.get(GROUND_TRUTH.name)
        self.truth = self.place if truth is None else self._tracked(truth, slowest)
        """Its trajectory from ground truth; a virtual leader's is its own."""

    def routes(self) -> Iterator[tuple[str, Feed, Handler | None]]:
        """Yield key, feed and handler of every key of this robot."""
        for one in self._keys:
            feed = self._feeds[one.key]
            yield one.key, feed, self._handler(one, feed)

    def clock_was_set(self) -> None:
        """Forget moments and senders' clocks after our system clock was set."""
        for feed in self._feeds.values():
            feed.forget_clock()
        for one in (self.place, self.truth):
            one.trajectory.forget()

    def missed(self) -> int:
        """Missed periods, summed over all keys."""
        return sum(feed.missed for feed in self._feeds.values())

    def metrics(self, now: Now, error: KnownError, state: tuple[str, str] | None = None) -> RobotMetrics:
        """Return the robot's metrics now; `error` is over its own edges.

        `state` (with reason) is by default from its own status.
        """
        does, reason = state or self.statuses.state(now)
        status = self._agent(now)
        speed, turn_rate = self._commanded(now)
        return RobotMetrics(
            state=does,
            reason=reason,
            error=error.error if error.complete else None,
            known=error,
            speed=speed,
            turn_rate=turn_rate,
            speed_share=None if speed is None else abs(speed) / self._spec.max_speed,
            turn_share=None if turn_rate is None else abs(turn_rate) / self._spec.max_turn_rate,
            age=_finite(self.place.feed.silence(now.mono)),
            heading_error=self._heading_error(now),
            rate=self.place.feed.rate(now.mono),
            keys={one.key: _metrics(self._feeds[one.key], now) for one in self._keys},
            rejected_age=_finite(now.mono - max(feed.rejected for feed in self._feeds.values())),
            unavailable=self.attachments.unavailable,
            reason_code="" if status is None else str(status.reason.code),
            readonly=status is not None and status.readonly,
            stuck=status is not None and status.motion is not None,
            avoiding=_avoiding(status)
            if status is not None and does == AgentState.RUN and not status.readonly
            else "",
            deadlocks=0 if status is None else min(status.deadlocks, MOST_DEADLOCKS),
            fallback=", ".join(
                one for one in (status.follows if status else ()) if one not in self._spec.neighbours
            ),
            publishers=self.attachments.publishers,
        )

    def contests(self, now: Now) -> Iterator[str]:
        """Yield the neighbours with two publishers by this robot's newest status."""
        status = self._agent(now)
        yield from status.contested if status is not None else ()

    def forgers(self, now: Now) -> Iterator[str]:
        """Yield the robots that lately relayed forged orders to this one, by its newest status."""
        status = self.statuses.newest(now)
        yield from status.forged if status is not None else ()

    def _agent(self, now: Now) -> AgentStatus | None:
        """Return the newest status of a follower's agent; None if it is not fresh."""
        status = self.statuses.newest(now)
        return status if isinstance(status, AgentStatus) else None

    def _commanded(self, now: Now) -> tuple[float | None, float | None]:
        if self._command is None or not self._command[0].fresh(now.mono):
            return None, None
        return self._command[1:]

    def _heading_error(self, now: Now) -> float | None:
        if self.truth is self.place or not (self.place.fresh(now.mono) and self.truth.fresh(now.mono)):
            return None
        moment = min(self.place.trajectory.latest, self.truth.trajectory.latest)
        estimated, true = self.place.trajectory.at(moment), self.truth.trajectory.at(moment)
        if estimated is None or true is None:
            return None
        return cmath.phase(estimated.heading * true.heading.conjugate())

    def _handler(self, one: Watched, feed: Feed) -> Handler | None:
        """Return the handler of a key's messages; None for a key that is only counted and recorded."""
        handlers: dict[str, Handler] = {
            POSITION.name: self.place_it,
            GROUND_TRUTH.name: _placing(self.truth, self._offset),
            CMD_VEL.name: self._take_command(feed),
            STATUS.name: self.statuses.process_status,
            BALLOT.name: self._ballots,
            ODOM.name: lambda s, wall: _note(feed, decode(Odometry, s.payload).stamp, wall),
            POSE.name: lambda s, wall: _note(feed, decode(Pose, s.payload).stamp, wall),
            RELATIVE.name: lambda s, wall: _note(feed, decode(Displacement, s.payload).stamp, wall),
        }
        return handlers.get(one.topic.name)

    def _take_command(self, feed: Feed) -> Handler:
        def twist(sample: Sample, _wall: float) -> None:
            command = decode(Twist, sample.payload)
            self._command = feed, command.speed, command.turn_rate

        def stamped(sample: Sample, wall: float) -> None:
            command = decode(TwistStamped, sample.payload)
            feed.stamped(command.stamp, wall)
            self._command = feed, command.speed, command.turn_rate

        return twist if self._spec.cmd_vel == "twist" else stamped

    def _tracked(self, feed: Feed, slowest: float) -> Tracked:
        # All robots are compared at the moment that the slowest fresh robot has reached.
        samples = math.ceil(1.5 * self._spec.rate * (slowest + CLOCK_AGREES[1])) + 8
        return Tracked(feed, Trajectory(samples, feed.limit))


def _placing(tracked: Tracked, offset: float) -> Handler:
    feed, trajectory = tracked

    def process_pose(sample: Sample, wall: float) -> None:
        pose = decode(Pose, sample.payload)
        moment = feed.stamped(pose.stamp, wall)
        if moment > wall + MAX_STAMP_LEAD:
            raise BadMessage("stamp is in the future")
        trajectory.add(Placed(moment, pose.position + offset * pose.heading, pose.heading))

    return process_pose


def _note(feed: Feed, stamp: float, wall: float) -> None:
    feed.stamped(stamp, wall)


def _metrics(feed: Feed, now: Now) -> KeyMetrics:
    return KeyMetrics(
        feed.count, feed.rate(now.mono), _finite(feed.silence(now.mono)), feed.missed, feed.clock, feed.loss
    )


def _avoiding(status: AgentStatus) -> str:
    """Return the strongest limit on its law's command: a key of `snapshot.AVOIDING`, or empty."""
    avoids = "avoids" if status.avoiding and status.collisions is CollisionMode.ON else ""
    return avoids if status.zone is None else ZONES.get(status.zone, avoids)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
