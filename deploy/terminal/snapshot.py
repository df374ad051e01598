"""The monitor's snapshots as the launcher reads them: JSON objects on the monitor's stdout."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from monitor.figures.events import Event


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


class Snapshot(NamedTuple):
    """The formation as the monitor saw it at one time."""

    error: float
    """Formation error, summed over the edges [m]; NaN while a position is missing."""
    robots: Mapping[str, RobotNow]
    events: tuple[Event, ...] = ()
    """What has happened since the snapshot before."""

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
        )


def _robot(robot: Mapping[str, Any]) -> RobotNow:
    state = robot.get("state")
    return RobotNow(
        state if isinstance(state, str) else "",
        *(_number(robot.get(key)) for key in ("error", "speed", "turn_rate", "heading_error", "age")),
    )


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
