"""How late messages came, and how soon a robot's odometry was answered by a command.

Both are differences between a stamp, on its sender's clock, and an arrival, on the recorder's: they contain
the difference of the two clocks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from formation.mission import Mission
from formation.ros2.definitions import definition
from formation.topics import CMD_VEL, ODOM, POSE, TABLE
from monitor.figures.keys import watched
from monitor.recording.recorder import stamp_of
from monitor.report.thin import Spread

HEADER = "std_msgs/Header "
"""What the definition of a message that begins with a stamp begins with."""


@dataclass(frozen=True, slots=True)
class Late:
    """How times [s] are spread."""

    count: int
    median: float | None
    p99: float | None
    maximum: float | None

    @classmethod
    def of(cls, spread: Spread) -> Late:
        """Its figures; the maximum is over every value."""
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
        self._asked: dict[str, float] = {}

    def take(self, key: str, payload: bytes, wall: float) -> None:
        """Take one message that was not rejected and arrived at `wall` [s, the recorder's clock]."""
        if key in self._commands:
            self._asked[self._commands[key]] = wall
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
        """Arrival less stamp, in the order of the topic table."""
        return {
            topic.name: Late.of(self._spreads[topic.name]) for topic in TABLE if topic.name in self._spreads
        }

    @property
    def answers(self) -> Mapping[str, Late]:
        """From the stamp of an odometry (or pose) message to the arrival of the command that answers it."""
        return {name: Late.of(spread) for name, spread in self._answers.items() if spread.count}

    def _answer(self, robot: str, wall: float, late: float) -> None:
        """An agent repeats what it heard once it has answered: the command stands before its odometry."""
        asked = self._asked.pop(robot, None)
        if asked is not None and wall - asked < 0.5 * self._period[robot]:
            self._answers[robot].add(late - (wall - asked))
