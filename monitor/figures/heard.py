"""What has been heard of one robot: positions, truth, command, status, and how each key arrives."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

from formation.mission import Mission
from formation.order import FORGED_ORDER
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
from monitor.figures.asked import Requests
from monitor.figures.candidates import ballots_of
from monitor.figures.feed import CLOCK_AGREES, Feed
from monitor.figures.keys import Watched
from monitor.figures.known import KnownError
from monitor.figures.riding import Riding
from monitor.figures.snapshot import KeyFigures, RobotFigures
from monitor.figures.statuses import Handler, Statuses
from monitor.figures.trajectory import Placed, Trajectory

FUTURE = 0.1
"""A sample placed further than this ahead of its arrival is refused: it would outrank all that follow [s]."""
SECOND_VOICE = "second voice "
"""What an agent's status says of a neighbour for whom two processes speak begins so."""
GUIDES, STUCK = "follows", "stuck"
"""Where an agent's status names whom it follows, and where it says that it does not get on."""
COLLISIONS, ZONE, DEADLOCKS = "collisions", "protective zone", "deadlocks"
"""Where it says whether it gets out of the way, what its scanner makes of its commands, and how often it was
kept from moving."""
YIELDS, ZONES = "on: gets out of the way", {"slow": "slowed", "stop": "blocked"}
MOST_DEADLOCKS = 1_000_000


class Tracked(NamedTuple):
    """Where a robot is, as one key tells it."""

    feed: Feed
    trajectory: Trajectory

    def fresh(self, mono: float) -> bool:
        """Whether the newest position is news."""
        return self.feed.fresh(mono)


class Heard:
    """One robot of the mission."""

    def __init__(
        self, mission: Mission, name: str, keys: Sequence[Watched], slowest: float, requests: Requests
    ) -> None:
        """`keys` are the robot's own; `slowest` [s] is the longest silence of any robot still fresh.

        What its process says that it was asked is for `requests`.
        """
        self.name = name
        self._spec = mission.robots[name]
        self._offset = 0.0 if name == mission.leader else self._spec.control_point_offset
        self._keys = keys
        self._feeds = {one.key: Feed(one.rate) for one in keys}
        self._command: tuple[Feed, float, float] | None = None
        by_topic = {one.topic.name: self._feeds[one.key] for one in keys}
        self.statuses = Statuses(by_topic[STATUS.name], partial(requests.take, name))
        """What its process says of itself."""
        self._ballots = ballots_of(mission, name)
        self.riding = Riding()
        """What rides on its positions."""
        self.place = self._tracked(by_topic[POSITION.name], slowest)
        self.place_it = _placing(self.place, self._offset)
        """Takes in one of its positions. Raises BadMessage."""
        truth = by_topic.get(GROUND_TRUTH.name)
        self.truth = self.place if truth is None else self._tracked(truth, slowest)
        """From ground truth; a virtual leader is where it says it is."""

    def routes(self) -> Iterator[tuple[str, Feed, Handler | None]]:
        """Key, feed and handler of everything that is heard of this robot."""
        for one in self._keys:
            feed = self._feeds[one.key]
            yield one.key, feed, self._handler(one, feed)

    def clock_was_set(self) -> None:
        """Our system clock was, by which moments and senders' clocks are told."""
        for feed in self._feeds.values():
            feed.forget_clock()
        for one in (self.place, self.truth):
            one.trajectory.forget()

    def missed(self) -> int:
        """Sum over all keys."""
        return sum(feed.missed for feed in self._feeds.values())

    def figures(self, now: Now, error: KnownError, state: tuple[str, str] | None = None) -> RobotFigures:
        """Everything there is to know now; `error` is over the robot's own edges.

        `state` and reason are its process's, unless another speaks for it.
        """
        does, reason = state or self.statuses.state(now)
        said = self.statuses.values(now)
        guides = said.get(GUIDES, "").split(", ")
        speed, turn_rate = self._commanded(now)
        return RobotFigures(
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
            keys={one.key: _figures(self._feeds[one.key], now) for one in self._keys},
            rejected_age=_finite(now.mono - max(feed.rejected for feed in self._feeds.values())),
            aside=self.riding.aside,
            stuck=STUCK in said,
            evades=_evades(said) if does == "run" else "",
            deadlocks=_deadlocks(said),
            fallback=", ".join(one for one in guides if one and one not in self._spec.neighbours),
            voices=self.riding.voices,
        )

    def contests(self, now: Now) -> Iterator[str]:
        """For whom this robot hears a second voice, as its newest status says."""
        for what in self.statuses.values(now):
            if what.startswith(SECOND_VOICE):
                yield what.removeprefix(SECOND_VOICE)

    def forgers(self, now: Now) -> Iterator[str]:
        """Who has relayed forged orders to this robot of late, as its newest status says."""
        for what in self.statuses.values(now):
            if what.startswith(FORGED_ORDER):
                yield what.removeprefix(FORGED_ORDER)

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
        """What takes in the messages of a key; None for a key that is only counted and recorded."""
        handlers: dict[str, Handler] = {
            POSITION.name: self.place_it,
            GROUND_TRUTH.name: _placing(self.truth, self._offset),
            CMD_VEL.name: self._take_command(feed),
            STATUS.name: self.statuses.take,
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
        # Everybody is compared at the moment that the slowest fresh robot has reached.
        samples = math.ceil(1.5 * self._spec.rate * (slowest + CLOCK_AGREES[1])) + 8
        return Tracked(feed, Trajectory(samples, feed.limit))


def _placing(tracked: Tracked, offset: float) -> Handler:
    feed, trajectory = tracked

    def take(sample: Sample, wall: float) -> None:
        pose = decode(Pose, sample.payload)
        moment = feed.stamped(pose.stamp, wall)
        if moment > wall + FUTURE:
            raise BadMessage("stamp is in the future")
        trajectory.add(Placed(moment, pose.position + offset * pose.heading, pose.heading))

    return take


def _note(feed: Feed, stamp: float, wall: float) -> None:
    feed.stamped(stamp, wall)


def _figures(feed: Feed, now: Now) -> KeyFigures:
    return KeyFigures(
        feed.count, feed.rate(now.mono), _finite(feed.silence(now.mono)), feed.missed, feed.clock, feed.loss
    )


def _evades(said: Mapping[str, str]) -> str:
    """What keeps it from doing as its law wants, the hardest first; a key of `EVADES`, or nothing."""
    yields = "yields" if said.get(COLLISIONS) == YIELDS else ""
    return ZONES.get(said.get(ZONE, ""), yields)


def _deadlocks(said: Mapping[str, str]) -> int:
    """A count as a status says it; whatever else stands there is none."""
    text = said.get(DEADLOCKS, "")
    return min(int(text), MOST_DEADLOCKS) if text.isascii() and text.isdigit() and len(text) < 9 else 0


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
