"""Reasons of a process's state: a code with values, and the one table that turns them into sentences.

A reason is made with each decision, is transmitted as code and values, and becomes a sentence only where
people read it (`Reason.__str__`). No program compares or parses sentences, so they may be reworded freely.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum
from string import Formatter
from types import MappingProxyType
from typing import Any, NamedTuple, Self

MAX_NUMBER = 1e12
"""Largest number, either way, that a status carries."""
MAX_TEXT_CHARS = 400
"""Longest text that a status carries [characters]."""
MAX_ENTRIES = 1000
"""Longest list or mapping that a status carries."""

Value = float | str | tuple[str, ...] | Mapping[str, float]
"""A number (SI units, radians), a text, names of robots, or a number for each of several robots."""


class Code(StrEnum):
    """Every reason that a process can give."""

    # any process
    STARTED = "started"
    ENDED = "ended"
    DETAIL = "detail"
    # an agent, about its orders
    STOPPED_BY_OPERATOR = "stopped_by_operator"
    HELD_BY_OPERATOR = "held_by_operator"
    STOPPED_BEFORE_START = "stopped_before_start"
    HELD_BEFORE_START = "held_before_start"
    STOP_UNKNOWN = "stop_unknown"
    UNPLACED = "unplaced"
    AGENT_FAILS = "agent_fails"
    NO_ORDER = "no_order"
    ORDER_UNSIGNED = "order_unsigned"
    LEADER_LOST = "leader_lost"
    STOPPED_BY_LEADER = "stopped_by_leader"
    HELD_BY_LEADER = "held_by_leader"
    # about its robot and itself
    COMMAND_NOT_FINITE = "command_not_finite"
    NO_LINK = "no_link"
    NO_LISTENER = "no_listener"
    SECOND_AGENT = "second_agent"
    PROCESS_FROZEN = "process_frozen"
    OUTSIDE_BOUNDS = "outside_bounds"
    RUNNING = "running"
    # about its position source
    NO_POSITION = "no_position"
    POSITION_SILENT = "position_silent"
    POSITION_REFUSED = "position_refused"
    POSITION_LATE = "position_late"
    POSITION_WAS_LATE = "position_was_late"
    NOT_LOCALISED = "not_localised"
    LOCALISER_SILENT = "localiser_silent"
    LOCALISER_JUMPS = "localiser_jumps"
    LOCALISER_CONTRADICTS = "localiser_contradicts"
    LOCALISER_REFUSED = "localiser_refused"
    RELOCALISED = "relocalised"
    POSITION_JUMPED = "position_jumped"
    HEADING_JUMPED = "heading_jumped"
    POSITION_TOO_FAR = "position_too_far"
    HEADING_CONTRADICTED = "heading_contradicted"
    PATH_MIRRORED = "path_mirrored"
    POSITION_GAP = "position_gap"
    # about its range scanner
    NO_SCAN = "no_scan"
    SCAN_SILENT = "scan_silent"
    SCAN_REFUSED = "scan_refused"
    SCAN_LATE = "scan_late"
    SCAN_EARLY = "scan_early"
    SCAN_BLIND = "scan_blind"
    SCAN_SHORT = "scan_short"
    SCAN_SECTOR = "scan_sector"
    SCAN_EMPTY = "scan_empty"
    SCAN_UNPLACED = "scan_unplaced"
    SCAN_FROZEN = "scan_frozen"
    # about its sensor of neighbours
    RELATIVE_LATE = "relative_late"
    RELATIVE_WAS_LATE = "relative_was_late"
    RELATIVE_FROZEN = "relative_frozen"
    RELATIVE_CONTRADICTED = "relative_contradicted"
    # about neighbours that its range scanner must see
    SIGHT_SEARCHING = "sight_searching"
    SIGHT_PLACING = "sight_placing"
    SIGHT_CONTRADICTED = "sight_contradicted"
    SIGHT_LOST = "sight_lost"
    SIGHT_UNRELIABLE = "sight_unreliable"
    # about a robot that does not move as commanded
    MOTION_FROZEN = "motion_frozen"
    MOTION_TURN = "motion_turn"
    MOTION_SPEEDS = "motion_speeds"
    MOTION_CARRIED = "motion_carried"
    MOTION_TURNED = "motion_turned"
    MOTION_LATE = "motion_late"
    PROBE_BLOCKED = "probe_blocked"
    # about others
    OTHER_MISSION = "other_mission"
    UNKNOWN_MISSION = "unknown_mission"
    UNANSWERED = "unanswered"
    NO_NEIGHBOUR = "no_neighbour"
    # a leader, or a standby
    ROUTE_UNKNOWN = "route_unknown"
    ORDER_UNREAD = "order_unread"
    NO_ROBOT = "no_robot"
    STOPPED_AT_BOUNDS = "stopped_at_bounds"
    WAITS = "waits"
    ROUTE_ENDED = "route_ended"
    NOT_DRIVEN = "not_driven"
    OTHER_LEADS = "other_leads"
    NO_LEADER = "no_leader"
    TERM_AHEAD = "term_ahead"
    TERM_EARLIER = "term_earlier"


_MIXED = "this process {ours}: give all the same one (formation deploy push)"
_BLOCKED = "at least {least:.2f} {unit} expected; check {sensor}, wheels and motors"
SENTENCES: Mapping[Code, str] = MappingProxyType(
    {
        Code.STARTED: "just started",
        Code.ENDED: "its process ends: {cause}",
        Code.DETAIL: "{detail}",
        Code.STOPPED_BY_OPERATOR: "stopped by the operator",
        Code.HELD_BY_OPERATOR: "held by the operator",
        Code.STOPPED_BEFORE_START: "stopped by the operator, before this agent began",
        Code.HELD_BEFORE_START: "held by the operator, before this agent began",
        Code.UNPLACED: "odometry may not count from the start pose; saved state not used: {detail}",
        Code.AGENT_FAILS: "{detail}: check its log, the robot and its sensors, then order run",
        Code.STOP_UNKNOWN: "{detail}; it may have saved a stop: release the robot if it may drive",
        Code.NO_ORDER: "no order from the leader yet",
        Code.ORDER_UNSIGNED: "{detail}",
        Code.LEADER_LOST: "the leader's newest order is {age:.1f} s old; limit {limit:g} s",
        Code.STOPPED_BY_LEADER: "stopped by the leader",
        Code.HELD_BY_LEADER: "held by the leader",
        Code.COMMAND_NOT_FINITE: "the law gave no finite command",
        Code.NO_LINK: "no link to the robot: is its bridge or router running?",
        Code.NO_LISTENER: "the robot does not listen to cmd_vel:"
        " restart its bring-up and the bridge together",
        Code.SECOND_AGENT: "another agent commands this robot: end one of the two",
        Code.PROCESS_FROZEN: "this process was frozen for {duration:.1f} s; waits for new {missing:names}",
        Code.OUTSIDE_BOUNDS: "outside the bounds: {axis} = {value:.2f} m, limit {limit:.2f} m;"
        " bring it back inside, or widen the mission's [bounds]",
        Code.RUNNING: "in formation control",
        Code.NO_POSITION: "no {source} yet",
        Code.POSITION_SILENT: "{source} silent for {age:.2f} s; limit {limit:.2f} s",
        Code.POSITION_REFUSED: "{source} comes, and is refused: {detail}",
        Code.POSITION_LATE: "{source} was {age:.2f} s old when it came; limit {limit:.2f} s:"
        " check what publishes it, and its clock (chrony)",
        Code.POSITION_WAS_LATE: "{source} was {age:.2f} s old when it came; limit {limit:.2f} s;"
        " goes on within 10 s if it stays below",
        Code.NOT_LOCALISED: "not localised in the map yet: give the localiser an initial pose",
        Code.LOCALISER_SILENT: "no pose of the localiser that agrees with odometry for {distance:.1f} m;"
        " limit {limit:g} m: check that it runs, that its messages reach the agent, and its map",
        Code.LOCALISER_JUMPS: "the localiser jumped {count:.0f} times within {distance:g} m:"
        " check its map and scanner, then order hold and run",
        Code.LOCALISER_CONTRADICTS: "the localiser's poses contradicted each other or odometry {count:.0f}"
        " times before {distance:g} m agreed: check its initial pose, its base frame, and that no second one"
        " publishes, then order hold and run",
        Code.LOCALISER_REFUSED: "not localised in the map; the localiser's newest message was refused:"
        " {detail}",
        Code.RELOCALISED: "the localiser moved the robot by {distance:.2f} m",
        Code.POSITION_JUMPED: "{source} jumped by {distance:.2f} m",
        Code.HEADING_JUMPED: "{source} jumped by {angle:+.2f} rad",
        Code.POSITION_TOO_FAR: "{source} is beyond ±{limit:g} m",
        Code.HEADING_CONTRADICTED: "{source} has a heading {angle:.2f} rad off the direction in which the"
        " robot moves; limit {limit:.2f} rad: check how it is mounted, and the motors,"
        " then order hold and run",
        Code.PATH_MIRRORED: "pose shows the robot turn to the side opposite to its commands: is the camera's"
        " frame mirrored (y downwards), is another robot seen, or are motors swapped? Correct it, then order"
        " hold and run",
        Code.POSITION_GAP: "no two {source} messages within {limit:.2f} s",
        Code.NO_SCAN: "no range scan yet",
        Code.SCAN_SILENT: "range scan silent for {age:.2f} s; limit {limit:.2f} s",
        Code.SCAN_REFUSED: "range scan comes, and is refused: {detail}",
        Code.SCAN_LATE: "range scan stamped {age:.2f} s before it came, must be {limit:g} s at most",
        Code.SCAN_EARLY: "range scan stamped {age:.2f} s after it came, must be {limit:g} s at most",
        Code.SCAN_BLIND: "range scan has range_min {value:g} m: this robot needs at most {limit:.3g} m",
        Code.SCAN_SHORT: "range scan has range_max {value:g} m: this robot needs at least {limit:.3g} m"
        " to stop from its max_speed",
        Code.SCAN_SECTOR: "range scan does not show what is ahead: it must show {limit:.2f} rad to either"
        " side; check the scanner's yaw_deg, and state its model if its driver leaves out beams",
        Code.SCAN_EMPTY: "no beam of the range scan has come back for {duration:.1f} s;"
        " {robots:names} should be in sight; check that the scanner turns and is not covered",
        Code.SCAN_UNPLACED: "range scan cannot be placed by odometry that said {speed:.3g} m/s,"
        " {turn_rate:.3g} rad/s",
        Code.SCAN_FROZEN: "range scan frozen: the same for {duration:.1f} s, while the robot moved"
        " {distance:.3f} m and turned {turn:.2f} rad; limits {limit:g} m, {turn_limit:.2f} rad;"
        " check the scanner and its driver",
        Code.RELATIVE_LATE: "the sensor's {robot} was {age:.2f} s old when it came; limit {limit:.2f} s:"
        " check what measures it, and its clock (chrony)",
        Code.RELATIVE_WAS_LATE: "the sensor's {robot} was {age:.2f} s old when it came; limit {limit:.2f} s;"
        " goes on within 10 s if it stays below",
        Code.RELATIVE_FROZEN: "the sensor's {robot} frozen or this robot blocked: displacement changed"
        " {seen:.3f} m in {duration:.1f} s, at least {least:.2f} m of {expected:.2f} m expected;"
        " check what measures it, and wheels",
        Code.RELATIVE_CONTRADICTED: "the sensor's {robot} is {distance:.2f} m from where it can be after"
        " {duration:.1f} s by odometry; limit {limit:.2f} m: check whether either robot was carried, the"
        " sensor's axes (x ahead, y to the left) and mounting, and which robot it sees, then order hold"
        " and run",
        Code.SIGHT_SEARCHING: "its range scans do not show {robots:names} yet: {count:.0f} of {limit:.0f}"
        " scans; no position to rely on from {unplaced:names}, see to them first; clear the view, or put the"
        " robot back in its place, its start pose if it has not driven; check that the scanner sends new"
        " scans",
        Code.SIGHT_PLACING: "its position is {distance:.3f} m from where its range scans show it, limit"
        " {limit:.3f} m; goes on when that is corrected",
        Code.SIGHT_CONTRADICTED: "its range scans do not show {robots:names} where odometry says;"
        " clear the view, or put the robot back in its place, its start pose if it has not driven; check the"
        " places of {robots:names} too, how the scanner is mounted, and that no other robot's scans come",
        Code.SIGHT_UNRELIABLE: "its range scans contradicted its position {count:.0f} times within"
        " {distance:g} m; check odometry, wheels, how the scanner is mounted, and that no other robot's scans"
        " come, then order hold and run; check the places of {robots:names} too",
        Code.SIGHT_LOST: "has not seen {robots:names} for {age:.0f} s, limit {limit:.0f} s; its position may"
        " be off by {distance:.3f} m, limit {most:.3f} m; no position to rely on from {unplaced:names}, see"
        " to them first; clear the view, and check that the scanner sends new scans",
        Code.MOTION_FROZEN: "{source} frozen or robot blocked: commanded {expected:.2f} m in"
        " {duration:.1f} s, moved {seen:.2f} m; " + _BLOCKED,
        Code.MOTION_TURN: "{source} heading frozen or robot blocked: commanded {expected:.2f} rad in"
        " {duration:.1f} s, turned {seen:.2f} rad; " + _BLOCKED,
        Code.MOTION_SPEEDS: "{source} contradicts itself: positions moved {expected:+.2f} m in"
        " {duration:.1f} s, its speeds say {seen:+.2f} m; check the speeds that the robot reports",
        Code.MOTION_CARRIED: "{source} moved without command: commanded {expected:.2f} m in {duration:.1f} s,"
        " moved {seen:.2f} m; was the robot carried or pushed, is another one seen, or is the scale of the"
        " {source} wrong?",
        Code.MOTION_TURNED: "{source} turned without command: commanded {expected:.2f} rad in"
        " {duration:.1f} s, turned {seen:.2f} rad; was the robot turned by hand, or is another one seen?",
        Code.MOTION_LATE: "{source} shows what was commanded {seen:.1f} s later, whatever its stamps say;"
        " limit {expected:.2f} s; check what publishes it: it must stamp when it measures",
        Code.PROBE_BLOCKED: "no room to probe whether it moves as commanded: move the robot away from what it"
        " stands beside, then order hold and run; {detail}",
        Code.OTHER_MISSION: "{robot} runs mission {theirs}, " + _MIXED,
        Code.UNKNOWN_MISSION: "{robot} runs an unknown mission, " + _MIXED,
        Code.UNANSWERED: "positions are late or stamped by a wrong clock, and do not answer:"
        " {late:each| by |+.1f| s}; limit {limit:g} s; check the network and the clocks (chrony)",
        Code.NO_NEIGHBOUR: "no neighbour can be followed; silent: {silent:each| |.2f| s};"
        " never received: {never_received:names}; unavailable: {unavailable:names};"
        " outside the bounds: {outside:names}",
        Code.ROUTE_UNKNOWN: "does not know the route that the leader was on:"
        " order a speed or a route, then run",
        Code.ORDER_UNREAD: "cannot read the order that robots relay, nor its stop and place:"
        " run begins the route anew",
        Code.NO_ROBOT: "has received no robot yet",
        Code.STOPPED_AT_BOUNDS: "stopped at the bounds: {what} next at {axis} = {value:.4g} m,"
        " limit {limit:.4g} m; order a speed or route that leads back",
        Code.WAITS: "waits for {robots:names}",
        Code.ROUTE_ENDED: "at the end of the route",
        Code.NOT_DRIVEN: "driven by hand, and no velocity comes;"
        " formation drive, or order a speed or a route",
        Code.OTHER_LEADS: "{robot} leads",
        Code.NO_LEADER: "no leader",
        Code.TERM_AHEAD: "term {term:.0f} refused by {robots:names}: it is over a day ahead:"
        " set the clocks (chronyc tracking)",
        Code.TERM_EARLIER: "term {term:.0f} refused by {robots:names}: it is an earlier one",
    }
)
"""Sentences for people. ``:names`` is a list of robots, ``:each|before|format|after`` a number for each of
several robots, another format a number, none a text. A clause (up to ``; ``) about an empty list is
omitted."""


class _Sentences(Formatter):
    def format_field(self, value: Any, format_spec: str) -> str:
        if format_spec == "names":
            return ", ".join(value)
        if format_spec.startswith("each|"):
            _, before, number, after = format_spec.split("|")
            return ", ".join(f"{name}{before}{one:{number}}{after}" for name, one in value.items())
        return format(value, format_spec)


_FORMATTER = _Sentences()


class Reason(NamedTuple):
    """A code, and the values that belong to it."""

    code: Code
    values: Mapping[str, Value] = MappingProxyType({})

    @classmethod
    def of(cls, code: Code, **values: Value | Sequence[str]) -> Self:
        """Return the reason with all values of its sentence. Numbers are made finite."""
        return cls(code, {name: _made(value) for name, value in values.items()})

    @classmethod
    def read(cls, code: str, values: Mapping[str, Any]) -> Self:
        """Read untrusted data. Raises ValueError for an unknown code, and for values that do not fit.

        Values that the code does not have are omitted.
        """
        if code not in list(Code):
            raise ValueError("is no known reason")
        known = Code(code)
        return cls(known, {name: _checked(name, values.get(name), kind) for name, kind in fields(known)})

    def __str__(self) -> str:
        """Its sentence."""
        clauses = SENTENCES[self.code].split("; ")
        parts = (_FORMATTER.vformat(clause, (), self.values) for clause in clauses if self._applies(clause))
        return "; ".join(parts)

    def _applies(self, clause: str) -> bool:
        return all(self.values.get(name) not in ((), {}) for name, _ in _fields(clause))


def fields(code: Code) -> Iterator[tuple[str, str]]:
    """Name and kind of each value of a reason: ``text``, ``number``, ``names`` or ``each``."""
    return _fields(SENTENCES[code])


def _fields(sentence: str) -> Iterator[tuple[str, str]]:
    for _, name, spec, _ in Formatter().parse(sentence):
        if name is not None:
            kind = (spec or "").partition("|")[0]
            yield name, kind if kind in {"names", "each"} else "number" if kind else "text"


def bounded(value: float) -> float:
    """The nearest number that a status may carry, the largest for NaN: a status can always be published."""
    return MAX_NUMBER if math.isnan(value) else min(max(float(value), -MAX_NUMBER), MAX_NUMBER)


def _made(value: Value | Sequence[str]) -> Value:
    if isinstance(value, str):
        return value[:MAX_TEXT_CHARS]
    if isinstance(value, Mapping):
        return {name: bounded(one) for name, one in value.items()}
    return bounded(value) if isinstance(value, (int, float)) else tuple(value)


def _checked(name: str, value: Any, kind: str) -> Value:
    """A value of this kind; a list that is empty may be missing. Raises ValueError."""
    if kind == "number":
        return _number(name, value)
    if kind == "text" and isinstance(value, str) and len(value) <= MAX_TEXT_CHARS:
        return value
    if kind == "names":
        names = value.split(",") if isinstance(value, str) else [] if value is None else value
        if isinstance(names, list | tuple) and all(isinstance(one, str) for one in names[: MAX_ENTRIES + 1]):
            return tuple(names[:MAX_ENTRIES])
    if kind == "each" and isinstance(value, Mapping | None) and len(value or {}) <= MAX_ENTRIES:
        return {str(robot): _number(name, one) for robot, one in (value or {}).items()}
    raise ValueError(f"{name}: must be of kind {kind}" if value is not None else f"{name}: is missing")


def _number(name: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name}: is no number") from None
    if not abs(number) <= MAX_NUMBER:
        raise ValueError(f"{name}: must be within ±{MAX_NUMBER:g}")
    return number
