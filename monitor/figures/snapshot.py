"""What the monitor knows at one moment, as frozen values. None is always: not known now."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from formation.order import Mode


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


@dataclass(frozen=True, slots=True)
class RobotFigures:
    """One robot."""

    state: str
    """What its agent (or the leader) says of itself; ``unseen`` before, ``silent`` after it speaks."""
    reason: str
    error: float | None
    """Σ over its neighbours of |z_ij - z*_ij| [m]; None for the leader."""
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


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The formation."""

    elapsed: float
    """Since the formation error was first complete, that is since the formation is driven [s]."""
    formation_error: float | None
    """Σ over all edges of |z_ij - z*_ij| [m]."""
    formation_error_true: float | None
    """The same from ground truth."""
    settled_at: float | None
    """When, on the scale of `elapsed`, the error fell under the mission's bound for good [s]."""
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
