"""A mission in the field: where its processes listen, what they may send, and their Zenoh configurations.

`permissions` lists every message between two processes of a mission. The messages that a process accepts from
another (ingress) and sends to it (egress) are the two halves of that list: listed messages are never refused,
all others always. The receiver enforces it: the certificate of the link identifies the sender.
"""

from __future__ import annotations

import ipaddress
import json
from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import Any, Literal, NamedTuple

from formation.deploy.refusal import Refusal
from formation.mission.model import Mission
from formation.mission.rules import VISITORS
from formation.monitor.metrics.keys import watched
from formation.topics import BALLOT, GROUND_TRUTH, ORDER, POSITION, ROUTE, STATUS
from formation.transport.wiring import called, members, named, partners

MONITOR, OPERATOR = VISITORS
"""Processes with a certificate outside the fleet. Both only dial and do not listen."""
PROTOCOL = "tls"
Message = Literal["put", "declare_subscriber", "query", "declare_queryable", "reply"]
REQUESTED_ALL = ORDER.pattern.format(robot="*")
"""Key of a query by which an operator asks all processes at once."""
AUTHORITY = "ca"
"""Folder of the certificate authority, beside those of the processes."""
NO_MESSAGES = "other processes: no messages"
"""Id of Zenoh's rule for processes of the mission with no permitted message between them."""
DENY_ALL = {
    "permission": "deny",
    "flows": ["ingress", "egress"],
    "messages": [
        "put", "delete", "declare_subscriber", "query", "declare_queryable", "reply",
        "liveliness_token", "liveliness_query", "declare_liveliness_subscriber",
    ],
    "key_exprs": ["**"],
}  # fmt: skip
"""That rule."""


class Host(NamedTuple):
    """Host of a robot's agent, the leader or a standby."""

    address: str
    """IP address or DNS name, without brackets."""
    port: int

    @property
    def ip(self) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
        """The address; None for a name."""
        try:
            return ipaddress.ip_address(self.address)
        except ValueError:
            return None

    @property
    def endpoint(self) -> str:
        """The endpoint in Zenoh's notation."""
        bracketed = f"[{self.address}]" if ":" in self.address else self.address
        return f"{PROTOCOL}/{bracketed}:{self.port}"


def hosts(mission: Mission) -> Mapping[str, Host]:
    """Return the host of each robot and standby, in the order of `members`.

    Raises Refusal for a mission that is not for the field.
    """
    ends = {name: end or "" for name, end in named(mission).items()}
    missing = [name for name, end in ends.items() if not end]
    if missing:
        table = "robots" if missing[0] in mission.robots else "standbys"
        raise Refusal(
            f"mission {mission.name}: {', '.join(missing)} without endpoint; in the field every robot (and"
            f" the leader, and each standby) needs one that the others can dial, such as"
            f" endpoint = {PROTOCOL + '/192.168.1.12:7460'!r} in [{table}.{missing[0]}]"
        )
    if AUTHORITY in ends:
        raise Refusal(
            f"mission {mission.name}: no robot or standby of the field can be called {AUTHORITY!r}: its key"
            " would replace the key of the authority, which is in the folder of that name; rename it"
        )
    for name in VISITORS:
        if name in mission.robots:
            raise Refusal(
                f"mission {mission.name}: no robot of the field can be called {name!r}, as that is the name"
                f" in the {name}'s certificate; rename it"
            )
    return {name: _host(name, end) for name, end in ends.items()}


def _host(name: str, endpoint: str) -> Host:
    protocol, _, place = endpoint.partition("/")
    address, _, port = place.rpartition(":")
    host = Host(address.removeprefix("[").removesuffix("]"), int(port))
    where = f"endpoint {endpoint!r} of {name}"
    if protocol != PROTOCOL:
        raise Refusal(f"{where}: must begin with '{PROTOCOL}/', as only TLS proves which process sends")
    if host.ip is not None and host.ip.is_unspecified:
        raise Refusal(f"{where}: must be the address that the others dial, not one that stands for all")
    if ":" in host.address:
        raise Refusal(f"{where}: must be an IPv4 address or a name: Zenoh cannot verify IPv6 addresses")
    if not host.address.isascii():
        raise Refusal(f"{where}: must be an IPv4 address or a name in ASCII: a certificate says it")
    return host


class Permission(NamedTuple):
    """One message that one process may send to another."""

    sender: str
    receiver: str
    message: Message
    key: str
    """The key, without the fleet's namespace."""


def processes(mission: Mission) -> tuple[str, ...]:
    """Return the processes with a configuration: robots (leader first), standbys, monitor, operator."""
    return (*members(mission), *VISITORS)


def permissions(mission: Mission) -> Iterator[Permission]:
    """Yield every permitted message, once."""
    yield from dict.fromkeys((*_in_the_fleet(mission), *_to_visitors(mission)))


def _in_the_fleet(mission: Mission) -> Iterator[Permission]:
    """Yield positions to the robots that measure them and to candidates; candidates' ballots and routes."""
    for me in mission.followers:
        for other in mission.received_by(me):
            for publisher in _publishers(mission, other):
                yield from _subscription(me, publisher, POSITION.key(other))
        for one in mission.candidates if mission.standbys else ():
            yield from _subscription(me, one, BALLOT.key(one))
    for me in mission.candidates:
        for other in partners(mission, me):
            topics = (BALLOT, ROUTE) if other in mission.candidates else (POSITION,)
            for topic in topics:
                yield from _subscription(me, other, topic.key(other))


def _to_visitors(mission: Mission) -> Iterator[Permission]:
    """Yield all messages to the monitor; states and answers to the operator."""
    for one in watched(mission):
        if one.topic is not GROUND_TRUTH:  # of the simulation, not of the robot
            for publisher in _publishers(mission, one.robot) if one.topic is POSITION else (one.robot,):
                yield from _subscription(MONITOR, publisher, one.key)
    for me in members(mission):
        for visitor in VISITORS:
            yield from _subscription(visitor, me, STATUS.key(me))
        order = ORDER.key(me)
        for key in (order, REQUESTED_ALL):
            yield Permission(OPERATOR, me, "query", key)
        yield Permission(me, OPERATOR, "declare_queryable", order)
        yield Permission(me, OPERATOR, "reply", order)


def configuration(mission: Mission, process: str, folder: PurePath) -> dict[str, Any]:
    """Return the Zenoh configuration of one process; `folder` has its certificates. Raises Refusal."""
    if process not in processes(mission):
        raise Refusal(f"{process!r}: must be one of {', '.join(processes(mission))}")
    where = hosts(mission)
    # visitors dial all, of two others the one that is listed later dials
    dialled = members(mission) if process in VISITORS else called(mission, process)
    own = where.get(process)  # it listens at an address itself; for a name, on all interfaces
    listened = [] if own is None else [own if own.ip is not None else Host("::", own.port)]
    return {
        "mode": "peer",
        **({"namespace": mission.team} if mission.team else {}),
        "listen": {"endpoints": [host.endpoint for host in listened]},
        "connect": {"endpoints": [where[other].endpoint for other in dialled]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"link": {"protocols": [PROTOCOL], "tls": _tls(folder)}},
        "access_control": access_control(mission, process),
    }


def access_control(mission: Mission, process: str) -> dict[str, Any]:
    """Return Zenoh's rules for one process: `permissions`, and nothing else."""
    rules: dict[str, dict[str, Any]] = {}
    policies: dict[str, list[str]] = {}
    prefix = f"{mission.team}/" if mission.team else ""
    for one in permissions(mission):
        if process not in {one.sender, one.receiver}:
            continue
        incoming = one.receiver == process
        peer = one.sender if incoming else one.receiver
        name = f"{'from' if incoming else 'to'} {peer}: {one.message}"
        rule = rules.setdefault(
            name,
            {
                "id": name,
                "permission": "allow",
                "flows": ["ingress" if incoming else "egress"],
                "messages": [one.message],
                "key_exprs": [],
            },
        )
        rule["key_exprs"].append(prefix + one.key)
        if name not in policies.setdefault(peer, []):
            policies[peer].append(name)
    others = [name for name in processes(mission) if name != process and name not in policies]
    if others:
        # Denied by default as well; but Zenoh's log names only a listed process when it refuses its message.
        rules[NO_MESSAGES] = {"id": NO_MESSAGES, **DENY_ALL}
        policies.update((name, [NO_MESSAGES]) for name in others)
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": list(rules.values()),
        "subjects": [
            {"id": peer, "cert_common_names": [peer], "link_protocols": [PROTOCOL]} for peer in policies
        ],
        "policies": [{"subjects": [peer], "rules": names} for peer, names in policies.items()],
    }


def text(mission: Mission, process: str, settings: Mapping[str, Any]) -> str:
    """Return a configuration as the JSON5 file for `formation … -c`."""
    return (
        f"// Zenoh configuration of {process} in the mission {mission.name}, made by `formation deploy`.\n"
        "// It links only with the processes that the mission names, both proving their identity (mTLS),\n"
        "// and each may send only what the rules below allow, under its own name. Do not edit it:\n"
        "// a change of the mission changes all of these files.\n" + json.dumps(settings, indent=2) + "\n"
    )


def _subscription(listener: str, publisher: str, key: str) -> Iterator[Permission]:
    yield Permission(listener, publisher, "declare_subscriber", key)
    yield Permission(publisher, listener, "put", key)


def _publishers(mission: Mission, robot: str) -> tuple[str, ...]:
    """Return the publishers of a robot's position: its agent; for the leader, all candidates."""
    return mission.candidates if robot == mission.leader else (robot,)


def _tls(folder: PurePath) -> dict[str, Any]:
    key, certificate, trusted = (str(folder / name) for name in ("key.pem", "certificate.pem", "ca.pem"))
    return {
        "root_ca_certificate": trusted,
        "enable_mtls": True,
        "listen_private_key": key,
        "listen_certificate": certificate,
        "connect_private_key": key,
        "connect_certificate": certificate,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }
