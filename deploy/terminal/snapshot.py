"""What `formation run` and `formation watch` show: the monitor's snapshots, and the run so far."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

from formation.mission.model import Mission
from formation.monitor.metrics.events import Event
from formation.monitor.metrics.settling import KnownError

MAX_ERRORS = 7200
"""Number of values of the formation error in a picture: half an hour at four a second."""
MAX_EVENTS = 50
"""Number of newest events kept: more than a terminal has lines."""


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
        error, events = _number(event.get("formation_error")), event.get("events")
        return cls(
            math.nan if error is None else error,
            {name: _robot(robot) for name, robot in _tables(event.get("robots")).items()},
            tuple(filter(None, map(_event, events))) if isinstance(events, list) else (),
            _text(event.get("leads")) or None,
            _text(event.get("waits")),
            _placed_shape(event),
            _partial(event),
            {name: _text(one.get("state")) for name, one in _tables(event.get("candidates")).items()},
        )


@dataclass(slots=True)
class Progress:
    """The run so far."""

    mission: Mission
    duration: float | None = None
    """Duration of the run [s]; None without an end."""
    processes: int = 0
    """Number of processes of the run; 0 if a fleet is only watched."""
    phase: str = "starting"
    ready: int = 0
    elapsed: float = 0.0
    """Time since all were ready, or since the watching began [s]."""
    note: str = ""
    """Text to show while there is no snapshot."""
    snapshot: Snapshot | None = None
    errors: deque[float] = field(default_factory=lambda: deque(maxlen=MAX_ERRORS))
    """Formation error of every snapshot so far, over the edges that were known [m]."""
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=MAX_EVENTS))
    """Events, the newest last."""
    dead: dict[str, str] = field(default_factory=dict)
    """Processes that ended without a request, and how."""
    dead_robots: set[str] = field(default_factory=set)
    """Robots with an agent among them."""

    @property
    def settled(self) -> bool:
        """Whether the error over the known edges is under the mission's bound now."""
        return self.snapshot is not None and self.snapshot.known.error < self.mission.settled

    @property
    def left(self) -> float:
        """Remaining time [s]."""
        return math.inf if self.duration is None else self.duration - self.elapsed

    def add_snapshot(self, snapshot: Snapshot) -> None:
        """Take a snapshot of the monitor."""
        self.snapshot = snapshot
        self.events.extend(snapshot.events)
        if math.isfinite(snapshot.known.error):
            self.errors.append(snapshot.known.error)

    def lose_sight(self) -> None:
        """Forget the current values after the monitor's end, so that old ones are not shown as current."""
        self.snapshot = Snapshot(math.nan, {})


def _robot(robot: Mapping[str, Any]) -> RobotNow:
    known = robot.get("known")
    values = {name: READ_AS[type(usual)](robot.get(name)) for name, usual in RobotNow._field_defaults.items()}
    values["known_error"] = _number(known[0]) if isinstance(known, list) and known else None
    return RobotNow(**values)


def _partial(event: Mapping[str, Any]) -> Known | None:
    """Return the error over the known edges, if not all are known."""
    part = event.get("known")
    if _number(event.get("formation_error")) is not None or not isinstance(part, Mapping):
        return None
    error, some, every = (_number(part.get(name)) for name in ("error", "known_edges", "edges"))
    if error is None or some is None or every is None:
        return None
    ages = {str(name): _number(age) for name, age in _table(part.get("silent")).items()}
    return Known(error, KnownError(error, int(some), int(every), ages).words)


def _placed_shape(event: Mapping[str, Any]) -> str:
    """Return the shape in words, unless it is as drawn: ``wedge turned by 30°, × 1.5, on its way``."""
    rotation, scale = _number(event.get("rotation")), _number(event.get("scale"))
    parts = [
        f"turned by {math.degrees(rotation):.3g}°" if rotation else "",
        f"{scale:.3g} times as large" if scale not in {None, 1.0} else "",
        "on its way" if event.get("formed") is False else "",
    ]
    details = ", ".join(filter(None, parts))
    return f"{_text(event.get('shape'))} {details}" if details else ""


def _event(event: Any) -> Event | None:
    """Return the event; None if it is invalid."""
    event = _table(event)
    at, level = _number(event.get("at")), _number(event.get("level"))
    robot, text = event.get("robot"), event.get("text")
    if at is None or level is None or not (isinstance(robot, str) and isinstance(text, str)):
        return None
    return Event(at, int(level), robot, _text(event.get("kind")), text)


def _table(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _tables(value: Any) -> dict[str, Mapping[str, Any]]:
    """Return a table of tables; what is none is left out."""
    return {str(name): one for name, one in _table(value).items() if isinstance(one, Mapping)}


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return float(value)


READ_AS: Mapping[type, Callable[[Any], Any]] = {
    str: _text,
    type(None): _number,
    bool: lambda value: value is True,
}
"""Readers of a robot's values, by the type of their default."""
