"""Does what the agent commands reach its own robot, as the type it takes, from nobody else, and guarded?"""

from __future__ import annotations

from collections.abc import Iterator

from deploy.doctor.facts import Examination, Facts, Finding
from formation.topics import command_topic

LINK = "robot link"
"""Key of a status that tells of the link to the robot."""
OURS = frozenset({"formation_agent", "formation_guard", "formation_doctor"})
"""ROS nodes that may speak on cmd_vel."""
KINDS = {"geometry_msgs/msg/Twist": "twist", "geometry_msgs/msg/TwistStamped": "twist_stamped"}


def look(facts: Facts) -> Iterator[Finding]:
    """The router, the route to cmd_vel, its type, and who else speaks there."""
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
    told = facts.said.values.get(LINK, "connected") if facts.said else "connected"
    if facts.routed is False and not wrong:
        yield Finding(
            "route-lost",
            "nobody listens to cmd_vel: the bridge has lost its route, or the bring-up is down",
            "restart the bring-up and the bridge together",
        )
    elif told != "connected" and facts.routed is None and not facts.router_trouble:
        yield Finding(
            "route-lost",
            f"its agent's link to the robot: {told}",
            "restart the bring-up and the bridge together",
        )
    for party in facts.speakers:
        if party.name not in OURS:
            yield Finding(
                "cmd-vel-contested",
                f"{party.name} publishes on cmd_vel as well",
                "end it: two who command one robot undo each other's work",
            )


def well(facts: Facts) -> str:
    """Who listens."""
    if facts.routed:
        names = sorted({party.name for party in facts.listeners})
        return f"cmd_vel is listened to as {_short(wanted(facts))}{' by ' if names else ''}{', '.join(names)}"
    if facts.said and facts.said.values.get(LINK) == "connected":
        return "its agent says: connected"
    return ""


def guard(facts: Facts) -> Iterator[Finding]:
    """Does somebody stop the robot when its agent dies?"""
    if facts.guard_unit not in {None, "active"}:
        yield Finding(
            "guard-down",
            f"the guard does not run: systemd calls it {facts.guard_unit}",
            "sudo systemctl restart formation-guard; journalctl -u formation-guard says why",
        )
    elif facts.guard_state == "" and not facts.router_trouble:
        yield Finding(
            "guard-down",
            "no guard answers: if the agent dies, the robot drives on",
            f"start it: formation guard MISSION --robot {facts.robot}",
        )


def guard_well(facts: Facts) -> str:
    """That it answers, and what it is doing."""
    if not facts.guard_state:
        return ""
    return f"answers: {facts.guard_state}{', systemd calls it active' if facts.guard_unit else ''}"


def wanted(facts: Facts) -> str:
    """ROS type of the commands that the agent sends."""
    return command_topic(facts.mission.robots[facts.robot].cmd_vel).type


def _short(ros_type: str) -> str:
    return ros_type.rpartition("/")[2]


ROBOT_LINK = Examination("robot", look, well)
GUARD = Examination("guard", guard, guard_well)
