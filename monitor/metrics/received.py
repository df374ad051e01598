"""The messages of one robot: positions, truth, command, status, and the reception of each key."""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from formation.control.zones import Zone
from formation.mission.model import Mission
from formation.monitor.metrics.feed import CLOCK_AGREES, Feed, finite
from formation.monitor.metrics.keys import Watched
from formation.monitor.metrics.settling import KnownError
from formation.monitor.metrics.snapshot import KeyMetrics, RobotMetrics
from formation.monitor.metrics.statuses import Handler, Requests, Statuses
from formation.monitor.metrics.trajectory import Placed, Trajectory
from formation.protocol import json_message
from formation.protocol.attachment import Ballot, PositionAttachment
from formation.protocol.election import check_ballot
from formation.protocol.status import AgentState, AgentStatus, CollisionMode, LeaderStatus
from formation.ros2.messages import Displacement, Odometry, Pose, Text, Twist, TwistStamped, decode
from formation.topics import BALLOT, CMD_VEL, GROUND_TRUTH, ODOM, POSE, POSITION, RELATIVE, STATUS, Topic
from formation.wire import BadMessage, Now, Sample

UNAVAILABLE = b'"unavailable":true'
"""As `formation.protocol.json_message.encode` writes it; left out if false."""
MAX_PUBLISHER_IDS = 16
"""Number of publisher ids that are remembered."""
MIN_RETURNS = 4
"""Number of returns of earlier publishers within `ALTERNATION_TIME` from which on a robot has two."""
ALTERNATION_TIME = 2.0
"""[s]"""
MAX_STAMP_LEAD = 0.1
"""Largest lead of a sample's stamp on its arrival [s]; one further ahead would outrank all that follow."""
ZONES = {Zone.SLOW: "slowed", Zone.STOP: "blocked"}
"""By protective zone, its effect on a robot's command: a key of `snapshot.AVOIDING`."""
STAMPED: dict[Topic, type[Odometry | Pose | Displacement]] = {
    ODOM: Odometry, POSE: Pose, RELATIVE: Displacement,
}  # fmt: skip
"""Messages of which only the stamp is read."""
MAX_DEADLOCKS = 1_000_000
"""Largest number of deadlocks that is believed."""


class PositionAttachments:
    """What one robot's position attachments contain."""

    def __init__(self) -> None:
        self.unavailable = False
        """Whether it is unavailable: it does not follow, or not closely yet."""
        self.publishers = 0
        """Number of publishers so far; each start is another."""
        self._head: tuple[bytes, bool] | None = None
        self._newest = ""  # publisher id
        self._known: dict[str, float] = {}  # when each was replaced by another [s, monotonic]
        self._returned: deque[float] = deque(maxlen=MIN_RETURNS)  # when one came back soon [s, monotonic]

    def contested(self, mono: float) -> bool:
        """Return whether publishers alternate: a process that ended does not come back."""
        returned = self._returned
        return len(returned) == MIN_RETURNS and mono - returned[0] < ALTERNATION_TIME

    def process_attachment(self, attachment: bytes, arrived: float) -> None:
        """Take in one attachment that arrived at `arrived` [s, monotonic]. Raises BadMessage."""
        head = attachment.partition(b",")[0], UNAVAILABLE in attachment
        if head == self._head:
            return
        decoded = json_message.decode(PositionAttachment, attachment)
        self._head, self.unavailable = head, decoded.unavailable
        before, self._newest = self._newest, decoded.publisher_id
        if before == self._newest:
            return
        if before:
            self._known[before] = arrived
        if self._newest in self._known:
            if arrived - self._known[self._newest] < ALTERNATION_TIME:
                self._returned.append(arrived)
            return
        self.publishers += 1
        self._known[self._newest] = -math.inf
        if len(self._known) > MAX_PUBLISHER_IDS:
            self._known.pop(next(iter(self._known)))


class Tracked(NamedTuple):
    """A robot's trajectory from one key."""

    feed: Feed
    trajectory: Trajectory


class Received:
    """The messages of one process: those of a standby, or of a robot with its agent."""

    def __init__(self, mission: Mission, name: str, keys: Sequence[Watched], requests: Requests) -> None:
        """`keys` are the process's own; `requests` takes the operator requests in a candidate's statuses."""
        self.name = name
        self._mission, self._keys = mission, keys
        self._feeds = {one.key: Feed(one.rate) for one in keys}
        self._by_topic = {one.topic.name: self._feeds[one.key] for one in keys}
        kind = AgentStatus if name in mission.followers else LeaderStatus
        self.statuses = Statuses(kind, self._by_topic[STATUS.name], name, requests)

    def feeds(self) -> Iterator[tuple[str, Feed, Handler | None]]:
        """Yield key, feed and handler of every key; no handler if it is only counted and recorded."""
        for one in self._keys:
            feed = self._feeds[one.key]
            yield one.key, feed, self._handlers(feed).get(one.topic.name)

    def clock_was_set(self) -> None:
        """Forget moments and senders' clocks after our system clock was set."""
        for feed in self._feeds.values():
            feed.forget_clock()

    def _handlers(self, _feed: Feed) -> dict[str, Handler]:
        """Return the handlers of messages by topic, for the key with this feed."""
        return {STATUS.name: self.statuses.process_status, BALLOT.name: self._check_ballot}

    def _check_ballot(self, sample: Sample, wall: float) -> None:
        ballot = json_message.decode(Ballot, decode(Text, sample.payload).text.encode())
        check_ballot(ballot, self.name, self._mission, Now(sample.arrived, wall))


class ReceivedOfRobot(Received):
    """One robot of the mission."""

    def __init__(
        self, mission: Mission, name: str, keys: Sequence[Watched], requests: Requests, slowest: float
    ) -> None:
        """`slowest` [s] is the longest silence of any robot still fresh."""
        super().__init__(mission, name, keys, requests)
        self._spec = mission.robots[name]
        self._offset = 0.0 if name == mission.leader else self._spec.control_point_offset
        self._command: tuple[Feed, float, float] | None = None
        self.attachments = PositionAttachments()
        """The attachments of its positions."""
        self.place = self._tracked(self._by_topic[POSITION.name], slowest)
        self.process_position = _position_handler(self.place, self._offset)
        """Take in one of its positions. Raises BadMessage."""
        truth = self._by_topic.get(GROUND_TRUTH.name)
        self.truth = self.place if truth is None else self._tracked(truth, slowest)
        """Its trajectory from ground truth; a virtual leader's is its own."""

    def clock_was_set(self) -> None:
        """Forget moments and senders' clocks after our system clock was set."""
        super().clock_was_set()
        for one in (self.place, self.truth):
            one.trajectory.forget()

    def missed(self) -> int:
        """Return the missed periods, summed over all keys."""
        return sum(feed.missed for feed in self._feeds.values())

    def metrics(self, now: Now, error: KnownError, state: tuple[str, str] | None) -> RobotMetrics:
        """Return the robot's metrics now; `error` is over its own edges.

        `state` (with reason) is from its own status if None.
        """
        state_name, reason = state or self.statuses.state(now)
        status = self._agent_status(now)
        speed = turn_rate = None
        if self._command is not None and self._command[0].fresh(now.mono):
            _, speed, turn_rate = self._command
        return RobotMetrics(
            state=state_name,
            reason=reason,
            error=error.error if error.complete else None,
            known=error,
            speed=speed,
            turn_rate=turn_rate,
            speed_share=None if speed is None else abs(speed) / self._spec.max_speed,
            turn_share=None if turn_rate is None else abs(turn_rate) / self._spec.max_turn_rate,
            age=finite(self.place.feed.silence(now.mono)),
            heading_error=self._heading_error(now),
            rate=self.place.feed.rate(now.mono),
            keys={one.key: _metrics(self._feeds[one.key], now) for one in self._keys},
            rejected_age=finite(now.mono - max(feed.rejected for feed in self._feeds.values())),
            unavailable=self.attachments.unavailable,
            reason_code="" if status is None else str(status.reason.code),
            readonly=status is not None and status.readonly,
            stuck=status is not None and status.motion is not None,
            avoiding=_avoiding(status)
            if status is not None and state_name == AgentState.RUN and not status.readonly
            else "",
            deadlocks=0 if status is None else min(status.deadlocks, MAX_DEADLOCKS),
            fallback=", ".join(
                one for one in (status.follows if status else ()) if one not in self._spec.neighbours
            ),
            publishers=self.attachments.publishers,
            sight="" if status is None or status.sight is None else str(status.sight),
            seen={} if status is None else status.sight_deviation,
            correction=None if status is None else status.sight_correction,
        )

    def contested(self, now: Now) -> Iterable[str]:
        """Return the robots with two publishers, by this one's newest status or by its own positions."""
        status = self._agent_status(now)
        own = (self.name,) if self.attachments.contested(now.mono) else ()
        return own if status is None else (*own, *status.contested)

    def forgers(self, now: Now) -> Iterable[str]:
        """Return the robots that lately relayed forged orders to this one, by its newest status."""
        status = self.statuses.newest(now)
        return () if status is None else status.forged

    def _agent_status(self, now: Now) -> AgentStatus | None:
        status = self.statuses.newest(now)
        return status if isinstance(status, AgentStatus) else None

    def _heading_error(self, now: Now) -> float | None:
        if self.truth is self.place or not (
            self.place.feed.fresh(now.mono) and self.truth.feed.fresh(now.mono)
        ):
            return None
        moment = min(self.place.trajectory.latest, self.truth.trajectory.latest)
        estimated, true = self.place.trajectory.at(moment), self.truth.trajectory.at(moment)
        if estimated is None or true is None:
            return None
        return cmath.phase(estimated.heading * true.heading.conjugate())

    def _handlers(self, feed: Feed) -> dict[str, Handler]:
        return {
            **super()._handlers(feed),
            GROUND_TRUTH.name: _position_handler(self.truth, self._offset),
            CMD_VEL.name: self._command_handler(feed),
            **{topic.name: _stamp_handler(feed, kind) for topic, kind in STAMPED.items()},
        }

    def _command_handler(self, feed: Feed) -> Handler:
        kind: type[Twist | TwistStamped] = Twist if self._spec.cmd_vel == "twist" else TwistStamped

        def process_command(sample: Sample, wall: float) -> None:
            command = decode(kind, sample.payload)
            if isinstance(command, TwistStamped):
                feed.stamped(command.stamp, wall)
            self._command = feed, command.speed, command.turn_rate

        return process_command

    def _tracked(self, feed: Feed, slowest: float) -> Tracked:
        # All robots are compared at the moment that the slowest fresh robot has reached.
        samples = math.ceil(1.5 * self._spec.rate * (slowest + CLOCK_AGREES[1])) + 8
        return Tracked(feed, Trajectory(samples, feed.limit))


def _position_handler(tracked: Tracked, offset: float) -> Handler:
    feed, trajectory = tracked

    def process_pose(sample: Sample, wall: float) -> None:
        pose = decode(Pose, sample.payload)
        moment = feed.stamped(pose.stamp, wall)
        if moment > wall + MAX_STAMP_LEAD:
            raise BadMessage("stamp is in the future")
        trajectory.add(Placed(moment, pose.position + offset * pose.heading, pose.heading))

    return process_pose


def _stamp_handler(feed: Feed, kind: type[Odometry | Pose | Displacement]) -> Handler:
    def process_stamp(sample: Sample, wall: float) -> None:
        feed.stamped(decode(kind, sample.payload).stamp, wall)

    return process_stamp


def _metrics(feed: Feed, now: Now) -> KeyMetrics:
    return KeyMetrics(
        feed.count, feed.rate(now.mono), finite(feed.silence(now.mono)), feed.missed, feed.clock, feed.loss
    )


def _avoiding(status: AgentStatus) -> str:
    """Return the strongest limit on its law's command: a key of `snapshot.AVOIDING`, or empty."""
    avoids = "avoids" if status.avoiding and status.collisions is CollisionMode.ON else ""
    return avoids if status.zone is None else ZONES.get(status.zone, avoids)
