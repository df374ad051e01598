"""What the monitor listens to: every key of the fleet, spelled out, in the order of subscribing.

What passes between an agent and its robot it hears from the agent, which repeats it to the fleet. Only ground
truth comes from the simulated robots themselves, over a bus of its own: the stage.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from formation.mission import Mission
from formation.robot_spec import RobotSpec
from formation.topics import (
    BALLOT,
    CMD_VEL,
    COURSE,
    DIAGNOSTICS,
    ERROR,
    EVENTS,
    GROUND_TRUTH,
    ODOM,
    POSE,
    POSITION,
    RELATIVE,
    SCAN,
    STATUS,
    Topic,
    command_topic,
)

STATUS_RATE = 2.0
"""[Hz]; the topic table's."""


class Watched(NamedTuple):
    """One key of one robot, or of one standby."""

    key: str
    topic: Topic
    """Of the type that this robot uses."""
    robot: str
    rate: float | None
    """What the mission or the topic table promises [Hz]; None for a sensor's own."""

    @property
    def on_stage(self) -> bool:
        """Whether simulated robots say it, and not their agents."""
        return self.topic is GROUND_TRUTH


OWN = (
    Watched(ERROR.key(), ERROR, "", 10.0),
    Watched(DIAGNOSTICS.key(), DIAGNOSTICS, "", 1.0),
    Watched(EVENTS.key(), EVENTS, "", None),
)
"""What the monitor itself publishes."""


def watched(mission: Mission) -> tuple[Watched, ...]:
    """Every key to subscribe to, status and ground truth last.

    So a process that finds one of these watched may rely on everything before them being watched too, which
    is how it knows that its recording will be complete.
    """
    last = (STATUS, GROUND_TRUTH)
    return tuple(sorted(_keys(mission), key=lambda one: one.topic in last))


def _keys(mission: Mission) -> Iterator[Watched]:
    for name in mission.names:
        robot = mission.robots[name]
        rates = {SCAN: None, POSE: None, BALLOT: None, COURSE: None, STATUS: STATUS_RATE}
        for topic in _topics(robot) if name != mission.leader else _leads(mission, POSITION):
            exact = command_topic(robot.cmd_vel) if topic is CMD_VEL else topic
            yield Watched(topic.key(name), exact, name, rates.get(topic, robot.rate))
        if robot.measurement == "local":
            for other in robot.measurable:
                yield Watched(RELATIVE.key(name, other), RELATIVE, name, None)
    for name in mission.standbys:
        for topic in _leads(mission):
            yield Watched(topic.key(name), topic, name, STATUS_RATE if topic is STATUS else None)


def _leads(mission: Mission, *more: Topic) -> tuple[Topic, ...]:
    """What is said by who may lead; it has no robot. Only where there are standbys is anything agreed on."""
    return (*more, BALLOT, COURSE, STATUS) if mission.standbys else (*more, STATUS)


def _topics(robot: RobotSpec) -> tuple[Topic, ...]:
    """What is said by and about a follower."""
    pose = (POSE,) if robot.localisation == "external" else ()
    return (ODOM, *pose, CMD_VEL, POSITION, SCAN, STATUS, GROUND_TRUTH)
