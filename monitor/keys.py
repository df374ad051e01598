"""What the monitor listens to: every key of the fleet, spelled out, in the order of subscribing."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from formation.mission import Mission
from formation.topics import (
    CMD_VEL,
    DIAGNOSTICS,
    ERROR,
    GROUND_TRUTH,
    ODOM,
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
    """One key of one robot."""

    key: str
    topic: Topic
    """Of the type that this robot uses."""
    robot: str
    rate: float | None
    """What the mission or the topic table promises [Hz]; None for a sensor's own."""


OWN = (Watched(ERROR.key(), ERROR, "", 10.0), Watched(DIAGNOSTICS.key(), DIAGNOSTICS, "", 1.0))
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
        follows = name != mission.leader  # the leader is virtual: it has no robot
        for topic in (ODOM, CMD_VEL, POSITION, SCAN, STATUS, GROUND_TRUTH) if follows else (POSITION, STATUS):
            exact = command_topic(robot.cmd_vel) if topic is CMD_VEL else topic
            rate = {SCAN: None, STATUS: STATUS_RATE}.get(topic, robot.rate)
            yield Watched(topic.key(name), exact, name, rate)
        if robot.measurement == "local":
            for other in robot.neighbours:
                yield Watched(RELATIVE.key(name, other), RELATIVE, name, None)
