"""What the monitor knows at one moment, as frozen values. None always means unknown now."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from formation.monitor.metrics.orders import Lead, OrderedMotion
from formation.monitor.metrics.settling import KnownError, KnownVerdict
from formation.protocol.order import Mode, Tuned
from formation.slots.shape import PlacedShape

AVOIDING = {
    "avoids": "avoids a collision",
    "slowed": "slowed by its protective zone",
    "blocked": "stopped by its protective zone",
}
"""Limits on a robot's command: a word for a table, and a longer text."""

SATURATED_SHARE = 0.995
"""Share of a limit from which a command counts as at its limit."""

SIGHT = {
    "searching": "does not see its neighbours yet",
    "reckoning": "sees no neighbour, goes on by odometry",
}
"""States of a robot that must see its neighbours, in which it does not: words as in statuses, and a text."""


class Edge(NamedTuple):
    """Robot i measures robot j."""

    robot: str
    neighbour: str


class KeyMetrics(NamedTuple):
    """Reception of one key."""

    count: int  # type: ignore[assignment]  # not what tuples call so
    rate: float | None
    """[Hz]"""
    age: float | None
    """Since the last message arrived [s]; None before the first."""
    missed: int
    """Periods without a message in gaps of up to a second: lost on the way, or skipped by the sender."""
    clock: float | None
    """Median of arrival less stamp [s]: the sender's clock against ours plus the network's delay."""
    loss: float | None
    """Share of the newest periods that were missed; None before the second stamp."""


class CandidateMetrics(NamedTuple):
    """One candidate."""

    state: str
    """``leads``, or the state in its status; ``unseen`` before the first one, ``silent`` after the last."""
    reason: str
    age: float | None
    """Age of its last status [s]."""


class ReportedRequest(NamedTuple):
    """One operator request to a candidate, and its answer."""

    number: int
    """Its number, from 1."""
    name: str
    """The candidate asked."""
    what: str
    """The request as typed."""
    ok: bool
    reason: str


@dataclass(frozen=True, slots=True)
class RobotMetrics:
    """One robot."""

    state: str
    """State of its agent (or the leader); ``unseen`` before its first status, ``silent`` after its last."""
    reason: str
    """Reason of the state, for people."""
    error: float | None
    """Σ over its neighbours of |z_ij - z*_ij| [m]; None for the leader, and if one of them is unknown."""
    speed: float | None
    """Newest command [m/s]."""
    turn_rate: float | None
    """Newest command [rad/s]."""
    speed_share: float | None
    """Share of max_speed."""
    turn_share: float | None
    """Share of max_turn_rate."""
    age: float | None
    """Age of its last position [s]."""
    heading_error: float | None
    """Estimated less true heading [rad], in (-π, π]."""
    rate: float | None
    """Rate of its positions [Hz]."""
    keys: Mapping[str, KeyMetrics]
    """Reception by key."""
    rejected_age: float | None
    """Since a message on one of its keys was last rejected [s]; None before the first."""
    unavailable: bool
    """Whether it is unavailable: it does not follow, or not closely yet."""
    reason_code: str
    """Reason for programs: a `formation.protocol.reasons.Code`, or empty."""
    readonly: bool
    """Its robot gets no commands: `state` is what its agent would do."""
    stuck: bool
    """Whether it reports that it does not move as commanded."""
    avoiding: str
    """Limit on its law's command, by its newest status: one of `AVOIDING`, or empty."""
    deadlocks: int
    """Number of deadlocks with other robots that it resolved since its agent's start."""
    fallback: str
    """Fallback neighbours that it follows."""
    sight: str
    """State of its sight of neighbours: a `formation.protocol.status.Sight`; empty if it needs none."""
    seen: Mapping[str, float]
    """Standard deviation of each seen neighbour's place [m]."""
    correction: float | None
    """Distance by which its scans have corrected its odometry [m]."""
    publishers: int
    """Number of publishers of its positions so far."""
    known: KnownError
    """The error over its known neighbours."""

    @property
    def shown(self) -> str:
        """The state in words."""
        return f"readonly: would {self.state}" if self.readonly else self.state


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The formation."""

    elapsed: float
    """Time since the formation error was first complete, that is since the formation is driven [s]."""
    formation_error: float | None
    """Σ over all edges of |z_ij - z*_ij| [m]; None if one of them is unknown."""
    formation_error_true: float | None
    """The same from ground truth."""
    settled_at: float | None
    """When, in time of `elapsed`, the error after the newest order fell below the bound for good [s]."""
    converged: bool
    """Whether it has stayed there for the dwell time."""
    final_error: float | None
    """The newest complete formation error of the run [m], even when the fleet has gone since; None if it was
    not known at the end."""
    mode: Mode | None
    """The mode that the leader orders."""
    shape: str
    robots: Mapping[str, RobotMetrics]
    edges: Mapping[Edge, float | None]
    """|z_ij - z*_ij| [m]."""
    missed: int
    """Sum over all keys."""
    rejected: Mapping[str, int]
    """Rejected messages, by ``key: reason``."""
    contested: frozenset[str]
    """Robots with a second publisher, by their neighbours' statuses or their own positions."""
    forgers: frozenset[str]
    """Robots that lately relayed forged orders, by other robots' statuses."""
    ordered: OrderedMotion | None
    """What is ordered; None before the first order."""
    ordered_at: float
    """When, in time of `elapsed`, that last changed [s]; 0 if it never did."""
    placed_shape: PlacedShape
    """The current shape with rotation and scale."""
    formed: bool
    """Whether the shape has reached what is ordered."""
    tuned: Tuned | None
    """Gains of the law that replace the mission's."""
    lead: Lead | None
    """The last leader; None before the first order."""
    leads: str | None
    """The leading candidate, which sends the leader's positions; None while none is received."""
    waits: str
    """Robots that the leader waits for."""
    requests: tuple[ReportedRequest, ...]
    """Operator requests to the candidates since the monitor began, newest last."""
    known: KnownError
    """The error over the edges known now."""
    known_verdict: KnownVerdict
    """`settled_at`, `converged` and `final_error` over the edges that are known."""
    candidates: Mapping[str, CandidateMetrics]
    """The candidates, by rank; empty if there are no standbys."""

    @property
    def converged_now(self) -> bool:
        """Whether it has converged, and positions still arrive; `converged` outlasts the end of a run."""
        return self.converged and self.known.error is not None

    @property
    def verdict_now(self) -> KnownVerdict:
        """`known_verdict` while positions arrive."""
        verdict = self.known_verdict
        return verdict._replace(converged=verdict.converged and self.known.error is not None)

    @property
    def settling_time(self) -> float | None:
        """From the newest order, or the beginning, to `settled_at` [s]."""
        return None if self.settled_at is None else self.settled_at - self.ordered_at
