"""The monitor's subscriptions: every key of the fleet, in the order of subscribing.

Messages between an agent and its robot come from the agent, which repeats them to the fleet. Only ground
truth comes from the simulated robots themselves, over a separate bus: the stage.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from formation.mission.model import Mission
from formation.mission.robot import RobotSpec
from formation.topics import (
    AMCL_POSE,
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
    TF,
    Role,
    Topic,
    command_topic,
)
from formation.transport import wiring


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
            if _published(topic, robot):
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


def _published(topic: Topic, robot: RobotSpec) -> bool:
    """Return whether a topic is published; one of localisation only by a robot that uses it."""
    if topic is POSE:
        return robot.localisation == "external"
    return topic not in {AMCL_POSE, TF} or robot.odometry_frame == "map"


def _topics(mission: Mission, role: Role) -> Iterator[Topic]:
    for topic in TABLE:
        if role in topic.monitored and (mission.standbys or topic not in {BALLOT, ROUTE}):
            yield topic


def usual_stage(mission: Mission) -> dict[str, str]:
    """Return the endpoints at which `formation robot` simulates robots on this machine, by robot.

    A robot with an endpoint in the mission is taken for a real one: its ROS 2 router is there.
    """
    ends = wiring.endpoints(mission).robots
    return {name: end for name, end in ends.items() if not mission.robots[name].robot_endpoint}


def given_stage(mission: Mission, texts: Sequence[str]) -> dict[str, str]:
    """Return endpoints by robot from flags: ``ENDPOINT`` for all, ``robot2,robot3=ENDPOINT`` for some.

    Raises ValueError for a robot that is no follower of the mission.
    """
    ends: dict[str, str] = {}
    for text in texts:
        names, equals, end = text.partition("=")
        if not equals or "/" in names:  # an endpoint may contain an equals sign
            names, end = ",".join(mission.followers), text
        for name in names.split(","):
            if name not in mission.followers:
                legal = ", ".join(mission.followers)
                raise ValueError(f"--stage {text!r}: {name!r} must be a follower of {mission.name}: {legal}")
            ends[name] = end
    return ends
