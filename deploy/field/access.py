"""Who may say what to whom in the field, and each process's Zenoh configuration, which holds it to that.

`words` is the whole of it: every message that passes between two processes of a mission. What a process takes
from another (ingress) and what it shows it (egress) are the two halves of that list, so whoever keeps to the
list is never refused, and everything else is. The one who receives enforces it: the sender is whoever the
certificate of the link says.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import Any, Literal, NamedTuple

from deploy.field.hosts import MONITOR, OPERATOR, PROTOCOL, Host, hosts
from deploy.refusal import Refusal
from formation.mission import Mission
from formation.mission_rules import VISITORS
from formation.topics import BALLOT, COURSE, GROUND_TRUTH, ORDER, POSITION, STATUS
from formation.transport.wiring import called, members, partners
from monitor.figures.keys import watched

Message = Literal["put", "declare_subscriber", "query", "declare_queryable", "reply"]
ASKED_ALL = ORDER.pattern.format(robot="*")
"""How an operator asks everybody at once."""
NOBODY = "strangers: nothing"
NOTHING = {
    "permission": "deny",
    "flows": ["ingress", "egress"],
    "messages": [
        "put", "delete", "declare_subscriber", "query", "declare_queryable", "reply",
        "liveliness_token", "liveliness_query", "declare_liveliness_subscriber",
    ],
    "key_exprs": ["**"],
}  # fmt: skip
"""Zenoh's rule for those of the mission who have no word for each other."""


class Word(NamedTuple):
    """One thing that one process may say to another."""

    sender: str
    receiver: str
    message: Message
    key: str
    """Without the team's namespace."""


def processes(mission: Mission) -> tuple[str, ...]:
    """Whoever has a configuration: each robot (the leader first), each standby, the monitor, the operator."""
    return (*members(mission), *VISITORS)


def words(mission: Mission) -> Iterator[Word]:
    """Everything that may be said, once."""
    yield from dict.fromkeys((*_in_the_fleet(mission), *_to_visitors(mission)))


def _in_the_fleet(mission: Mission) -> Iterator[Word]:
    """Positions to who measures them, and to who may lead; ballots of those, and the leader's course."""
    for me in mission.followers:
        for other in mission.heard(me):
            for speaker in _voices(mission, other):
                yield from _listens(me, speaker, POSITION.key(other))
        for one in mission.candidates if mission.standbys else ():
            yield from _listens(me, one, BALLOT.key(one))
    for me in mission.candidates:
        for other in partners(mission, me):
            said = (BALLOT, COURSE) if other in mission.candidates else (POSITION,)
            for topic in said:
                yield from _listens(me, other, topic.key(other))


def _to_visitors(mission: Mission) -> Iterator[Word]:
    """Everything about everybody to the monitor; states and answers to the operator."""
    for one in watched(mission):
        if one.topic is not GROUND_TRUTH:  # the simulation's, not the robot's
            for speaker in _voices(mission, one.robot) if one.topic is POSITION else (one.robot,):
                yield from _listens(MONITOR, speaker, one.key)
    for me in members(mission):
        for visitor in VISITORS:
            yield from _listens(visitor, me, STATUS.key(me))
        order = ORDER.key(me)
        for key in (order, ASKED_ALL):
            yield Word(OPERATOR, me, "query", key)
        yield Word(me, OPERATOR, "declare_queryable", order)
        yield Word(me, OPERATOR, "reply", order)


def configuration(mission: Mission, process: str, folder: PurePath) -> dict[str, Any]:
    """Zenoh's configuration of one process, whose key and certificates are in `folder`. Raises Refusal."""
    if process not in processes(mission):
        raise Refusal(f"{process!r}: must be one of {', '.join(processes(mission))}")
    where = hosts(mission)
    return {
        "mode": "peer",
        **({"namespace": mission.team} if mission.team else {}),
        "listen": {"endpoints": _listened(where[process]) if process in where else []},
        "connect": {"endpoints": [where[other].endpoint for other in _dialled(mission, process)]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"link": {"protocols": [PROTOCOL], "tls": _tls(folder)}},
        "access_control": access_control(mission, process),
    }


def access_control(mission: Mission, process: str) -> dict[str, Any]:
    """Zenoh's rules for one process: `words`, and nothing else."""
    rules: dict[str, dict[str, Any]] = {}
    policies: dict[str, list[str]] = {}
    prefix = f"{mission.team}/" if mission.team else ""
    for word in words(mission):
        if process not in {word.sender, word.receiver}:
            continue
        comes = word.receiver == process
        peer = word.sender if comes else word.receiver
        name = f"{'from' if comes else 'to'} {peer}: {word.message}"
        rule = rules.setdefault(
            name,
            {
                "id": name,
                "permission": "allow",
                "flows": ["ingress" if comes else "egress"],
                "messages": [word.message],
                "key_exprs": [],
            },
        )
        rule["key_exprs"].append(prefix + word.key)
        if name not in policies.setdefault(peer, []):
            policies[peer].append(name)
    strangers = [name for name in processes(mission) if name != process and name not in policies]
    if strangers:
        # Nothing is allowed to them anyway; but whom Zenoh knows by name it also names when it refuses him.
        rules[NOBODY] = {"id": NOBODY, **NOTHING}
        policies.update((name, [NOBODY]) for name in strangers)
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
    """A configuration as the file `formation … -c` reads: JSON5. Raises nothing."""
    return (
        f"// Zenoh configuration of {process} in the mission {mission.name}, made by `formation deploy`.\n"
        "// It links with whom the mission names and nobody else, both sides proving who they are (mTLS),\n"
        "// and each may say only what the rules below allow: nobody speaks for another. Do not edit it:\n"
        "// a change of the mission changes all of these files.\n" + json.dumps(settings, indent=2) + "\n"
    )


def _listens(listener: str, speaker: str, key: str) -> Iterator[Word]:
    yield Word(listener, speaker, "declare_subscriber", key)
    yield Word(speaker, listener, "put", key)


def _voices(mission: Mission, robot: str) -> tuple[str, ...]:
    """Who says where a robot is: its agent; where the leader is, whoever leads."""
    return mission.candidates if robot == mission.leader else (robot,)


def _dialled(mission: Mission, process: str) -> tuple[str, ...]:
    """Whom a process dials: visitors everybody, of two others the one listed later the other."""
    return members(mission) if process in VISITORS else called(mission, process)


def _listened(host: Host) -> list[str]:
    """An address is listened on as it is; a name may mean the wrong interface, so all of them are."""
    return [host.endpoint if host.ip is not None else Host("::", host.port).endpoint]


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
