"""Gather facts: on the robot itself, and at the desk.

On a robot this is one more client of the robot's router. It declares a publisher of cmd_vel, so that Zenoh
reports whether there is a subscriber, and never publishes. The watchdog is queried itself, as the agent may
have other subscribers.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from formation.deploy.doctor import tls
from formation.deploy.doctor.facts import (
    Certificate,
    Chrony,
    Facts,
    ReceivedMessage,
    RosNode,
    ScanMessage,
    Stream,
)
from formation.deploy.doctor.tls import Credentials, dial
from formation.deploy.fleet.on_robot import output_of, unit_facts
from formation.deploy.refusal import refuse_errors
from formation.mission.file import MissionError, load
from formation.mission.model import Mission
from formation.mission.robot import ScanSpec
from formation.protocol import status_codec
from formation.protocol.status import AgentStatus, LeaderStatus, WatchdogStatus
from formation.ros2 import tokens
from formation.ros2.messages import Diagnostics, LaserScan, Number, Odometry, Pose, decode
from formation.ros2.naming import Naming
from formation.topics import ALIVE, CMD_VEL, ODOM, POSE, POSITION, SCAN, STATUS, WATCHDOG
from formation.transport.asking import OPERATOR
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.wiring import Links, endpoints, members, partners
from formation.wire import BadMessage, Sample

NODE = "formation_doctor"
LINK_TIME, TOKEN_TIME = 2.0, 0.5
"""Time for a link, and then for the router's report of subscribers [s]."""
ANSWER_TIME = 1.5
"""Time for a watchdog to answer [s]."""
WATCHDOG_UNIT = "formation-watchdog.service"
Listened = dict[str, list[tuple[Sample, float]]]
"""Received samples by key, each with our system clock at its arrival [s]."""


def robot_facts(
    mission: Mission,
    robot: str,
    seconds: float,
    credentials: Credentials | None,
    installed: Path | None,
    router: str,
) -> Facts:
    """Return all facts about `robot`, which is this machine; `installed` is its mission file."""
    where = endpoints(mission).agents
    keys = {topic: topic.key(robot) for topic in (ODOM, POSE, POSITION, STATUS, ALIVE)}
    if mission.robots[robot].scanner != "none":
        keys[SCAN] = SCAN.key(robot)
    received, from_router = _router_facts(mission, robot, seconds, router, keys.values())
    pose = partial(decode, Pose)
    external = mission.robots[robot].localisation == "external"
    status, newest = _statuses(AgentStatus, received.get(keys[STATUS], []))
    scan, scans = _scans(mission.robots[robot].scan, received.get(keys.get(SCAN, ""), []))
    return Facts(
        mission=mission,
        robot=robot,
        on_robot=True,
        seconds=seconds,
        odometry=None if external else _stream(partial(decode, Odometry), received.get(keys[ODOM], [])),
        pose=_stream(pose, received.get(keys[POSE], [])) if external else None,
        scan=scan if SCAN in keys else None,
        scans=scans,
        position=_stream(pose, received.get(keys[POSITION], [])),
        status=status,
        newest_status=newest,
        alive=_signs(received.get(keys[ALIVE], [])),
        router=router,
        watchdog_unit=_watchdog_unit(),
        reached={name: dial(where[name], credentials) for name in partners(mission, robot)},
        certificate=_certificate(robot, credentials),
        chrony=_chrony(),
        installed_differs=_differs(mission, installed),
        wall=time.time(),
        **from_router,
    )


def _router_facts(
    mission: Mission, robot: str, seconds: float, router: str, keys: Iterable[str]
) -> tuple[Listened, dict[str, Any]]:
    """Return what arrives on `keys` from the robot's router within `seconds`, and other fields of `Facts`."""
    received: Listened = {}
    fields: dict[str, Any] = {}
    naming = Naming.of(mission.robots, [robot])
    with refuse_errors(BusError):
        config = BusConfig(
            connect=(router,), mode="client", adminspace=False, name=NODE, connect_flag="--robot-connect"
        )
    try:
        with Bus(config) as bus:
            if not _linked(bus):
                return {}, {"router_error": "no link"}
            fields["routed"] = _routed(bus, naming, robot)
            fields["watchdog_state"] = _watchdog(bus, naming, robot)
            for key in keys:
                bus.subscribe(naming.wire(key), key)
            received, fields["ended"] = _listen(bus, seconds), time.monotonic()
            found = list(_command_nodes(bus, mission, naming, robot))
            fields["subscribers"] = tuple(node for kind, node in found if kind == "MS")
            fields["publishers"] = tuple(node for kind, node in found if kind == "MP")
    except BusError as error:
        fields["router_error"] = str(error)
    return received, fields


def fleet_facts(
    mission: Mission,
    robots: Sequence[str],
    seconds: float,
    config: Path | None,
    credentials: Credentials | None,
    folder: Path | None,
) -> list[Facts]:
    """Return facts about each of `robots`, which may include standbys.

    `config` is the operator's, `folder` has the mission's certificates.
    """
    found = {} if folder is None else tls.credentials_in(folder, members(mission))
    where = endpoints(mission).agents
    dialled = tuple(where[name] for name in robots)
    keys = {name: STATUS.key(name) for name in robots}
    with refuse_errors(BusError):
        received, ended = _from_fleet(mission, tuple(keys.values()), dialled, seconds, config)
    with ThreadPoolExecutor(max_workers=16) as pool:
        reached = dict(zip(robots, pool.map(lambda end: dial(end, credentials), dialled), strict=True))
    statuses = {
        name: _statuses(LeaderStatus if name in mission.candidates else AgentStatus, received.get(key, []))
        for name, key in keys.items()
    }
    agents = {name: newest for name, (_, newest) in statuses.items() if isinstance(newest, AgentStatus)}
    return [
        Facts(
            mission=mission,
            robot=name,
            on_robot=False,
            seconds=seconds,
            ended=ended,
            status=stream,
            newest_status=newest,
            reached={name: reached[name]},
            certificate=_certificate(name, found.get(name)),
            doubled=tuple(other for other, status in agents.items() if name in status.contested),
            seen_by=tuple(other for other, status in agents.items() if _sees(mission, status, other, name)),
            wall=time.time(),
        )
        for name, (stream, newest) in statuses.items()
    ]


def _from_fleet(
    mission: Mission, keys: Sequence[str], dialled: tuple[str, ...], seconds: float, config: Path | None
) -> tuple[Listened, float]:
    """Return what arrives on `keys` while linking and for `seconds` after, and its end [s, monotonic]."""
    bus_config = BusConfig(
        implied=Links((), dialled), namespace=mission.team or "", config_file=config, name=OPERATOR
    )
    with Bus(bus_config) as bus:
        for key in keys:
            bus.subscribe(key)
        early = _listen(bus, LINK_TIME, keys)
        received, ended = _listen(bus, seconds), time.monotonic()
    for key, samples in early.items():
        received.setdefault(key, [])[:0] = samples
    return received, ended


def _sees(mission: Mission, status: AgentStatus, robot: str, other: str) -> bool:
    """Return whether `robot` sees `other`, by its status, and corrects its pose by it."""
    return (
        status.sight is not None
        and other in mission.landmarks_of(robot)
        and other not in status.sight_lost
        and other in status.sight_age
    )


def desk_facts(mission: Mission, credentials: Credentials | None, others: Sequence[Facts]) -> Facts:
    """Return facts about the desk: the operator's certificate, this machine's clock, and the leader."""
    leads = {
        one.robot for one in others if isinstance(one.newest_status, LeaderStatus) and one.newest_status.leads
    }
    return Facts(
        mission=mission,
        robot=mission.leader,
        on_robot=False,
        seconds=0.0,
        certificate=_certificate(OPERATOR, credentials),
        chrony=_chrony(),
        leading=tuple(name for name in mission.candidates if name in leads) if mission.standbys else None,
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
                newest = status_codec.from_json(WatchdogStatus, reply.payload)
            except BadMessage:
                continue
            if newest.robot == robot:
                return str(newest.state)
        time.sleep(0.05)
    return ""


def _command_nodes(bus: Bus, mission: Mission, naming: Naming, robot: str) -> Iterator[tuple[str, RosNode]]:
    """Yield the ROS nodes with cmd_vel: MS subscribes, MP publishes."""
    name = naming.robots[robot].spelled(CMD_VEL.key(robot))
    spec = mission.robots[robot]
    if spec.ros == "rmw_zenoh":
        for key in bus.tokens(tokens.all_tokens(spec.domain), TOKEN_TIME):
            token = tokens.read(key)
            if token is not None and token.topic == name and token.zid != bus.zid:
                yield token.kind, RosNode(token.node, token.type)
    else:
        for key in bus.tokens(tokens.ROUTES, TOKEN_TIME):
            route = tokens.read_route(key)
            if route is not None and route.key == name:
                yield route.kind, RosNode("a node behind the bridge", route.type)


def _certificate(name: str, credentials: Credentials | None) -> Certificate | None:
    return None if credentials is None else tls.read(name, credentials)


def _differs(mission: Mission, installed: Path | None) -> str | None:
    if installed is None:
        return None
    with refuse_errors(MissionError):
        return "" if load(installed) == mission else str(installed)


class _Stamped(Protocol):
    @property
    def stamp(self) -> float: ...


def _listen(bus: Bus, seconds: float, enough: Iterable[str] = ()) -> Listened:
    """Return what arrives within `seconds`; stop early once every key in `enough` had a message."""
    received: Listened = {}
    awaited = set(enough)
    ends = time.monotonic() + seconds
    while (left := ends - time.monotonic()) > 0.0:
        bus.wait(left)
        offset = time.time() - time.monotonic()
        for sample in bus.drain():
            received.setdefault(sample.key, []).append((sample, sample.arrived + offset))
        if awaited and awaited <= received.keys():
            break
    return received


def _statuses(
    kind: type[AgentStatus | LeaderStatus], samples: Sequence[tuple[Sample, float]]
) -> tuple[Stream, AgentStatus | LeaderStatus | None]:
    """Return the received statuses of a kind, and the newest."""
    newest: list[AgentStatus | LeaderStatus] = []

    def read(payload: bytes) -> Diagnostics:
        message = decode(Diagnostics, payload)
        status = status_codec.from_message(kind, message)
        newest[:] = newest if status is None else [status]
        return message

    stream = _stream(read, samples)
    return stream, newest[0] if newest else None


def _scans(spec: ScanSpec, samples: Sequence[tuple[Sample, float]]) -> tuple[Stream, tuple[ScanMessage, ...]]:
    """Return the stream of range scans, and what each says."""
    found: list[ScanMessage] = []

    def read(payload: bytes) -> LaserScan:
        raw = decode(LaserScan, payload)
        scan = raw if spec.scanner is None else spec.scanner.corrected(raw)
        beams = len(scan.ranges)
        hits = sum(scan.range_min <= one <= scan.range_max and one > 0.0 for one in scan.ranges)
        steps = beams - 1
        turn = steps * abs(scan.angle_increment) / math.tau
        found.append(ScanMessage(beams, hits, steps * scan.time_increment, turn))
        return raw

    return _stream(read, samples), tuple(found)


def _signs(samples: Sequence[tuple[Sample, float]]) -> tuple[tuple[float, float], ...]:
    """Return signs of life: arrival [s, monotonic], and stated time [s]."""
    found = []
    for sample, _ in samples:
        try:
            found.append((sample.arrived, decode(Number, sample.payload).value))
        except BadMessage:
            continue
    return tuple(found)


def _stream(read: Callable[[bytes], _Stamped], samples: Sequence[tuple[Sample, float]]) -> Stream:
    received, bad, frames = [], [], set()
    for sample, wall in samples:
        try:
            message = read(sample.payload)
        except BadMessage as error:
            bad.append(str(error))
            continue
        received.append(ReceivedMessage(sample.arrived, message.stamp, wall))
        frames.add(str(getattr(message, "frame", "")))
    return Stream(tuple(received), frozenset(frames), tuple(bad))


def _chrony() -> Chrony | None:
    output = output_of(["chronyc", "-c", "-n", "tracking"])
    return None if output is None else read_tracking(output)


def read_tracking(line: str) -> Chrony | None:
    """Parse the line of ``chronyc -c tracking``: field 5 is the offset [s], the last one the leap status."""
    fields = line.strip().split(",")
    try:
        offset = float(fields[4])
    except (IndexError, ValueError):
        return None
    return Chrony(offset, fields[-1] != "Not synchronised")


def _watchdog_unit() -> str | None:
    """Return the state of the watchdog's systemd unit, such as active or failed; None without a unit."""
    facts = unit_facts(WATCHDOG_UNIT, "LoadState,ActiveState")
    return facts.get("ActiveState") if facts.get("LoadState") == "loaded" else None
