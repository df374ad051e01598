"""Latency of messages, and time from a robot's odometry to its command.

Both are differences between a stamp, on its sender's clock, and an arrival, on the recorder's: they contain
the offset of the two clocks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from formation.mission.model import Mission
from formation.monitor.metrics.keys import watched
from formation.monitor.recording.recorder import stamp_of
from formation.monitor.report.thin import Spread
from formation.ros2.messages import definition
from formation.topics import CMD_VEL, ODOM, POSE, TABLE

HEADER = "std_msgs/Header "
"""Beginning of the definition of a message that starts with a stamp."""


@dataclass(frozen=True, slots=True)
class Late:
    """Distribution of times [s]."""

    count: int
    median: float | None
    p99: float | None
    maximum: float | None

    @classmethod
    def of(cls, spread: Spread) -> Late:
        """Return the distribution of `spread`; the maximum is over every value."""
        most = spread.most if spread.count else None
        return cls(spread.count, spread.percentile(0.5), spread.percentile(0.99), most)


class Latencies:
    """Arrival less stamp by topic, and odometry to command by robot."""

    def __init__(self, mission: Mission) -> None:
        keys = watched(mission)
        self._topics = {
            one.key: one.topic.name for one in keys if definition(one.topic.type).lstrip().startswith(HEADER)
        }
        self._spreads: dict[str, Spread] = {}
        self._answers = {name: Spread() for name in mission.followers}
        self._inputs = {
            (POSE if spec.localisation == "external" else ODOM).key(name): name
            for name, spec in mission.robots.items()
            if name != mission.leader
        }
        self._commands = {CMD_VEL.key(name): name for name in mission.followers}
        self._period = {name: 1.0 / mission.robots[name].rate for name in mission.followers}
        self._sent: dict[str, float] = {}

    def process_message(self, key: str, payload: bytes, wall: float) -> None:
        """Take one accepted message that arrived at `wall` [s, the recorder's clock]."""
        if key in self._commands:
            self._sent[self._commands[key]] = wall
        topic = self._topics.get(key)
        stamp = None if topic is None else stamp_of(payload)
        if topic is None or stamp is None:
            return
        late = wall - stamp / 1e9
        self._spreads.setdefault(topic, Spread()).add(late)
        if key in self._inputs:
            self._answer(self._inputs[key], wall, late)

    @property
    def by_topic(self) -> Mapping[str, Late]:
        """Return arrival less stamp by topic, in the order of the topic table."""
        return {
            topic.name: Late.of(self._spreads[topic.name]) for topic in TABLE if topic.name in self._spreads
        }

    @property
    def answers(self) -> Mapping[str, Late]:
        """Return times from the stamp of an odometry (or pose) message to the arrival of its command."""
        return {name: Late.of(spread) for name, spread in self._answers.items() if spread.count}

    def _answer(self, robot: str, wall: float, late: float) -> None:
        """Take an odometry message, which an agent repeats after its answer: the command precedes it."""
        sent = self._sent.pop(robot, None)
        if sent is not None and wall - sent < 0.5 * self._period[robot]:
            self._answers[robot].add(late - (wall - sent))
