"""May this robot move? One table, read from the top: the first row that applies decides.

Every row but the last commands zero velocity, except for probes of a few centimetres where `probes` is set.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple, cast

from formation.agent.pose.motion_check import MIN_MOTION_SHARE, Disagreement
from formation.protocol.attachment import mixed
from formation.protocol.order import LEADER_TIMEOUT_SECONDS, Mode, Order
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import AgentState, MotionFault


class Unanswered(NamedTuple):
    """A robot's messages may be late, or its clock may be wrong."""

    late: float
    """Lateness of its newest message by its stamp; negative from the future [s]."""
    limit: float
    """[s]"""


class Facts(NamedTuple):
    """All inputs of the table."""

    latched: Mode | None
    """The operator's request to this robot."""
    silence: float
    """Of the robot's own position source [s]; infinite before the first message."""
    limit: float
    """[s]"""
    jumped: Reason | None
    """A recent jump of it."""
    order: Order | None
    """The newest order that a neighbour relayed."""
    beat_silence: float
    """Since the leader's beat last rose [s]."""
    neighbours: Mapping[str, float]
    """Silence of each neighbour [s], infinite before the first message; empty while any is followed."""
    followed: int
    """Number of neighbours that are followed, or would be."""
    follows: bool = True
    """Whether the newest own position closed an interval."""
    finite: bool = True
    """Whether the law's result is finite."""
    source: str = "odometry"
    """Source of the robot's own position."""
    refused: str = ""
    """Why its newest message was refused, if it was; an error's text."""
    doubt: Reason | None = None
    """Why the own position is not believed though it did not jump."""
    why: Reason | None = None
    """Why `latched` is in force, unless an operator asked this process for it."""
    connected: bool | None = None
    """Whether there is a link to the robot; None if unknown."""
    routed: bool | None = None
    """Whether the robot receives commands; None if unknown."""
    unanswered: Mapping[str, Unanswered] = MappingProxyType({})
    """Robots that may be late: their stamps are off, and they do not answer."""
    relative_doubt: Reason | None = None
    """Why the sensor that measures a neighbour is not believed, though the robot needs it."""
    sight_doubt: Reason | None = None
    """Why the robot's pose among its neighbours cannot be relied on, though it must see them."""
    not_followed: tuple[str, ...] = ()
    """Neighbours that are received and not followed: unavailable, or following only this robot."""
    scan_silence: float = 0.0
    """Of a scanner that the mission requires [s]; infinite before its first scan, 0 if none is required."""
    scan_limit: float = float("inf")
    """[s]"""
    scan_refused: str = ""
    """Why its newest scan was refused, if it was; an error's text."""
    scan_doubt: Reason | None = None
    """Why the newest scan of a scanner that the mission requires is not believed."""
    outside: Reason | None = None
    """How the robot is outside the mission's bounds."""
    beyond: tuple[str, ...] = ()
    """Neighbours that report positions outside the bounds; the robot does not follow them."""
    unsigned: str | None = None
    """Why a recent order was refused for its signature: an error's text."""
    too_old: bool = False
    """Whether the robot's own position is too old to act on, or was until just now."""
    age: float = 0.0
    """Age of the newest own position on arrival [s]."""
    age_limit: float = float("inf")
    """Limit of `age` [s]."""
    leaderless: bool = False
    """Whether the leader itself is among the neighbours, and silent."""
    frozen: float = 0.0
    """Time for which this process was frozen, until enough has been received since [s]; 0 if it was not."""
    missing: tuple[str, ...] = ()
    """What has not been received since then."""
    motion: Disagreement | None = None
    """How the robot's motion differs from its commands."""
    probe_blocked: bool = False
    """Whether it had no room for its newest probe."""
    rival: bool = False
    """Whether another agent commands this robot."""
    mission: str = ""
    """Tag of the mission that this robot runs."""
    other_missions: Mapping[str, str] = MappingProxyType({})
    """Robots of which it receives messages and that run another mission, with its tag."""

    @property
    def beat_limit(self) -> float:
        """Limit of `beat_silence` [s]."""
        return LEADER_TIMEOUT_SECONDS if self.order is None else self.order.timeout


class Row(NamedTuple):
    """One row: its condition, the robot's state, and the reason."""

    applies: Callable[[Facts], bool]
    state: AgentState
    reason: Callable[[Facts], Reason]
    own: bool = False
    """Whether it concerns this robot alone, while others may continue."""
    probes: bool = False
    """Whether the robot may move a little, to test whether it moves as commanded."""


class Decision(NamedTuple):
    """The table's decision, and its reason."""

    state: AgentState
    reason: Reason
    own: bool = False
    """Whether others may continue without this robot."""
    probes: bool = False
    """Whether it may move a little, to test whether it moves as commanded."""


def _never(silence: float) -> bool:
    return silence == float("inf")


def _no_neighbour(facts: Facts) -> Reason:
    beyond = [name for name in facts.neighbours if name in facts.beyond]
    unavailable = [name for name in facts.neighbours if name in facts.not_followed and name not in beyond]
    others = {n: age for n, age in facts.neighbours.items() if n not in beyond and n not in unavailable}
    return Reason.of(
        Code.NO_NEIGHBOUR,
        silent={name: age for name, age in others.items() if not _never(age)},
        never_received=[name for name, age in others.items() if _never(age)],
        unavailable=unavailable,
        outside=beyond,
    )


def _unanswered(facts: Facts) -> Reason:
    late = {name: one.late for name, one in facts.unanswered.items()}
    return Reason.of(Code.UNANSWERED, late=late, limit=min(one.limit for one in facts.unanswered.values()))


def _mixed(facts: Facts) -> Reason:
    return mixed(*next(iter(facts.other_missions.items())), facts.mission)


_FAULTS = {
    MotionFault.FROZEN: Code.MOTION_FROZEN,
    MotionFault.TURN: Code.MOTION_TURN,
    MotionFault.SPEEDS: Code.MOTION_SPEEDS,
    MotionFault.CARRIED: Code.MOTION_CARRIED,
    MotionFault.TURNED: Code.MOTION_TURNED,
    MotionFault.LATE: Code.MOTION_LATE,
}
_SENSORS = {"odometry": "encoders", "pose": "tracker"}


def _motion(facts: Facts) -> Reason:
    """How the robot does not move as commanded; it probes by itself."""
    if facts.motion is None:
        raise ValueError("this row does not apply")
    kind, expected, seen, over = facts.motion
    reason = Reason.of(
        _FAULTS[kind],
        source=facts.source,
        sensor=_SENSORS[facts.source],
        expected=expected,
        seen=seen,
        duration=over,
        least=MIN_MOTION_SHARE * expected,
        unit="rad" if kind in {MotionFault.TURN, MotionFault.TURNED} else "m",
    )
    return Reason.of(Code.PROBE_BLOCKED, detail=str(reason)) if facts.probe_blocked else reason


def _refused(facts: Facts) -> Reason | None:
    """That positions come, and are refused; None if they do not come."""
    if not facts.refused:
        return None
    return Reason.of(Code.POSITION_REFUSED, source=facts.source, detail=facts.refused)


def _scan_refused(facts: Facts) -> Reason | None:
    """That scans come, and are refused; None if they do not come."""
    return Reason.of(Code.SCAN_REFUSED, detail=facts.scan_refused) if facts.scan_refused else None


def _too_old(facts: Facts) -> Reason:
    code = Code.POSITION_WAS_LATE if facts.age <= facts.age_limit else Code.POSITION_LATE
    return Reason.of(code, source=facts.source, age=facts.age, limit=facts.age_limit)


def _unsigned(facts: Facts) -> Reason:
    return Reason.of(Code.ORDER_UNSIGNED, detail=facts.unsigned or "")


def _doubted(reason: Callable[[Facts], Reason | None]) -> Row:
    """A row that applies while there is such a reason."""
    return Row(
        lambda f: reason(f) is not None, AgentState.HOLD, lambda f: cast("Reason", reason(f)), own=True
    )


def _plain(code: Code) -> Callable[[Facts], Reason]:
    """A reason without values."""
    reason = Reason(code)
    return lambda _: reason


TABLE: tuple[Row, ...] = (
    Row(
        lambda f: f.latched == "stop",
        AgentState.STOP,
        lambda f: f.why or Reason(Code.STOPPED_BY_OPERATOR),
        own=True,
    ),
    Row(lambda f: not f.finite, AgentState.HOLD, _plain(Code.COMMAND_NOT_FINITE), own=True),
    Row(lambda f: f.connected is False, AgentState.HOLD, _plain(Code.NO_LINK), own=True),
    Row(lambda f: f.rival, AgentState.HOLD, _plain(Code.SECOND_AGENT), own=True),
    Row(
        lambda f: f.frozen > 0.0,
        AgentState.WAITING,
        lambda f: Reason.of(Code.PROCESS_FROZEN, duration=f.frozen, missing=f.missing),
        own=True,
    ),
    Row(
        lambda f: _never(f.silence),
        AgentState.WAITING,
        lambda f: _refused(f) or Reason.of(Code.NO_POSITION, source=f.source),
        own=True,
    ),
    Row(
        lambda f: f.silence > f.limit,
        AgentState.HOLD,
        lambda f: (
            _refused(f) or Reason.of(Code.POSITION_SILENT, source=f.source, age=f.silence, limit=f.limit)
        ),
        own=True,
    ),
    Row(lambda f: f.too_old, AgentState.HOLD, _too_old, own=True),
    _doubted(lambda f: f.jumped),
    _doubted(lambda f: f.doubt),
    Row(
        lambda f: not f.follows,
        AgentState.HOLD,
        lambda f: Reason.of(Code.POSITION_GAP, source=f.source, limit=f.limit),
        own=True,
    ),
    _doubted(lambda f: f.outside),
    Row(
        lambda f: _never(f.scan_silence),
        AgentState.WAITING,
        lambda f: _scan_refused(f) or Reason(Code.NO_SCAN),
        own=True,
    ),
    Row(
        lambda f: f.scan_silence > f.scan_limit,
        AgentState.HOLD,
        lambda f: _scan_refused(f) or Reason.of(Code.SCAN_SILENT, age=f.scan_silence, limit=f.scan_limit),
        own=True,
    ),
    _doubted(lambda f: f.scan_doubt),
    Row(lambda f: f.routed is False, AgentState.HOLD, _plain(Code.NO_LISTENER), own=True),
    Row(lambda f: bool(f.other_missions), AgentState.HOLD, _mixed, own=True),
    Row(
        lambda f: f.unsigned is not None and (f.order is None or f.beat_silence > f.beat_limit),
        AgentState.HOLD,
        _unsigned,
        own=True,
    ),
    Row(lambda f: f.order is None, AgentState.WAITING, _plain(Code.NO_ORDER)),
    Row(
        lambda f: f.beat_silence > f.beat_limit,
        AgentState.HOLD,
        lambda f: Reason.of(Code.LEADER_LOST, age=f.beat_silence, limit=f.beat_limit),
        own=True,  # some robots may still receive it
    ),
    Row(
        lambda f: f.order is not None and f.order.mode == "stop",
        AgentState.STOP,
        _plain(Code.STOPPED_BY_LEADER),
    ),
    Row(
        lambda f: f.latched == "hold",
        AgentState.HOLD,
        lambda f: f.why or Reason(Code.HELD_BY_OPERATOR),
        own=True,
    ),
    Row(
        lambda f: f.order is not None and f.order.mode == "hold", AgentState.HOLD, _plain(Code.HELD_BY_LEADER)
    ),
    Row(lambda f: bool(f.unanswered), AgentState.HOLD, _unanswered, own=True),
    _doubted(lambda f: f.relative_doubt),
    _doubted(lambda f: f.sight_doubt),
    # its beat will show whether the leader or only this link is down
    Row(lambda f: not f.followed and f.leaderless, AgentState.HOLD, _no_neighbour),
    Row(lambda f: not f.followed, AgentState.HOLD, _no_neighbour, own=True),
    # the last doubt: a probe needs everything else to be well
    Row(lambda f: f.motion is not None, AgentState.HOLD, _motion, own=True, probes=True),
    Row(lambda _: True, AgentState.RUN, _plain(Code.RUNNING)),
)


def decide(facts: Facts) -> Decision:
    """Return the decision of the first row that applies."""
    row = next(row for row in TABLE if row.applies(facts))
    return Decision(row.state, row.reason(facts), row.own, row.probes)
