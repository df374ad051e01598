"""What is known about one robot before anything is judged. Gathering fills it in; None is not looked at."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal, NamedTuple

from formation.mission import Mission
from formation.ros2.messages import Status
from formation.transport.wiring import role

Outcome = Literal[
    "ok", "refused", "no route", "no answer", "unknown name", "no TLS", "untrusted", "turned away"
]


class Heard(NamedTuple):
    """One message as it came."""

    arrived: float
    """[s, monotonic]"""
    stamp: float
    """[s, sender's system clock]"""
    wall: float
    """Our system clock when it came [s]."""

    @property
    def behind(self) -> float:
        """How far the sender's clock, and the way here, are behind ours [s]; negative: it is ahead."""
        return self.wall - self.stamp


@dataclass(frozen=True, slots=True)
class Stream:
    """What came on one key."""

    heard: tuple[Heard, ...] = ()
    frames: frozenset[str] = frozenset()
    bad: tuple[str, ...] = ()
    """Why messages could not be read."""

    @property
    def rate(self) -> float:
        """[Hz]; 0 for fewer than two messages."""
        if len(self.heard) < 2:
            return 0.0
        span = self.heard[-1].arrived - self.heard[0].arrived
        return (len(self.heard) - 1) / span if span > 0.0 else 0.0

    @property
    def gaps(self) -> tuple[float, ...]:
        """From each message to the next [s]."""
        arrivals = [one.arrived for one in self.heard]
        return tuple(later - earlier for earlier, later in pairwise(arrivals))


class Party(NamedTuple):
    """Somebody in ROS who speaks or listens on cmd_vel."""

    name: str
    """Of the node, or the bridge that has it on its side."""
    type: str
    """ROS type, ``package/msg/Name``."""
    session: str
    """Zenoh's name of its session."""


class Reached(NamedTuple):
    """What came of dialling another robot's agent."""

    endpoint: str
    outcome: Outcome
    said: str = ""
    """What the system or the other side said."""
    name: str = ""
    """The common name in its certificate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """One process's certificate and key, as its files are."""

    path: str
    wanted: str
    """The name it must say."""
    name: str = ""
    """The name it says."""
    begins: float = 0.0
    """[s since the epoch]"""
    ends: float = 0.0
    mode: int = 0o600
    """Of the key's file."""
    problem: str = ""
    """Why it cannot be used: a sentence's end, such as ``the key does not belong to it``."""


class Chrony(NamedTuple):
    """What ``chronyc tracking`` says of this machine's clock."""

    offset: float
    """From NTP time [s]."""
    synchronised: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """All that is known about one robot, or about a standby."""

    mission: Mission
    robot: str
    on_robot: bool
    wall: float
    """When it was looked at [s since the epoch]."""
    seconds: float
    """How long was listened [s]."""
    odometry: Stream | None = None
    pose: Stream | None = None
    position: Stream | None = None
    status: Stream | None = None
    said: Status | None = None
    """The newest status."""
    alive: tuple[tuple[float, float], ...] | None = None
    """Signs of life: arrival [s, monotonic] and what they say [s since the agent's start]."""
    router: str | None = None
    """Where the robot's own bridge or router should be; None at the desk."""
    router_trouble: str = ""
    """Why it was not reached; empty if it was."""
    routed: bool | None = None
    """Whether anybody listens to cmd_vel."""
    guard_state: str | None = None
    """What the robot's guard says that it is doing; empty if no guard answers, None if it was not asked."""
    guard_unit: str | None = None
    """What systemd says of the guard, where it knows one."""
    listeners: tuple[Party, ...] = ()
    """Who listens to cmd_vel, as far as ROS shows it."""
    speakers: tuple[Party, ...] = ()
    """Who speaks on cmd_vel, likewise."""
    reached: Mapping[str, Reached] = field(default_factory=dict)
    """Other robots' agents by name; at the desk this robot's own."""
    certificates: tuple[Certificate, ...] | None = None
    chrony: Chrony | None = None
    installed_differs: str | None = None
    """Where another mission is installed than the one given; empty if it is the same."""
    leading: tuple[str, ...] | None = None
    """Who said that it leads; None where nobody could take its place, or nobody was asked."""
    doubled: tuple[str, ...] = ()
    """Robots that hear two voices speak for this one."""

    @property
    def period(self) -> float:
        """Between two odometries, or two positions of whoever leads, as the mission has it [s]."""
        return 1.0 / self.mission.robots[self.mission.leader if self.leads else self.robot].rate

    @property
    def leads(self) -> bool:
        """Whether it may lead; then it has no robot."""
        return self.robot in self.mission.candidates

    @property
    def part(self) -> str:
        """What runs there: ``agent``, ``leader`` or ``standby``."""
        return role(self.mission, self.robot)


class Finding(NamedTuple):
    """One thing that is wrong."""

    name: str
    """For programs, such as ``odometry-silent``."""
    sentence: str
    remedy: str


class Examination(NamedTuple):
    """One kind of thing that is looked at."""

    title: str
    look: Callable[[Facts], Iterator[Finding]]
    """What is wrong; nothing where all is well or nothing is known."""
    well: Callable[[Facts], str]
    """What was seen, in a few words; empty if it was not looked at."""


class Checked(NamedTuple):
    """What an examination came to."""

    title: str
    findings: Sequence[Finding]
    seen: str


def examine(examinations: Sequence[Examination], facts: Facts) -> list[Checked]:
    """Every examination that has something to say."""
    checked = [Checked(one.title, tuple(one.look(facts)), one.well(facts)) for one in examinations]
    return [one for one in checked if one.findings or one.seen]
