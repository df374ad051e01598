"""systemd units of a robot: the templates in systemd/, filled in for it.

The place of installation stays `@PREFIX@` until install.sh replaces it on the robot.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.resources import files

from formation.deploy.refusal import Refusal
from formation.mission.model import Mission
from formation.topics import TABLE
from formation.transport.wiring import role

PREFIX = "@PREFIX@"
CURRENT = f"{PREFIX}/current"
"""The current release; it contains a folder for certificates."""
BRINGUP = "turtlebot3.service"
BRIDGES = {"ros2dds": "zenoh-bridge-ros2dds.service", "rmw_zenoh": "rmw-zenohd.service"}
"""Unit that connects a robot's ROS 2 with Zenoh, by the mission's key `ros`."""
CONFIGURATION = "conf.json5"
"""Configuration file of zenoh-bridge-ros2dds."""
RMW = {"ros2dds": "rmw_cyclonedds_cpp", "rmw_zenoh": "rmw_zenoh_cpp"}
"""RMW for the bring-up; the bridge uses Cyclone DDS itself, and is tested with that."""
NONE = "none"
"""Value for a bring-up or bridge that is not a systemd unit."""
_UNIT = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.:@-]*\.service")


def units(mission: Mission, name: str, bringup: str = BRINGUP, bridge: str | None = None) -> dict[str, str]:
    """Return the texts of the units of a robot or of a candidate, by file name. Raises Refusal."""
    values = _values(mission, name, bringup, bridge)
    own = role(mission, name)
    roles = (own, "watchdog") if own == "agent" else (own,)
    return {unit: _filled(unit, values) for unit in (f"formation-{one}.service" for one in roles)}


def samples(mission: Mission, name: str, bringup: str = BRINGUP, bridge: str | None = None) -> dict[str, str]:
    """Return sample units for a robot's bring-up and bridge, and the bridge's configuration.

    By file name, as in `units`. Raises Refusal.
    """
    if name in mission.candidates:
        return {}
    values = _values(mission, name, bringup, bridge)
    wanted = {BRINGUP: bringup, BRIDGES[mission.robots[name].ros]: values["BRIDGE"]}
    if mission.robots[name].ros == "ros2dds" and values["BRIDGE"] != NONE:
        wanted[CONFIGURATION] = CONFIGURATION
    return {place: _filled(template, values) for template, place in wanted.items() if place != NONE}


def _values(mission: Mission, name: str, bringup: str, bridge: str | None) -> Mapping[str, str]:
    # standbys and the leader have no robot; their units do not use these values
    spec = mission.robots[mission.leader if name in mission.standbys else name]
    bridge = BRIDGES[spec.ros] if bridge is None else bridge
    for flag, unit in (("--bringup", bringup), ("--bridge", bridge)):
        if unit != NONE and not _UNIT.fullmatch(unit):
            raise Refusal(f"{flag} {unit!r}: must be the name of a unit, such as {BRINGUP}, or {NONE}")
    bound = [unit for unit in (bringup, bridge) if unit != NONE]
    namespace = name if spec.namespace is None else spec.namespace
    # names of topics for every robot, as the bridge's regular expressions have them
    topics = [re.sub(r"\{\w+\}", ".*", topic.pattern) for topic in TABLE if topic.from_robot]
    return {
        "ROBOT": name,
        "FORMATION": f"{CURRENT}/venv/bin/formation",
        "CURRENT": CURRENT,
        "ROBOT_UNITS": " ".join(bound),
        "AGENT_WANTED_BY": bound[0] if bound else "multi-user.target",
        "BRIDGE": bridge,
        "BRIDGE_ENDPOINT": spec.robot_endpoint or "",
        "PUBLISHERS": ", ".join(f'"{topic}"' for topic in topics),
        "DOMAIN": str(spec.domain),
        "RMW": RMW[spec.ros],
        "NAMESPACE_ARGUMENT": f" namespace:={namespace}" if namespace else "",
        "HARDENING": _template("hardening.conf"),
    }


def _filled(template: str, values: Mapping[str, str]) -> str:
    text = _template(template)
    for name, value in values.items():
        text = text.replace(f"@{name}@", value)
    if values["BRIDGE"] == NONE:
        text = text.replace(f"={NONE}\n", "=\n")
    return re.sub(r"(?m)^(?:BindsTo|After|WantedBy)=\n", "", text)


def _template(name: str) -> str:
    return files("formation.deploy").joinpath("fleet", "systemd", name).read_text(encoding="utf-8")
