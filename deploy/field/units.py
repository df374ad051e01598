"""systemd units of a robot: the templates in systemd/, filled in for it.

What only the robot knows, where it is installed, stays `@PREFIX@` until install.sh writes it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.resources import files

from deploy.refusal import Refusal
from formation.mission import Mission
from formation.robot_spec import RobotSpec
from formation.transport.wiring import role

PREFIX = "@PREFIX@"
CURRENT = f"{PREFIX}/current"
"""The release that is in use; certificates are in a folder of that name in it."""
BRINGUP = "turtlebot3.service"
BRIDGES = {"ros2dds": "zenoh-bridge-ros2dds.service", "rmw_zenoh": "rmw-zenohd.service"}
"""What connects a robot's ROS 2 with Zenoh, by the mission's key `ros`."""
CONFIGURATION = "conf.json5"
"""Of zenoh-bridge-ros2dds."""
RMW = {"ros2dds": "rmw_cyclonedds_cpp", "rmw_zenoh": "rmw_zenoh_cpp"}
"""For the bring-up; the bridge is itself made of Cyclone DDS, and tested with that."""
NONE = "none"
"""For a robot whose bring-up or bridge is not a unit of systemd's."""
_UNIT = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.:@-]*\.service")


def units(mission: Mission, name: str, bringup: str = BRINGUP, bridge: str | None = None) -> dict[str, str]:
    """Texts of the units that run on a robot, or where one is that may lead, by file name. Raises Refusal."""
    values = _values(mission, name, bringup, bridge)
    own = role(mission, name)
    roles = (own, "guard") if own == "agent" else (own,)
    return {unit: _filled(unit, values) for unit in (f"formation-{one}.service" for one in roles)}


def samples(mission: Mission, name: str, bringup: str = BRINGUP, bridge: str | None = None) -> dict[str, str]:
    """Units for a robot's bring-up and bridge, and the bridge's configuration, for who has none.

    By file name, as `units` does. Raises Refusal.
    """
    if name in mission.candidates:
        return {}
    values = _values(mission, name, bringup, bridge)
    wanted = {BRINGUP: bringup, BRIDGES[mission.robots[name].ros]: values["BRIDGE"]}
    if mission.robots[name].ros == "ros2dds" and values["BRIDGE"] != NONE:
        wanted[CONFIGURATION] = CONFIGURATION
    return {place: _filled(template, values) for template, place in wanted.items() if place != NONE}


def bridge_of(spec: RobotSpec, bridge: str | None) -> str:
    """The unit of a robot's bridge or router: the one given, else the usual one for its ROS 2."""
    return BRIDGES[spec.ros] if bridge is None else bridge


def commands(unit: str, state: str = "%S") -> list[list[str]]:
    """What a unit starts, one command line after the other, with the variables that it sets itself.

    `state` is where state directories are: for systemd /var/lib.
    """
    variables = dict(re.findall(r"(?m)^Environment=(\w+)=(.*)$", unit))
    lines = re.findall(r"(?m)^Exec(?:Start|StopPost)=(.*)$", unit.replace("%S", state))
    return [re.sub(r"\$(\w+)", lambda word: variables[word[1]], line).split() for line in lines]


def _values(mission: Mission, name: str, bringup: str, bridge: str | None) -> Mapping[str, str]:
    # a standby has no robot, nor has the leader; their units have no use for what is said of one
    spec = mission.robots[mission.leader if name in mission.standbys else name]
    bridge = bridge_of(spec, bridge)
    for flag, unit in (("--bringup", bringup), ("--bridge", bridge)):
        if unit != NONE and not _UNIT.fullmatch(unit):
            raise Refusal(f"{flag} {unit!r}: must be the name of a unit, such as {BRINGUP}, or {NONE}")
    bound = [unit for unit in (bringup, bridge) if unit != NONE]
    namespace = name if spec.namespace is None else spec.namespace
    return {
        "ROBOT": name,
        "FORMATION": f"{CURRENT}/venv/bin/formation",
        "CURRENT": CURRENT,
        "ROBOT_UNITS": " ".join(bound),
        "AGENT_WANTED_BY": bound[0] if bound else "multi-user.target",
        "BRIDGE": bridge,
        "BRIDGE_ENDPOINT": spec.robot_endpoint or "",
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
    return files("deploy").joinpath("field", "systemd", name).read_text(encoding="utf-8")
