"""Gathers what can be known on the robot itself: on its own bus, from its files, from its network.

One more client of the robot's router. It declares that it would publish cmd_vel, so that Zenoh tells whether
anybody listens, and never publishes it. The guard is asked itself: others may listen to the agent as well.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from deploy.doctor import files, listening, machine
from deploy.doctor.facts import Certificate, Facts, Party
from deploy.doctor.probe import Papers, reach
from deploy.refusal import Refusal
from formation.guarding import decode
from formation.mission import Mission
from formation.mission_file import MissionError, load
from formation.ros2 import tokens
from formation.ros2.naming import Naming
from formation.topics import ALIVE, CMD_VEL, GUARD, ODOM, POSE, POSITION, STATUS
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.wiring import endpoints, partners

NODE = "formation_doctor"
LINKED, TOLD = 2.0, 0.5
"""How long a link may take, and then what the router tells of those who listen [s]."""
ANSWERS = 1.5
"""How long a guard has to answer [s]."""


def gather(
    mission: Mission, robot: str, seconds: float, papers: Papers | None, installed: Path | None, router: str
) -> Facts:
    """Everything about `robot`, which this machine is; `installed` is the mission file that it has."""
    where = endpoints(mission).agents
    heard: listening.Listened = {}
    trouble, routed, guard_state = "", None, None
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
                routed, guard_state = _routed(bus, naming, robot), _guard(bus, naming, robot)
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
        guard_state=guard_state,
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


def _routed(bus: Bus, naming: Naming, robot: str) -> bool:
    """Whether anybody listens to commands. Before this session listens itself."""
    wire = naming.wire(CMD_VEL.key(robot))
    bus.advertise(CMD_VEL, wire)
    deadline = time.monotonic() + TOLD
    while time.monotonic() < deadline and not bus.watched(wire):
        time.sleep(0.02)
    return bus.watched(wire)


def _guard(bus: Bus, naming: Naming, robot: str) -> str:
    """What the robot's guard says that it is doing; empty if none answers.

    Asked again within `ANSWERS`: the router may tell of a guard a moment later than it is linked.
    """
    wire, deadline = naming.wire(GUARD.key(robot)), time.monotonic() + ANSWERS
    while (left := deadline - time.monotonic()) > 0.0:
        for reply in bus.ask(wire, b"", left):
            said = decode(reply.payload)
            if said is not None and said.robot == robot:
                return said.state
        time.sleep(0.05)
    return ""


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
