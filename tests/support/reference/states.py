"""docs/reference/states.md: states and reasons, from the tables that the processes use."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from enum import StrEnum
from typing import Any

from formation.agent.pose.motion_check import Disagreement
from formation.agent.safety.failsafe import TABLE, Facts, Unanswered, decide
from formation.agent.watchdog import core as watchdog
from formation.control.zones import Zone
from formation.protocol.order import LEADER_TIMEOUT_SECONDS, Order
from formation.protocol.reasons import SENTENCES, Code, Reason
from formation.protocol.status import (
    AgentState,
    CollisionMode,
    LeaderState,
    Localised,
    MotionFault,
    RobotLink,
    Sight,
    WatchdogState,
)
from tests.support.reference.advice import ADVICE
from tests.support.reference.markdown import docstrings, document, paragraph, table

NEVER = float("inf")
ORDER = Order(term=1, beat=1, mode="run", shape="line")
FINE = Facts(
    latched=None, silence=0.0, limit=0.15, jumped=None, order=ORDER, beat_silence=0.0,
    neighbours={"robot1": 0.0}, followed=1,
)  # fmt: skip
"""What the failsafe table knows of a robot without any doubt."""


def _with(**values: Any) -> Facts:
    return FINE._replace(**values)


def _because(field: str, *codes: Code) -> list[Facts]:
    return [_with(**{field: Reason(code)}) for code in codes]


CONDITIONS: tuple[tuple[str, list[Facts]], ...] = (
    (
        "an operator's stop is in force",
        [
            _with(latched="stop", why=why)
            for why in (None, Reason(Code.STOPPED_BEFORE_START), Reason(Code.STOP_UNKNOWN))
        ],
    ),
    ("the law's result is not a number", [_with(finite=False)]),
    ("no connection to the robot", [_with(connected=False)]),
    ("another agent commands this robot", [_with(rival=True)]),
    ("the process was frozen and has not received enough since", [_with(frozen=2.0)]),
    ("no own position yet", [_with(silence=NEVER), _with(silence=NEVER, refused="x")]),
    (
        "own position silent for longer than three periods",
        [_with(silence=1.0), _with(silence=1.0, refused="x")],
    ),
    ("own position too old on arrival", [_with(too_old=True, age=1.0, age_limit=0.5), _with(too_old=True)]),
    ("own position jumped", _because("jumped", Code.POSITION_JUMPED, Code.HEADING_JUMPED, Code.RELOCALISED)),
    (
        "own position not credible",
        _because(
            "doubt",
            Code.POSITION_TOO_FAR,
            Code.HEADING_CONTRADICTED,
            Code.PATH_MIRRORED,
            Code.NOT_LOCALISED,
            Code.LOCALISER_SILENT,
            Code.LOCALISER_JUMPS,
            Code.LOCALISER_CONTRADICTS,
            Code.LOCALISER_REFUSED,
        ),
    ),
    ("gap in the own positions", [_with(follows=False)]),
    ("outside the mission's bounds", _because("outside", Code.OUTSIDE_BOUNDS)),
    (
        "scanner required, no scan yet",
        [_with(scan_silence=NEVER), _with(scan_silence=NEVER, scan_refused="a")],
    ),
    (
        "scanner required and silent",
        [_with(scan_silence=1.0, scan_limit=0.6, scan_refused=why) for why in ("", "a")],
    ),
    (
        "scanner required and its scan not credible",
        _because(
            "scan_doubt",
            Code.SCAN_LATE,
            Code.SCAN_EARLY,
            Code.SCAN_BLIND,
            Code.SCAN_SHORT,
            Code.SCAN_SECTOR,
            Code.SCAN_EMPTY,
            Code.SCAN_UNPLACED,
            Code.SCAN_FROZEN,
        ),
    ),
    ("nothing on the robot receives commands", [_with(routed=False)]),
    (
        "a robot that it receives runs another mission",
        [_with(mission="a", other_missions={"robot1": theirs}) for theirs in ("b", "")],
    ),
    ("orders refused for their signature, and no valid one", [_with(order=None, unsigned="")]),
    ("no order yet", [_with(order=None)]),
    ("the leader's beat is silent", [_with(beat_silence=2.0 * LEADER_TIMEOUT_SECONDS)]),
    ("the leader orders stop", [_with(order=ORDER.model_copy(update={"mode": "stop"}))]),
    (
        "an operator's hold is in force",
        [
            _with(latched="hold", why=why)
            for why in (None, Reason(Code.HELD_BEFORE_START), Reason(Code.UNPLACED), Reason(Code.AGENT_FAILS))
        ],
    ),
    ("the leader orders hold", [_with(order=ORDER.model_copy(update={"mode": "hold"}))]),
    ("messages late, or a wrong clock, and no answer", [_with(unanswered={"robot1": Unanswered(3.0, 0.5)})]),
    (
        "the sensor of a neighbour that it must follow or avoid is not credible",
        _because(
            "relative_doubt",
            Code.RELATIVE_LATE,
            Code.RELATIVE_WAS_LATE,
            Code.RELATIVE_FROZEN,
            Code.RELATIVE_CONTRADICTED,
        ),
    ),
    (
        "the robot must see its neighbours, and does not",
        _because(
            "sight_doubt",
            Code.SIGHT_SEARCHING,
            Code.SIGHT_PLACING,
            Code.SIGHT_CONTRADICTED,
            Code.SIGHT_LOST,
            Code.SIGHT_UNRELIABLE,
        ),
    ),
    (
        "no neighbour can be followed, and the leader is a silent neighbour",
        [_with(followed=0, leaderless=True)],
    ),
    ("no neighbour can be followed", [_with(followed=0)]),
    (
        "the robot does not move as commanded",
        [_with(motion=Disagreement(fault, 1.0, 0.0, 1.0)) for fault in MotionFault],
    ),
    ("none of these", [FINE]),
)
"""In the order of the failsafe table: when a row applies, in words, and facts for each of its reasons."""
INTRODUCTION = """Agents, the leader and standbys publish a state and a reason on `<robot>/status`; a
watchdog answers queries on `<robot>/watchdog` with its state. A reason is a code with values. Programs
compare codes only; the sentence is for people and may change. `formation watch` and the live page show the
sentence."""
FAILSAFE = """An agent takes its state from this table with each step: the first row that applies decides.
Every state except `run` sends zero velocity. *Own* means that the cause may be this robot's alone: while
the fleet runs it reports itself unavailable, and others go on without it. *Probes* means that the robot may
move a few centimetres to find out whether it moves as commanded."""
WATCHDOG = f"""The watchdog (command `formation watchdog`) sends zero velocity when the agent is silent: in
`braking` once a period for {watchdog.BRAKING_TIME:g} s, then every {watchdog.SLOW_PERIOD:g} s. A cell is the
next state; an empty cell is an event that cannot happen in that state."""
REASONS = """Words in *italics* are values of the reason. Lengths are in metres, times in seconds, angles in
radians. A clause about an empty list is left out."""
EVENTS: Mapping[watchdog.Event, str] = {
    watchdog.Event.CONNECTED: "connected to the robot's bridge or router",
    watchdog.Event.ALIVE: "sign of life from the agent",
    watchdog.Event.FAREWELL: "the agent ends in order",
    watchdog.Event.SILENT: "agent silent for three periods",
    watchdog.Event.PARKED: "zero velocity sent for half a second",
    watchdog.Event.THAWED: "the watchdog itself was frozen",
}
VALUES: Mapping[str, type[StrEnum]] = {
    "Link to the robot (`link`)": RobotLink,
    "Motion fault (`motion`)": MotionFault,
    "Collision filter (`collisions`)": CollisionMode,
    "Protective zone (`zone`)": Zone,
    "Neighbours in range scans (`sight`)": Sight,
    "Localisation (`localisation`)": Localised,
}


def page() -> str:
    """The page. Raises ValueError where `CONDITIONS` or `ADVICE` do not fit the code."""
    head = ("#", "when", "state", "reasons", "own", "probes")
    events = list(watchdog.Event)
    moves = (
        (f"`{state}`", *(f"`{to}`" if (to := watchdog.TABLE.get((state, event))) else "" for event in events))
        for state in WatchdogState
    )
    parts = [
        paragraph(INTRODUCTION),
        "## Agent", _states(AgentState), paragraph(FAILSAFE), table(head, _failsafe()),
        "## Leader and standbys", _states(LeaderState),
        "## Watchdog", _states(WatchdogState), paragraph(WATCHDOG),
        table(("state", *(EVENTS[event] for event in events)), moves),
        "## Reasons", paragraph(REASONS), table(("code", "sentence", "what to do"), _reasons()),
        "## Other values of a status",
    ]  # fmt: skip
    for heading, values in VALUES.items():
        parts += [f"**{heading}**", _states(values)]
    return document("States and reasons", parts)


def _states(states: type[StrEnum]) -> str:
    meanings = docstrings(states)
    return table(("value", "meaning"), ((f"`{one}`", meanings[one.name]) for one in states))


def _failsafe() -> Iterator[tuple[str, ...]]:
    if len(CONDITIONS) != len(TABLE):
        raise ValueError(f"CONDITIONS has {len(CONDITIONS)} rows, the failsafe table {len(TABLE)}")
    for number, (row, (when, examples)) in enumerate(zip(TABLE, CONDITIONS, strict=True)):
        if any(next(one for one in TABLE if one.applies(facts)) is not row for facts in examples):
            raise ValueError(f"CONDITIONS, row {number + 1}: {when!r} is decided by another row")
        codes = ", ".join(f"`{decide(facts).reason.code}`" for facts in examples)
        yes = {True: "yes", False: ""}
        yield str(number + 1), when, f"`{row.state}`", codes, yes[row.own], yes[row.probes]


def _reasons() -> Iterator[tuple[str, str, str]]:
    for code in Code:
        yield f"`{code}`", re.sub(r"\{(\w+)(:[^}]*)?\}", r"*\1*", SENTENCES[code]), ADVICE[code]
