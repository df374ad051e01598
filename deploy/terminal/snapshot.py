"""The monitor's snapshots for the launcher: JSON objects from the monitor's stdout."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from formation.monitor.metrics.events import Event
from formation.monitor.metrics.settling import KnownError


class RobotNow(NamedTuple):
    """The monitor's last values of one robot; None means unknown."""

    state: str = ""
    error: float | None = None
    """Error summed over its neighbours [m]."""
    speed: float | None = None
    """Commanded speed [m/s]."""
    turn_rate: float | None = None
    """Commanded turn rate [rad/s]."""
    heading_error: float | None = None
    """Estimated less true heading [rad]."""
    age: float | None = None
    """Age of its last position [s]."""
    unavailable: bool = False
    """Whether it is unavailable: it does not follow, and others go on without it."""
    stuck: bool = False
    """Whether it does not move although commanded to."""
    avoiding: str = ""
    """Limit on its law's command, in a word: ``avoids``, ``slowed`` or ``blocked``."""
    fallback: str = ""
    """Fallback neighbours that it follows."""
    known_error: float | None = None
    """Error summed over its known neighbours [m]: at most `error`."""


class Known(NamedTuple):
    """The formation error over the edges that are known."""

    error: float = math.nan
    """[m]; NaN if none is."""
    words: str = ""
    """Number of known edges, and why not all; empty if all are known, or none."""


class Snapshot(NamedTuple):
    """The formation as the monitor saw it at one time."""

    error: float
    """Formation error, summed over all edges [m]; NaN while a position is missing."""
    robots: Mapping[str, RobotNow]
    events: tuple[Event, ...] = ()
    """Events since the last snapshot."""
    leads: str | None = None
    """The leading candidate; None if there is none, or it is unknown."""
    waits: str = ""
    """Robots that the leader waits for."""
    placed_shape: str = ""
    """Rotation and scale of the shape, and whether it is changing."""
    partial: Known | None = None
    """The error over the known edges, if not all are known."""
    candidates: Mapping[str, str] = MappingProxyType({})
    """State of each candidate, by rank; empty if there are no standbys."""

    @property
    def known(self) -> Known:
        """The error over the known edges, all or some."""
        return self.partial or Known(self.error)

    @classmethod
    def of(cls, event: Mapping[str, Any]) -> Snapshot:
        """Read a snapshot event; a value that is missing or of another type is unknown."""
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
            _placed_shape(event),
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
        unavailable=robot.get("unavailable") is True,
        stuck=robot.get("stuck") is True,
        avoiding=_text(robot.get("avoiding")),
        fallback=_text(robot.get("fallback")),
        known_error=_number(known[0]) if isinstance(known := robot.get("known"), list) and known else None,
    )


def _partial(event: Mapping[str, Any]) -> Known | None:
    """Return the error over the known edges, if not all are known."""
    known_part = event.get("known")
    if _number(event.get("formation_error")) is not None or not isinstance(known_part, Mapping):
        return None
    error, silent = _number(known_part.get("error")), known_part.get("silent")
    some, every = _number(known_part.get("known_edges")), _number(known_part.get("edges"))
    if error is None or some is None or every is None:
        return None
    ages = silent.items() if isinstance(silent, Mapping) else ()
    known = KnownError(error, int(some), int(every), {str(name): _number(age) for name, age in ages})
    return Known(error, known.words)


def _placed_shape(event: Mapping[str, Any]) -> str:
    """Return the shape in words, unless it is as drawn: ``wedge turned by 30°, × 1.5, on its way``."""
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
    details = ", ".join(filter(None, parts))
    return f"{shape} {details}" if details else ""


def _candidates(candidates: Any) -> dict[str, str]:
    if not isinstance(candidates, Mapping):
        return {}
    return {
        str(name): _text(one.get("state")) for name, one in candidates.items() if isinstance(one, Mapping)
    }


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _happened(event: Any) -> Event | None:
    """Return the event; None if it is invalid."""
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
