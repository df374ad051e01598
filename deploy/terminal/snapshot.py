"""The monitor's snapshots as the launcher reads them: JSON objects on the monitor's stdout."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from monitor.figures.events import Event
from monitor.figures.known import KnownError


class RobotNow(NamedTuple):
    """What the monitor last knew of one robot; None is not known."""

    state: str = ""
    error: float | None = None
    """Sum over its neighbours [m]."""
    speed: float | None = None
    """Commanded [m/s]."""
    turn_rate: float | None = None
    """Commanded [rad/s]."""
    heading_error: float | None = None
    """[rad]"""
    age: float | None = None
    """Of its last position [s]."""
    aside: bool = False
    """It does not follow, and others go on without it."""
    stuck: bool = False
    """It does not move though it is told to."""
    evades: str = ""
    """What it does instead of what its law wants, in a word: ``yields``, ``slowed`` or ``blocked``."""
    fallback: str = ""
    """Whom it follows in place of its neighbours."""
    known_error: float | None = None
    """Sum over those of its neighbours that are known [m]: at most `error`."""


class Known(NamedTuple):
    """The formation error over the edges that are known."""

    error: float = math.nan
    """[m]; NaN if none is."""
    words: str = ""
    """Over how many of them, and why not all; empty if all are known, or none."""


class Snapshot(NamedTuple):
    """The formation as the monitor saw it at one time."""

    error: float
    """Formation error, summed over all edges [m]; NaN while a position is missing."""
    robots: Mapping[str, RobotNow]
    events: tuple[Event, ...] = ()
    """What has happened since the snapshot before."""
    leads: str | None = None
    """Who leads; None for nobody, or not known."""
    waits: str = ""
    """For whom the leader waits."""
    figure: str = ""
    """How the shape is turned and scaled, and whether it is on its way."""
    partial: Known | None = None
    """The same over the edges that are known, where not all are."""
    candidates: Mapping[str, str] = MappingProxyType({})
    """What everybody does who may lead, by rank; empty where there are no standbys."""

    @property
    def known(self) -> Known:
        """The error over the edges that are known, all or some."""
        return self.partial or Known(self.error)

    @classmethod
    def of(cls, event: Mapping[str, Any]) -> Snapshot:
        """Read a snapshot event; what it does not have, or has as another type, is not known."""
        error = _number(event.get("formation_error"))
        robots, events = event.get("robots"), event.get("events")
        return cls(
            math.nan if error is None else error,
            {str(name): _robot(robot) for name, robot in robots.items() if isinstance(robot, Mapping)}
            if isinstance(robots, Mapping)
            else {},
            tuple(filter(None, map(_happened, events))) if isinstance(events, list) else (),
            _text(event.get("leads")) or None,
            _text(event.get("waits")),
            _figure(event),
            _partial(event),
            _candidates(event.get("candidates")),
        )


def _robot(robot: Mapping[str, Any]) -> RobotNow:
    return RobotNow(
        _text(robot.get("state")),
        error=_number(robot.get("error")),
        speed=_number(robot.get("speed")),
        turn_rate=_number(robot.get("turn_rate")),
        heading_error=_number(robot.get("heading_error")),
        age=_number(robot.get("age")),
        aside=robot.get("aside") is True,
        stuck=robot.get("stuck") is True,
        evades=_text(robot.get("evades")),
        fallback=_text(robot.get("fallback")),
        known_error=_number(known[0]) if isinstance(known := robot.get("known"), list) and known else None,
    )


def _partial(event: Mapping[str, Any]) -> Known | None:
    """What it says of the known edges, where it does not say all."""
    said = event.get("known")
    if _number(event.get("formation_error")) is not None or not isinstance(said, Mapping):
        return None
    error, silent = _number(said.get("error")), said.get("silent")
    some, every = _number(said.get("known_edges")), _number(said.get("edges"))
    if error is None or some is None or every is None:
        return None
    ages = silent.items() if isinstance(silent, Mapping) else ()
    known = KnownError(error, int(some), int(every), {str(name): _number(age) for name, age in ages})
    return Known(error, known.words)


def _figure(event: Mapping[str, Any]) -> str:
    """In words, where there is more to say than the shape: ``wedge turned by 30°, × 1.5, on its way``."""
    shape, rotation, scale = (
        _text(event.get("shape")),
        _number(event.get("rotation")),
        _number(event.get("scale")),
    )
    parts = [
        f"turned by {math.degrees(rotation):.3g}°" if rotation else "",
        f"{scale:.3g} times as large" if scale not in {None, 1.0} else "",
        "on its way" if event.get("formed") is False else "",
    ]
    told = ", ".join(filter(None, parts))
    return f"{shape} {told}" if told else ""


def _candidates(candidates: Any) -> dict[str, str]:
    if not isinstance(candidates, Mapping):
        return {}
    return {
        str(name): _text(one.get("state")) for name, one in candidates.items() if isinstance(one, Mapping)
    }


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _happened(event: Any) -> Event | None:
    """An event as it was said; None for what is none."""
    if not isinstance(event, Mapping):
        return None
    at, level = _number(event.get("at")), _number(event.get("level"))
    robot, kind, text = event.get("robot"), event.get("kind"), event.get("text")
    if at is None or level is None or not (isinstance(robot, str) and isinstance(text, str)):
        return None
    return Event(at, int(level), robot, kind if isinstance(kind, str) else "", text)


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return float(value)
