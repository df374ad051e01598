"""Status of processes, as typed values; SI units and radians.

`formation.protocol.status_codec` converts them to and from diagnostic_msgs/DiagnosticStatus.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any, ClassVar, NamedTuple, Self

from pydantic import BeforeValidator, Field, PlainValidator, StringConstraints

from formation.control.zones import Zone
from formation.protocol.attachment import Refusal
from formation.protocol.json_message import decode
from formation.protocol.reasons import MAX_ENTRIES, MAX_NUMBER, MAX_TEXT_CHARS, Reason
from formation.protocol.request import OperatorRequest

MAX_REQUESTS_CHARACTERS = 45_000
"""Greatest size of an operator's requests to a leader: the longest route, and more if it fits
[characters]."""

REASONS = frozenset({"reason", "scan_fault", "relative_fault", "realigned_after"})
"""Fields of all statuses that are reasons."""


class AgentState(StrEnum):
    """What an agent is doing."""

    WAITING = "waiting"
    """Stands still; has not yet received all that it needs to begin."""
    RUN = "run"
    """Follows the law."""
    HOLD = "hold"
    """Stands still; goes on by itself when the reason is gone."""
    STOP = "stop"
    """Stands still until it is released."""


class LeaderState(StrEnum):
    """What a candidate is doing: the fleet's mode while it leads, else its part in the election."""

    HOLD = "hold"
    """Leads; the fleet stands still until `run`."""
    RUN = "run"
    """Leads; the fleet drives."""
    STOP = "stop"
    """Leads; the fleet stands still until `release`."""
    LISTENING = "listening"
    """Has just started and finds out whether another process leads."""
    STANDBY = "standby"
    """Does not lead; would take over if the leader fell silent."""
    CANDIDATE = "candidate"
    """Asks the followers for their votes in a new term."""


class WatchdogState(StrEnum):
    """What a robot's watchdog is doing."""

    LISTENING = "listening"
    """Silent; does not know yet whether an agent drives this robot."""
    WATCHING = "watching"
    """Silent; receives signs of life from the agent."""
    BRAKING = "braking"
    """Sends zero velocity: the agent has been silent for three periods."""
    PARKING = "parking"
    """Sends zero velocity for half a second: no agent drives this robot."""
    DISARMED = "disarmed"
    """Silent; the robot has been parked and may be driven by hand."""


class RobotLink(StrEnum):
    """The link from an agent to its robot."""

    UNKNOWN = "unknown"
    """Not known yet."""
    CONNECTED = "connected"
    """Connected to the robot's bridge or router."""
    NOT_CONNECTED = "not_connected"
    """No connection to the robot's bridge or router."""
    NO_LISTENER = "no_listener"
    """Connected, but nothing receives the commands."""


class MotionFault(StrEnum):
    """How a robot does not move as it is commanded."""

    FROZEN = "frozen"
    """Commanded to move, but the position stays."""
    TURN = "turn"
    """Commanded to turn, but the heading stays."""
    SPEEDS = "speeds"
    """Reported speeds contradict the reported positions."""
    CARRIED = "carried"
    """Position moves without a command."""
    TURNED = "turned"
    """Heading turns without a command."""
    LATE = "late"
    """Position follows the commands too late."""


class Sight(StrEnum):
    """What the pose of a robot is based on that must see its neighbours."""

    SEARCHING = "searching"
    """Stands still; its scans do not yet show its neighbours where they say that they are."""
    LOCKED = "locked"
    """Its scans show its neighbours, and correct its pose."""
    RECKONING = "reckoning"
    """It has seen no neighbour for 2 s, and goes on by odometry."""


class CollisionMode(StrEnum):
    """What the collision filter does."""

    ON = "on"
    """Changes commands to avoid collisions."""
    WARN = "warn"
    """Reports what it would change, and changes no command."""
    OFF = "off"
    """Disabled."""


class Localised(StrEnum):
    """How a robot's positions are placed in the world."""

    ODOMETRY_WORLD = "odometry_world"
    """Odometry counts in the world frame."""
    ODOMETRY_START = "odometry_start"
    """Odometry counts from the start pose in the mission."""
    ODOMETRY_MAP = "odometry_map"
    """A localiser such as AMCL places odometry in the map."""
    EXTERNAL = "external"
    """External poses, in the world frame."""


def _split(value: Any) -> Any:
    return tuple(value.split(",")) if isinstance(value, str) else value


def _reason(value: Any) -> Any:
    if isinstance(value, Reason):
        return value
    if not isinstance(value, Mapping) or not isinstance(value.get("code"), str):
        raise ValueError("must be a code with values")
    return Reason.read(value["code"], value)


Real = Annotated[float, Field(allow_inf_nan=False, ge=-MAX_NUMBER, le=MAX_NUMBER)]
Count = Annotated[int, Field(ge=0, lt=2**63)]
Text = Annotated[str, StringConstraints(max_length=MAX_TEXT_CHARS)]
Names = Annotated[tuple[Text, ...], BeforeValidator(_split), Field(max_length=MAX_ENTRIES)]
Reals = Annotated[Mapping[Text, Real], Field(max_length=MAX_ENTRIES)]
Counts = Annotated[Mapping[Text, Count], Field(max_length=MAX_ENTRIES)]
Texts = Annotated[Mapping[Text, Text], Field(max_length=MAX_ENTRIES)]
Why = Annotated[Reason, PlainValidator(_reason)]


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentStatus:
    """One follower's agent."""

    KIND: ClassVar[str] = "agent"
    robot: Text
    state: AgentState
    reason: Why
    readonly: bool = False
    """The robot receives no commands: the state is what the agent would do."""
    law: Text = ""
    mission: Text = ""
    """Fingerprint of the mission that it runs."""
    speed: Real = 0.0
    turn_rate: Real = 0.0
    """Newest command [m/s; rad/s]."""
    k_p: Real | None = None
    k_i: Real | None = None
    """Gains in force [1/s; 1/s²], if they are not the mission's."""
    link: RobotLink = RobotLink.UNKNOWN
    follows: Names = ()
    """Robots that it measures and follows."""
    unavailable: bool = False
    """Not tracking: dependants should prefer another neighbour."""
    motion: MotionFault | None = None
    collisions: CollisionMode | None = None
    """Mode of the collision filter; None if it has nothing to avoid."""
    avoiding: bool = False
    """Whether the filter changes the newest command, or would."""
    avoids: Names = ()
    """Robots that the filter knows by message."""
    avoids_never_received: Names = ()
    """Robots of `avoids` that have never been received."""
    avoided: Count = 0
    """Commands that the filter has changed, or would have."""
    deadlocks: Count = 0
    """Number of times that the robot was blocked and took a detour."""
    zone: Zone | None = None
    """Result of the protective zone for the newest command; None without a range scanner."""
    scan_fault: Why | None = None
    """Why the newest range scan is not believed."""
    relative_fault: Why | None = None
    """Why a neighbour that a sensor measures is not followed."""
    sight: Sight | None = None
    """Only of a robot that must see its neighbours."""
    sight_age: Reals = field(default_factory=dict)
    """Time since the scanner last saw each neighbour that corrects its pose [s]."""
    sight_deviation: Reals = field(default_factory=dict)
    """Standard deviation of each seen neighbour's place relative to this robot [m]."""
    sight_lost: Names = ()
    """Neighbours that have not been seen for 2 s, or never."""
    sight_correction: Real | None = None
    """Distance of the robot's position from where odometry alone would be, without scans [m]."""
    localisation: Localised = Localised.ODOMETRY_WORLD
    realigned: Count = 0
    """Number of times that odometry was placed anew after a jump."""
    realigned_after: Why | None = None
    """The newest of these jumps."""
    jumps: Count = 0
    """Jumps of its own position."""
    late: Count = 0
    """Own positions that came more than half a period late."""
    speed_step: Real | None = None
    turn_rate_step: Real | None = None
    """Resolution of the robot's commands [m/s; rad/s]."""
    speed_remainder: Real | None = None
    turn_rate_remainder: Real | None = None
    """Difference between the commands so far and what the law wanted [m/s; rad/s]."""
    age: Reals = field(default_factory=dict)
    """Time since the newest message of each source: ``odometry``, ``pose``, ``scan``, or a robot [s]."""
    clock: Reals = field(default_factory=dict)
    """Arrival less stamp of sources with stamps that are not believed [s]."""
    contested: Names = ()
    """Neighbours for which two processes publish."""
    forged: Texts = field(default_factory=dict)
    """Robots that relayed forged orders lately, and what was wrong with the newest."""
    other_mission: Texts = field(default_factory=dict)
    """Robots that run another mission, with its tag."""
    refused: Counts = field(default_factory=dict)
    """Number of times that the bus refused others, by kind."""
    dropped: Counts = field(default_factory=dict)
    """Messages that were not used, by key."""
    dropped_last: Texts = field(default_factory=dict)
    """What was wrong with the newest of them."""


class AnsweredRequest(NamedTuple):
    """An operator's request to a leader, and the answer."""

    request: OperatorRequest
    ok: bool
    reason: str

    @property
    def spelled(self) -> dict[str, Any]:
        """As transmitted: the request, whether it was obeyed (``ok``) and the ``reason``."""
        return {**self.request.spelled, "ok": self.ok, "reason": self.reason}

    @classmethod
    def read(cls, data: Any) -> Self:
        """Read untrusted data. Raises ValueError."""
        if not isinstance(data, dict) or not isinstance(data.get("ok"), bool):
            raise ValueError("must be requests with ok and reason")
        request = {name: value for name, value in data.items() if name not in {"ok", "reason"}}
        reason = str(data.get("reason", ""))[:MAX_TEXT_CHARS]
        return cls(decode(OperatorRequest, json.dumps(request).encode()), data["ok"], reason)


def _requests(value: Any) -> tuple[AnsweredRequest, ...]:
    if isinstance(value, tuple):
        return value
    try:
        data = json.loads(value)
        return tuple(AnsweredRequest.read(one) for one in data)
    except (TypeError, RecursionError):
        raise ValueError("must be a list of requests") from None


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaderStatus:
    """One candidate: the leader or a standby."""

    KIND: ClassVar[str] = "leader"
    robot: Text
    """Name of the candidate."""
    state: LeaderState
    reason: Why | None = None
    leads: bool = False
    leader: Text = ""
    """Name of the leader, as far as known; empty for none."""
    term: Count = 0
    """Its own if it leads, else the newest known one."""
    mission: Text = ""
    """Fingerprint of the mission that it runs."""
    latched: LeaderState | None = None
    """The stop or the hold that it keeps while another leads."""
    waits_for: Names = ()
    """Robots that the leader waits for."""
    at_bounds: bool = False
    """Whether it stands because its fleet would leave the mission's bounds."""
    shape: Text = ""
    """Shape that was requested last."""
    share: Reals = field(default_factory=dict)
    """Present shares of shapes."""
    rotation: Real = 0.0
    """Present rotation [rad]."""
    scale: Real = 1.0
    """Present scale."""
    changing: Real = 0.0
    """Remaining time of the shape transition [s]."""
    k_p: Real | None = None
    k_i: Real | None = None
    """Gains of the law [1/s; 1/s²]."""
    route: Text = ""
    """Id of its route."""
    route_time: Real = 0.0
    """Time since it began that route [s]."""
    pace: Real = 0.0
    """Share of its speed at which it moves."""
    beat: Count = 0
    late: Count = 0
    """Periods without a position."""
    requests: Annotated[tuple[AnsweredRequest, ...], PlainValidator(_requests)] = ()
    """An operator's recent requests."""
    refused_by: Annotated[Mapping[Text, Refusal], Field(max_length=MAX_ENTRIES)] = field(default_factory=dict)
    """Robots that refuse its term, and why."""
    other_mission: Texts = field(default_factory=dict)
    """Robots that run another mission, with its tag."""
    forged: Texts = field(default_factory=dict)
    """Robots that relayed forged orders lately, and what was wrong with the newest."""
    forged_count: Counts = field(default_factory=dict)
    """Number of forged orders that each of them has relayed."""
    dropped: Counts = field(default_factory=dict)
    """Messages that were not used, by key."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchdogStatus:
    """One robot's watchdog."""

    KIND: ClassVar[str] = "watchdog"
    robot: Text
    state: WatchdogState


AnyStatus = AgentStatus | LeaderStatus | WatchdogStatus
