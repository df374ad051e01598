"""Check that only the agent's commands reach its robot, in the right type, with a watchdog."""

from __future__ import annotations

from collections.abc import Iterator

from formation.deploy.doctor.facts import Examination, Facts, Finding
from formation.protocol.status import RobotLink
from formation.protocol.status_codec import LINKS
from formation.ros2.tokens import hidden
from formation.topics import command_topic

OURS = frozenset(map(hidden, ("formation_agent", "formation_watchdog", "formation_doctor")))
"""ROS nodes that may publish on cmd_vel."""
KINDS = {"geometry_msgs/msg/Twist": "twist", "geometry_msgs/msg/TwistStamped": "twist_stamped"}


def look(facts: Facts) -> Iterator[Finding]:
    """Yield findings on the router, the route to cmd_vel, its type, and other publishers."""
    if facts.router_trouble:
        yield Finding(
            "router-missing",
            f"nothing answers at {facts.router}, where the robot's bridge or router should be",
            "start it: systemctl status zenoh-bridge-ros2dds, or rmw_zenohd",
        )
    wrong = [party for party in facts.listeners if party.type != wanted(facts)]
    for party in wrong:
        kind = KINDS.get(party.type)
        yield Finding(
            "cmd-vel-type",
            f"{party.name} takes {_short(party.type)} on cmd_vel, but is sent {_short(wanted(facts))}",
            f'say cmd_vel = "{kind}" for {facts.robot} in the mission'
            if kind
            else "cmd_vel must be of type Twist or TwistStamped",
        )
    robot = facts.mission.robots.get(facts.robot)
    bridged = robot is not None and robot.ros == "ros2dds"
    remedy = f"restart the bring-up{' and the bridge together' if bridged else ''}"
    link = facts.agent.link if facts.agent else RobotLink.UNKNOWN
    if facts.routed is False and not wrong:
        yield Finding(
            "route-lost",
            f"nothing listens to cmd_vel: {'the bridge has lost its route, or ' if bridged else ''}"
            "the bring-up is down",
            remedy,
        )
    elif (
        link not in {RobotLink.UNKNOWN, RobotLink.CONNECTED}
        and facts.routed is None
        and not facts.router_trouble
    ):
        yield Finding(
            "route-lost",
            f"its agent's link to the robot: {LINKS[link]}",
            remedy,
        )
    for party in facts.speakers:
        if party.name not in OURS:
            yield Finding(
                "cmd-vel-contested",
                f"{party.name} publishes on cmd_vel as well",
                "end it: two controllers of one robot undo each other's work",
            )


def well(facts: Facts) -> str:
    """Return the subscribers."""
    if facts.routed:
        names = sorted({party.name for party in facts.listeners})
        return f"cmd_vel is listened to as {_short(wanted(facts))}{' by ' if names else ''}{', '.join(names)}"
    if facts.agent and facts.agent.link is RobotLink.CONNECTED:
        return "its agent says: connected"
    return ""


def watchdog(facts: Facts) -> Iterator[Finding]:
    """Yield findings if no watchdog would stop the robot when its agent dies."""
    if facts.watchdog_unit not in {None, "active"}:
        yield Finding(
            "watchdog-down",
            f"the watchdog does not run: systemd calls it {facts.watchdog_unit}",
            "sudo systemctl restart formation-watchdog; journalctl -u formation-watchdog says why",
        )
    elif facts.watchdog_state == "" and not facts.router_trouble:
        yield Finding(
            "watchdog-down",
            "no watchdog answers: if the agent dies, the robot drives on",
            f"start it: formation watchdog MISSION --robot {facts.robot}",
        )


def watchdog_well(facts: Facts) -> str:
    """Return that the watchdog answers, and its state."""
    if not facts.watchdog_state:
        return ""
    return f"answers: {facts.watchdog_state}{', systemd calls it active' if facts.watchdog_unit else ''}"


def wanted(facts: Facts) -> str:
    """Return the ROS type of the commands that the agent sends."""
    return command_topic(facts.mission.robots[facts.robot].cmd_vel).type


def _short(ros_type: str) -> str:
    return ros_type.rpartition("/")[2]


ROBOT_LINK = Examination("robot", look, well)
WATCHDOG = Examination("watchdog", watchdog, watchdog_well)
