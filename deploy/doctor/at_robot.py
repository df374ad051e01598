"""Gather facts on the robot itself: on its own bus, from its files, from its network.

It is one more client of the robot's router. It declares a publisher of cmd_vel, so that Zenoh reports whether
there is a subscriber, and never publishes. The watchdog is queried itself, as the agent may have other
subscribers.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from formation.deploy.doctor import files, listening, machine
from formation.deploy.doctor.facts import Certificate, Facts, Party
from formation.deploy.doctor.probe import Papers, reach
from formation.deploy.refusal import Refusal
from formation.mission.file import MissionError, load
from formation.mission.model import Mission
from formation.protocol.status import AgentStatus, WatchdogStatus
from formation.protocol.status_codec import from_json
from formation.ros2 import tokens
from formation.ros2.naming import Naming
from formation.topics import ALIVE, CMD_VEL, ODOM, POSE, POSITION, STATUS, WATCHDOG
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.wiring import endpoints, partners
from formation.wire import BadMessage

NODE = "formation_doctor"
LINK_TIME, TOKEN_TIME = 2.0, 0.5
"""Time for a link, and then for the router's report of subscribers [s]."""
ANSWER_TIME = 1.5
"""Time for a watchdog to answer [s]."""


def gather(
    mission: Mission, robot: str, seconds: float, papers: Papers | None, installed: Path | None, router: str
) -> Facts:
    """Return all facts about `robot`, which is this machine; `installed` is its mission file."""
    where = endpoints(mission).agents
    received: listening.Listened = {}
    trouble, routed, watchdog_state = "", None, None
    listeners: tuple[Party, ...] = ()
    speakers: tuple[Party, ...] = ()
    keys = {topic: topic.key(robot) for topic in (ODOM, POSE, POSITION, STATUS, ALIVE)}
    naming = Naming.of(mission.robots, [robot])
    try:
        config = BusConfig(connect=(router,), mode="client", adminspace=False, name=NODE)
    except BusError as error:
        raise Refusal(str(error)) from None
    try:
        with Bus(config) as bus:
            if _linked(bus):
                routed, watchdog_state = _routed(bus, naming, robot), _watchdog(bus, naming, robot)
                for key in keys.values():
                    bus.subscribe(naming.wire(key), key)
                received = listening.listen(bus, seconds)
                found = list(_parties(bus, mission, naming, robot))
                listeners = tuple(party for kind, party in found if kind == "MS")
                speakers = tuple(party for kind, party in found if kind == "MP")
            else:
                trouble = "no link"
    except BusError as error:
        trouble = str(error)
    external = mission.robots[robot].localisation == "external"
    status, newest = listening.statuses(AgentStatus, received.get(keys[STATUS], []))
    return Facts(
        mission=mission,
        robot=robot,
        on_robot=True,
        seconds=seconds,
        odometry=None if external else listening.odometry(received.get(keys[ODOM], [])),
        pose=listening.poses(received.get(keys[POSE], [])) if external else None,
        position=listening.poses(received.get(keys[POSITION], [])),
        status=status,
        newest_status=newest,
        alive=listening.signs(received.get(keys[ALIVE], [])),
        router=router,
        router_trouble=trouble,
        routed=routed,
        watchdog_state=watchdog_state,
        watchdog_unit=machine.watchdog_unit(),
        listeners=listeners,
        speakers=speakers,
        reached={name: reach(where[name], papers) for name in partners(mission, robot)},
        certificates=None if papers is None else _certificates(robot, papers),
        chrony=machine.chrony(),
        installed_differs=_differs(mission, installed),
        wall=time.time(),
    )


def _linked(bus: Bus) -> bool:
    deadline = time.monotonic() + LINK_TIME
    while bus.linked_routers == 0:
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def _routed(bus: Bus, naming: Naming, robot: str) -> bool:
    """Return whether commands have a subscriber. Call it before this session subscribes itself."""
    wire = naming.wire(CMD_VEL.key(robot))
    bus.advertise(CMD_VEL, wire)
    deadline = time.monotonic() + TOKEN_TIME
    while time.monotonic() < deadline and not bus.watched(wire):
        time.sleep(0.02)
    return bus.watched(wire)


def _watchdog(bus: Bus, naming: Naming, robot: str) -> str:
    """Return the state of the robot's watchdog; empty if none answers.

    The query is repeated within `ANSWER_TIME`: the router may report a watchdog slightly after the link.
    """
    wire, deadline = naming.wire(WATCHDOG.key(robot)), time.monotonic() + ANSWER_TIME
    while (left := deadline - time.monotonic()) > 0.0:
        for reply in bus.ask(wire, b"", left):
            try:
                newest = from_json(WatchdogStatus, reply.payload)
            except BadMessage:
                continue
            if newest.robot == robot:
                return str(newest.state)
        time.sleep(0.05)
    return ""


def _parties(bus: Bus, mission: Mission, naming: Naming, robot: str) -> Iterator[tuple[str, Party]]:
    """Yield the ROS nodes with cmd_vel: MS subscribes, MP publishes."""
    name = naming.robots[robot].spelled(CMD_VEL.key(robot))
    spec = mission.robots[robot]
    if spec.ros == "rmw_zenoh":
        for key in bus.tokens(tokens.all_tokens(spec.domain), TOKEN_TIME):
            token = tokens.read(key)
            if token is not None and token.topic == name and token.zid != bus.zid:
                yield token.kind, Party(token.node, token.type, token.zid)
    else:
        for key in bus.tokens(tokens.ROUTES, TOKEN_TIME):
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
