"""What the monitor knows at one moment, as frozen values. None is always: not known now."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from formation.figure import Figure
from formation.order import Mode, Tuned
from monitor.figures.asked import Asked
from monitor.figures.known import NOTHING, UNJUDGED, KnownError, KnownVerdict
from monitor.figures.orders import Lead, Wish


class Edge(NamedTuple):
    """Robot i measures robot j."""

    robot: str
    neighbour: str


class KeyFigures(NamedTuple):
    """One key as it is heard."""

    count: int  # type: ignore[assignment]  # not what tuples call so
    rate: float | None
    """[Hz]"""
    age: float | None
    """Since the last message arrived [s]; None before the first."""
    missed: int
    """Periods without a message in gaps of up to a second: lost on the way, or skipped by the sender."""
    clock: float | None
    """Median of arrival less stamp [s]: the sender's clock against ours plus the network's delay."""
    loss: float | None = None
    """Share of the newest periods that were missed; None before the second stamp."""


class CandidateFigures(NamedTuple):
    """One process that may lead."""

    state: str
    """``leads``, or what it says of itself; ``unseen`` before, ``silent`` after it speaks."""
    reason: str
    age: float | None
    """Since it last said how it is [s]."""


EVADES = {
    "yields": "gets out of the way",
    "slowed": "slowed by its protective zone",
    "blocked": "stopped by its protective zone",
}
"""What a robot may do instead of what its law wants: a word for a table, and more of them."""


@dataclass(frozen=True, slots=True)
class RobotFigures:
    """One robot."""

    state: str
    """What its agent (or the leader) says of itself; ``unseen`` before, ``silent`` after it speaks."""
    reason: str
    error: float | None
    """Σ over its neighbours of |z_ij - z*_ij| [m]; None for the leader, and if one of them is unknown."""
    speed: float | None
    """Newest command [m/s]."""
    turn_rate: float | None
    """Newest command [rad/s]."""
    speed_share: float | None
    """Of max_speed."""
    turn_share: float | None
    """Of max_turn_rate."""
    age: float | None
    """Since its last position arrived [s]."""
    heading_error: float | None
    """Estimated less true heading [rad], in (-π, π]."""
    rate: float | None
    """Of its positions [Hz]."""
    keys: Mapping[str, KeyFigures]
    """By key."""
    rejected_age: float | None = None
    """Since a message on one of its keys was last rejected [s]; None before the first."""
    aside: bool = False
    """It says that it does not follow, or not closely yet."""
    stuck: bool = False
    """It says that it does not move though it is told to."""
    evades: str = ""
    """What it does instead of what its law wants, by its newest status: one of `EVADES`, or nothing."""
    deadlocks: int = 0
    """How often it was kept from moving by others, and went another way, since its agent's start."""
    fallback: str = ""
    """Which fallback neighbours it follows."""
    voices: int = 0
    """How many processes have spoken for it so far."""
    known: KnownError = NOTHING
    """The sum over those of its neighbours that are known."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The formation."""

    elapsed: float
    """Since the formation error was first complete, that is since the formation is driven [s]."""
    formation_error: float | None
    """Σ over all edges of |z_ij - z*_ij| [m]; None if one of them is unknown."""
    formation_error_true: float | None
    """The same from ground truth."""
    settled_at: float | None
    """When, on the scale of `elapsed`, the error fell under the mission's bound for good [s], in the
    figure that was wished for last."""
    converged: bool
    """Whether it has stayed there for the dwell time."""
    final_error: float | None
    """The newest complete formation error of the run [m], even when the fleet has gone since; None if it was
    not known at the end."""
    mode: Mode | None
    """What the leader wants."""
    shape: str
    robots: Mapping[str, RobotFigures]
    edges: Mapping[Edge, float | None]
    """|z_ij - z*_ij| [m]."""
    missed: int
    """Sum over all keys."""
    rejected: Mapping[str, int]
    """Messages that are not what they should be, by ``key: reason``."""
    contested: frozenset[str] = frozenset()
    """Robots for whom a second voice speaks, as their neighbours' statuses say."""
    forgers: frozenset[str] = frozenset()
    """Robots that have relayed forged orders of late, as statuses of others say."""
    wish: Wish | None = None
    """What is asked of the formation; None before the first order."""
    wished_at: float = 0.0
    """When, on the scale of `elapsed`, that was changed last [s]; 0 if it never was."""
    figure: Figure | None = None
    """Where the slots are by now."""
    formed: bool = True
    """Whether they have been where they are wanted since that was wished."""
    tuned: Tuned | None = None
    """Gains of the law in the place of the mission's."""
    lead: Lead | None = None
    """Who led last; None before the first order."""
    leads: str | None = None
    """Who leads: the process behind the leader's positions; None while nobody is heard."""
    waits: str = ""
    """For whom the leader waits."""
    asked: tuple[Asked, ...] = ()
    """What an operator has asked of those who may lead since the monitor began, the newest last."""
    known: KnownError = NOTHING
    """The error over the edges that are known now."""
    known_verdict: KnownVerdict = UNJUDGED
    """`settled_at`, `converged` and `final_error` over the edges that are known."""
    candidates: Mapping[str, CandidateFigures] = field(default_factory=dict)
    """Who may lead, by rank; empty where there are no standbys."""

    @property
    def settling_time(self) -> float | None:
        """From the newest wish, or the beginning, to `settled_at` [s]."""
        return None if self.settled_at is None else self.settled_at - self.wished_at
