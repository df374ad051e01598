"""Gathers what can be known on the robot itself: on its own bus, from its files, from its network.

One more client of the robot's router. It declares that it would publish cmd_vel and signs of life, so that
Zenoh tells whether anybody listens, and never publishes either.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from deploy.doctor import files, listening, machine
from deploy.doctor.facts import Certificate, Facts, Party
from deploy.doctor.probe import Papers, reach
from deploy.refusal import Refusal
from formation.mission import Mission
from formation.mission_file import MissionError, load
from formation.ros2 import tokens
from formation.ros2.naming import Naming
from formation.topics import ALIVE, CMD_VEL, ODOM, POSE, POSITION, STATUS
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.wiring import endpoints, partners

NODE = "formation_doctor"
LINKED, TOLD = 2.0, 0.5
"""How long a link may take, and then what the router tells of those who listen [s]."""


def gather(
    mission: Mission, robot: str, seconds: float, papers: Papers | None, installed: Path | None, router: str
) -> Facts:
    """Everything about `robot`, which this machine is; `installed` is the mission file that it has."""
    where = endpoints(mission).agents
    heard: listening.Listened = {}
    trouble, routed, guarded = "", None, None
    listeners: tuple[Party, ...] = ()
    speakers: tuple[Party, ...] = ()
    keys = {topic: topic.key(robot) for topic in (ODOM, POSE, POSITION, STATUS, ALIVE)}
    naming = Naming.of(mission, [robot])
    try:
        config = BusConfig(connect=(router,), mode="client", adminspace=False, name=NODE)
    except BusError as error:
        raise Refusal(str(error)) from None
    try:
        with Bus(config) as bus:
            if _linked(bus):
                routed, guarded = _matched(bus, naming, robot)
                for key in keys.values():
                    bus.subscribe(naming.wire(key), key)
                heard = listening.listen(bus, seconds)
                found = list(_parties(bus, mission, naming, robot))
                listeners = tuple(party for kind, party in found if kind == "MS")
                speakers = tuple(party for kind, party in found if kind == "MP")
            else:
                trouble = "no link"
    except BusError as error:
        trouble = str(error)
    external = mission.robots[robot].localisation == "external"
    status, said = listening.statuses(heard.get(keys[STATUS], []))
    return Facts(
        mission=mission,
        robot=robot,
        on_robot=True,
        seconds=seconds,
        odometry=None if external else listening.odometry(heard.get(keys[ODOM], [])),
        pose=listening.poses(heard.get(keys[POSE], [])) if external else None,
        position=listening.poses(heard.get(keys[POSITION], [])),
        status=status,
        said=said,
        alive=listening.signs(heard.get(keys[ALIVE], [])),
        router=router,
        router_trouble=trouble,
        routed=routed,
        guarded=guarded,
        guard_unit=machine.guard_unit(),
        listeners=listeners,
        speakers=speakers,
        reached={name: reach(where[name], papers) for name in partners(mission, robot)},
        certificates=None if papers is None else _certificates(robot, papers),
        chrony=machine.chrony(),
        installed_differs=_differs(mission, installed),
        wall=time.time(),
    )


def _linked(bus: Bus) -> bool:
    deadline = time.monotonic() + LINKED
    while bus.linked_routers == 0:
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def _matched(bus: Bus, naming: Naming, robot: str) -> tuple[bool, bool]:
    """Whether anybody listens to commands, and to signs of life. Before this session listens itself."""
    wires = []
    for topic in (CMD_VEL, ALIVE):
        wires.append(naming.wire(topic.key(robot)))
        bus.advertise(topic, wires[-1])
    deadline = time.monotonic() + TOLD
    while time.monotonic() < deadline and not all(map(bus.watched, wires)):
        time.sleep(0.02)
    return bus.watched(wires[0]), bus.watched(wires[1])


def _parties(bus: Bus, mission: Mission, naming: Naming, robot: str) -> Iterator[tuple[str, Party]]:
    """Who in ROS has to do with cmd_vel: MS listens, MP speaks."""
    name = naming.robots[robot].names.name(CMD_VEL)
    spec = mission.robots[robot]
    if spec.ros == "rmw_zenoh":
        for key in bus.tokens(tokens.everybody(spec.domain), TOLD):
            token = tokens.read(key)
            if token is not None and token.topic == name and token.zid != bus.zid:
                yield token.kind, Party(token.node, token.type, token.zid)
    else:
        for key in bus.tokens(tokens.ROUTES, TOLD):
            route = tokens.read_route(key)
            if route is not None and route.key == name:
                yield route.kind, Party("a node behind the bridge", route.type, route.zid)


def _certificates(robot: str, papers: Papers) -> tuple[Certificate, ...] | None:
    read = files.read(robot, papers)
    return None if read is None else (read,)


def _differs(mission: Mission, installed: Path | None) -> str | None:
    if installed is None:
        return None
    try:
        return "" if load(installed) == mission else str(installed)
    except MissionError as error:
        raise Refusal(str(error)) from None
