"""Facts about one robot, before judging. Gathering fills them in; None means not examined."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal, NamedTuple

from formation.mission.model import Mission
from formation.protocol.status import AgentStatus, LeaderStatus
from formation.transport.wiring import role

Outcome = Literal[
    "ok", "refused", "no route", "no answer", "unknown name", "no TLS", "untrusted", "turned away"
]


class ReceivedMessage(NamedTuple):
    """One received message."""

    arrived: float
    """[s, monotonic]"""
    stamp: float
    """[s, sender's system clock]"""
    wall: float
    """Our system clock at its arrival [s]."""

    @property
    def behind(self) -> float:
        """Lag of the sender's clock plus the delay [s]; negative if the clock is ahead."""
        return self.wall - self.stamp


@dataclass(frozen=True, slots=True)
class Stream:
    """The messages received on one key."""

    received: tuple[ReceivedMessage, ...] = ()
    frames: frozenset[str] = frozenset()
    bad: tuple[str, ...] = ()
    """Why messages could not be decoded."""

    @property
    def rate(self) -> float:
        """[Hz]; 0 for fewer than two messages."""
        if len(self.received) < 2:
            return 0.0
        span = self.received[-1].arrived - self.received[0].arrived
        return (len(self.received) - 1) / span if span > 0.0 else 0.0

    @property
    def stamps(self) -> int:
        """Number of different stamps."""
        return len({one.stamp for one in self.received})

    @property
    def gaps(self) -> tuple[float, ...]:
        """Times from each message to the next [s]."""
        arrivals = [one.arrived for one in self.received]
        return tuple(later - earlier for earlier, later in pairwise(arrivals))


class ScanMessage(NamedTuple):
    """What a range scan says of itself, without the faults that its model's driver is known for."""

    beams: int
    """In it."""
    hits: int
    """Beams with a range."""
    sweep: float
    """Time from its first beam to its last that it states [s]; 0 for none."""
    turn: float
    """Angle from its first beam to its last, as a share of a full turn."""


class RosNode(NamedTuple):
    """A publisher or subscriber of cmd_vel in ROS."""

    name: str
    """Name of the node, or of its bridge."""
    type: str
    """ROS type, ``package/msg/Name``."""


class Reached(NamedTuple):
    """The result of dialling another robot's agent."""

    endpoint: str
    outcome: Outcome
    detail: str = ""
    """The error of the system or of the other side."""
    name: str = ""
    """The common name in its certificate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """One process's certificate and key files."""

    path: str
    wanted: str
    """The required name."""
    name: str = ""
    """The name in it."""
    begins: float = 0.0
    """[s since the epoch]"""
    ends: float = 0.0
    mode: int = 0o600
    """Mode of the key file."""
    problem: str = ""
    """Why it cannot be used: a sentence's end, such as ``the key does not belong to it``."""


class Chrony(NamedTuple):
    """This machine's clock by ``chronyc tracking``."""

    offset: float
    """Offset from NTP time [s]."""
    synchronised: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """All facts about one robot, or about a standby."""

    mission: Mission
    robot: str
    on_robot: bool
    wall: float
    """Time of the examination [s since the epoch]."""
    seconds: float
    """Duration of listening [s]."""
    ended: float = float("-inf")
    """End of listening [s, monotonic]."""
    odometry: Stream | None = None
    pose: Stream | None = None
    scan: Stream | None = None
    """None without a range scanner, and at the desk."""
    scans: tuple[ScanMessage, ...] = ()
    """What its range scans say."""
    position: Stream | None = None
    status: Stream | None = None
    newest_status: AgentStatus | LeaderStatus | None = None
    alive: tuple[tuple[float, float], ...] | None = None
    """Signs of life: arrival [s, monotonic] and stated time [s since the agent's start]."""
    router: str | None = None
    """Expected endpoint of the robot's own bridge or router; None at the desk."""
    router_error: str = ""
    """Why it was not reached; empty if it was."""
    routed: bool | None = None
    """Whether cmd_vel has a subscriber."""
    watchdog_state: str | None = None
    """State of the robot's watchdog; empty if none answers, None if not queried."""
    watchdog_unit: str | None = None
    """State of the watchdog's systemd unit, if there is one."""
    subscribers: tuple[RosNode, ...] = ()
    """Subscribers of cmd_vel, as far as ROS shows them."""
    publishers: tuple[RosNode, ...] = ()
    """Publishers of cmd_vel, as far as ROS shows them."""
    reached: Mapping[str, Reached] = field(default_factory=dict)
    """Other robots' agents by name; at the desk this robot's own."""
    certificate: Certificate | None = None
    chrony: Chrony | None = None
    installed_differs: str | None = None
    """Place of an installed mission that differs from the given one; empty if it is the same."""
    leading: tuple[str, ...] | None = None
    """Candidates that claim to lead; None without standbys, or if not examined."""
    doubled: tuple[str, ...] = ()
    """Robots that report two publishers for this one."""
    seen_by: tuple[str, ...] = ()
    """Robots that see this one and correct their poses by it, as far as known."""

    @property
    def agent(self) -> AgentStatus | None:
        """The newest status, if it is an agent's."""
        return self.newest_status if isinstance(self.newest_status, AgentStatus) else None

    @property
    def period(self) -> float:
        """Period of the odometry, or of the leader's positions, by the mission [s]."""
        return 1.0 / self.mission.robots[self.mission.leader if self.leads else self.robot].rate

    @property
    def leads(self) -> bool:
        """Whether it is a candidate, which has no robot."""
        return self.robot in self.mission.candidates

    @property
    def part(self) -> str:
        """What runs there: ``agent``, ``leader`` or ``standby``."""
        return role(self.mission, self.robot)


class Finding(NamedTuple):
    """One fault."""

    name: str
    """For programs, such as ``odometry-silent``."""
    sentence: str
    remedy: str


class Examination(NamedTuple):
    """One kind of examination."""

    title: str
    findings: Callable[[Facts], Iterator[Finding]]
    """Yields the faults; none if all is well or nothing is known."""
    seen: Callable[[Facts], str]
    """Returns the observation in a few words; empty if it was not examined."""


class Checked(NamedTuple):
    """The result of an examination."""

    title: str
    findings: Sequence[Finding]
    seen: str


def examine(examinations: Sequence[Examination], facts: Facts) -> list[Checked]:
    """Return the examinations with a result."""
    checked = [Checked(one.title, tuple(one.findings(facts)), one.seen(facts)) for one in examinations]
    return [one for one in checked if one.findings or one.seen]
