"""The monitor's subscriptions: every key of the fleet, in the order of subscribing.

Messages between an agent and its robot come from the agent, which repeats them to the fleet. Only ground
truth comes from the simulated robots themselves, over a separate bus: the stage.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from formation.mission.model import Mission
from formation.topics import (
    BALLOT,
    CMD_VEL,
    DIAGNOSTICS,
    ERROR,
    EVENTS,
    GROUND_TRUTH,
    POSE,
    RELATIVE,
    ROUTE,
    STATUS,
    TABLE,
    Role,
    Topic,
    command_topic,
)


class Watched(NamedTuple):
    """One key of one robot, or of one standby."""

    key: str
    topic: Topic
    """The topic, with the message type that this robot uses."""
    robot: str
    rate: float | None
    """Rate promised by the mission or the topic table [Hz]; None for a sensor's own rate."""

    @property
    def on_stage(self) -> bool:
        """Whether simulated robots publish it, not their agents."""
        return self.topic is GROUND_TRUTH


OWN = (
    Watched(ERROR.key(), ERROR, "", 10.0),
    Watched(DIAGNOSTICS.key(), DIAGNOSTICS, "", 1.0),
    Watched(EVENTS.key(), EVENTS, "", None),
)
"""Topics that the monitor itself publishes."""


def watched(mission: Mission) -> tuple[Watched, ...]:
    """Return every key to subscribe to, status and ground truth last.

    A process that finds one of these subscribed can thus rely on all earlier keys being subscribed too, and
    so on a complete recording.
    """
    last = (STATUS, GROUND_TRUTH)
    return tuple(sorted(_keys(mission), key=lambda one: one.topic in last))


def _keys(mission: Mission) -> Iterator[Watched]:
    for name in mission.names:
        robot = mission.robots[name]
        for topic in _topics(mission, "leader" if name == mission.leader else "follower"):
            if topic is not POSE or robot.localisation == "external":
                exact = command_topic(robot.cmd_vel) if topic is CMD_VEL else topic
                rate = robot.rate if topic.promised_rate == "robot" else topic.promised_rate
                yield Watched(topic.key(name), exact, name, rate)
        if robot.measurement == "local":
            for other in robot.measurable:
                yield Watched(RELATIVE.key(name, other), RELATIVE, name, None)
    for name in mission.standbys:
        for topic in _topics(mission, "standby"):
            rate = None if topic.promised_rate == "robot" else topic.promised_rate
            yield Watched(topic.key(name), topic, name, rate)


def _topics(mission: Mission, role: Role) -> Iterator[Topic]:
    """Return the topics by and about one of this role; ballots and routes only with standbys."""
    for topic in TABLE:
        if role in topic.monitored and (mission.standbys or topic not in {BALLOT, ROUTE}):
            yield topic
