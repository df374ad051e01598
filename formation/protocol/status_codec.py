"""Convert a process's status to and from diagnostic_msgs/DiagnosticStatus.

Programs read the values: stable keys (``age.robot3`` for data of each robot), numbers, codes and names.
The message is a sentence for people; no program reads it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import cache
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from formation.protocol.reasons import MAX_TEXT_CHARS, Reason, bounded
from formation.protocol.status import (
    MAX_REQUESTS_CHARACTERS,
    REASONS,
    AgentState,
    AgentStatus,
    AnsweredRequest,
    AnyStatus,
    LeaderState,
    LeaderStatus,
    MotionFault,
    RobotLink,
    Sight,
    WatchdogState,
    WatchdogStatus,
)
from formation.ros2 import messages
from formation.ros2.messages import Diagnostics, Status
from formation.wire import BadMessage

OK, WARNING = 0, 1
"""Levels of a DiagnosticStatus."""
MAX_REPLY_BYTES = 4096
"""Greatest size of a status in a reply."""
KIND = "kind"
"""Key of the kind of a status: ``agent``, ``leader`` or ``watchdog``."""
LINKS: Mapping[RobotLink, str] = MappingProxyType(
    {
        RobotLink.UNKNOWN: "unknown",
        RobotLink.CONNECTED: "connected",
        RobotLink.NOT_CONNECTED: "not connected",
        RobotLink.NO_LISTENER: "no listener on cmd_vel: no node of the robot takes commands",
    }
)
"""The link to the robot, for people."""
MOTION_FAULTS: Mapping[MotionFault, str] = MappingProxyType(
    {
        MotionFault.FROZEN: "does not move as commanded",
        MotionFault.TURN: "does not turn as commanded",
        MotionFault.SPEEDS: "its speeds contradict its positions",
        MotionFault.CARRIED: "moved without a command",
        MotionFault.TURNED: "turned without a command",
        MotionFault.LATE: "its position is late",
    }
)
"""How a robot does not move as it is commanded, for people."""

KINDS = AgentStatus, LeaderStatus, WatchdogStatus
FIELDS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {kind.KIND: tuple(one.name for one in fields(kind)) for kind in KINDS}
)
"""The fields of each kind of status."""
S = TypeVar("S", bound=AnyStatus)


def to_message(status: AnyStatus, stamp: float) -> Diagnostics:
    """The status of `stamp` [s, sender's system clock] as a message."""
    return Diagnostics(stamp, (encode(status),))


def from_message(kind: type[S], message: Diagnostics) -> S | None:
    """The first status in it; None if there is none. Raises BadMessage if it is no such status."""
    return decode(kind, message.statuses[0]) if message.statuses else None


def read(kind: type[S], payload: bytes) -> S | None:
    """The status in the bytes of a message; None if there is none. Raises BadMessage, and nothing else."""
    return from_message(kind, messages.decode(Diagnostics, payload))


def to_json(status: AnyStatus) -> bytes:
    """Its keys and values as JSON: the reply of a queryable."""
    return json.dumps(dict(encode(status).values)).encode()


def from_json(kind: type[S], data: bytes) -> S:
    """Decode the status in a reply. Raises BadMessage, and nothing else, if it is invalid."""
    try:
        decoded = json.loads(data) if len(data) <= MAX_REPLY_BYTES else None
    except (ValueError, RecursionError):
        decoded = None
    if not isinstance(decoded, dict) or not all(isinstance(one, str) for one in decoded.values()):
        raise BadMessage("status: is no JSON object of texts")
    return decode(kind, Status("", OK, "", values=decoded))


def encode(status: AnyStatus) -> Status:
    """One status, with its level and its sentence."""
    values = {KIND: status.KIND, **dict(_values(status))}
    level = OK if sound(status) else WARNING
    return Status(f"{status.robot}: {status.KIND}", level, sentence(status), status.robot, values)


def decode(kind: type[S], status: Status) -> S:
    """Decode a typed status. Raises BadMessage, and nothing else; unknown keys are ignored."""
    if status.values.get(KIND) != kind.KIND:
        found_kind = str(status.values.get(KIND, "missing"))[:40]
        raise BadMessage(f"status: kind is {found_kind}, must be {kind.KIND}")
    try:
        read: S = _reader(kind.KIND).validate_python(_grouped(FIELDS[kind.KIND], status.values))
        return read
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
    where = ".".join(map(str, first["loc"]))[:MAX_TEXT_CHARS]
    raise BadMessage(f"status: {where + ': ' if where else ''}{first['msg']}")


def sound(status: AnyStatus) -> bool:
    """Whether the process works and has no doubts."""
    if isinstance(status, LeaderStatus):
        at_bounds = status.leads and status.at_bounds
        doubts = status.forged or status.other_mission or status.refused_by or at_bounds
        return status.state in {LeaderState.RUN, LeaderState.STANDBY} and not doubts
    if isinstance(status, WatchdogStatus):
        return status.state is not WatchdogState.BRAKING
    faults = status.clock or status.scan_fault or status.relative_fault or status.motion
    lost = status.sight not in {None, Sight.LOCKED}
    others = status.contested or status.forged
    linked = status.link in {RobotLink.UNKNOWN, RobotLink.CONNECTED}
    return status.state is AgentState.RUN and linked and not (status.readonly or faults or others or lost)


def shown_state(status: AnyStatus) -> str:
    """The state, for people: if the robot receives no commands, what the agent would do."""
    readonly = isinstance(status, AgentStatus) and status.readonly
    return f"readonly: would {status.state}" if readonly else str(status.state)


def sentence(status: AnyStatus) -> str:
    """The sentence for people: the state, its reason, and other faults."""
    if isinstance(status, WatchdogStatus):
        return str(status.state)
    parts = [f"{shown_state(status)}: {status.reason}" if status.reason else shown_state(status)]
    if isinstance(status, AgentStatus):
        parts += _doubts(status)
    if status.forged:
        parts.append(f"{', '.join(status.forged)} relayed forged orders")
    return "; ".join(parts)


def _doubts(status: AgentStatus) -> Iterator[str]:
    if status.clock:
        yield f"stamps of {', '.join(status.clock)} not believed"
    if status.scan_fault is not None and status.scan_fault != status.reason:
        yield str(status.scan_fault)
    if status.relative_fault is not None and status.relative_fault != status.reason:
        yield str(status.relative_fault)
    if status.sight is Sight.RECKONING and not status.reason.code.startswith("sight_"):
        yield f"does not see {', '.join(status.sight_lost)}: goes on by odometry"
    if status.contested:
        yield f"two agents publish for {', '.join(status.contested)}"
    if status.link not in {RobotLink.UNKNOWN, RobotLink.CONNECTED}:
        yield f"robot link: {LINKS[status.link]}"
    if status.motion is not None and not status.reason.code.startswith("motion_"):
        yield MOTION_FAULTS[status.motion]


def _values(status: AnyStatus) -> Iterator[tuple[str, str]]:
    for name in FIELDS[status.KIND]:
        value = getattr(status, name)
        if name == "requests":
            if value:
                yield name, _spelled(value)
        elif isinstance(value, Reason):
            yield name, str(value.code)
            yield from _flat(name, value.values)
        else:
            yield from _flat(name, value)


def _flat(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Keys and texts of a value; nothing for unknown or empty values."""
    if value is None:
        return
    if isinstance(value, bool):
        yield name, "true" if value else "false"
    elif isinstance(value, float):
        yield name, repr(bounded(value))
    elif isinstance(value, tuple):
        if value:
            yield name, ",".join(value)
    elif isinstance(value, str):
        quoted = name.startswith(("forged.", "dropped_last."))
        yield name, value[:MAX_TEXT_CHARS] if quoted else str(value)
    elif isinstance(value, Mapping):
        for key, part in value.items():
            yield from _flat(f"{name}.{key}", part)
    else:
        yield name, str(value)


def _spelled(requests: tuple[AnsweredRequest, ...]) -> str:
    """A JSON list; the newest entries that fit into a status."""
    parts: list[str] = []
    for one in reversed(requests):
        spelled = json.dumps(one.spelled, ensure_ascii=False)
        if len(spelled) + sum(map(len, parts)) <= MAX_REQUESTS_CHARACTERS:
            parts.insert(0, spelled)
    return f"[{', '.join(parts)}]"


def _grouped(known: tuple[str, ...], values: Mapping[str, str]) -> dict[str, Any]:
    """Values of dotted keys grouped by their first word; a reason has its code beside its values.

    A value of a reason may itself be a mapping, by robot.
    """
    found = dict[str, Any]()
    for key, value in values.items():
        name, dot, rest = key.partition(".")
        if name not in known:
            continue
        if name in REASONS:
            place = [name, *(rest.split(".", 1) if dot else ["code"])]
        else:
            place = [name, rest] if dot else [name]
        group: Any = found
        for part in place[:-1]:
            group = group.setdefault(part, {}) if isinstance(group, dict) else None
        if isinstance(group, dict):
            group[place[-1]] = value
    return found


@cache
def _reader(kind: str) -> TypeAdapter[Any]:
    """Built on demand: most processes read no status."""
    return TypeAdapter({one.KIND: one for one in KINDS}[kind])
