"""What each class keeps that an agent is made of, in one table.

Its memory, its parts that have one of their own, and what its construction settles for good. An attribute
that stands nowhere in the table fails a test.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from agent.aside import Aside
from agent.avoiding import Avoiding
from agent.commander import Commander
from agent.core import Agent
from agent.failsafe import Decision, State
from agent.hearing import Hearing
from agent.latch import Latch
from agent.localisation import Localisation
from agent.motion_check import Disagreement, Leg, MotionCheck
from agent.motion_check import Kind as Disagrees
from agent.motion_model import Modelled, MotionModel
from agent.neighbourhood import Neighbour, Neighbourhood
from agent.odometer import Odometer
from agent.orders import Orders
from agent.overhead import Overhead, Sent
from agent.probe import Mean, Phase, Probe
from agent.scanner import Moving, Scanner
from agent.slots import Slots
from agent.status import Surroundings
from agent.stream import Stream
from agent.tuning import Tuning
from agent.values import (
    Json,
    Kind,
    by_name,
    count,
    flag,
    maybe,
    model,
    plane,
    real,
    recent,
    record,
    refuse,
    row,
    several,
    spoken,
    text,
    word,
)
from agent.voice import Voice
from agent.wakefulness import Wakefulness
from formation.detour import Avoidance
from formation.election import Voter
from formation.heading import Travel
from formation.lateness import Count, Delayed, Quickest, Trust
from formation.neighbour import Track
from formation.once import Once
from formation.order import Order, Told
from formation.rest import Rest
from formation.ros2.messages import Odometry, Pose
from formation.scan import Circle
from formation.unicycle import Command
from formation.zones import Zone


class Kept(NamedTuple):
    """What a class keeps, attribute by attribute."""

    memory: Mapping[str, Kind]
    """What it learns."""
    parts: tuple[str, ...] = ()
    """What has a memory of its own: one object, None where there is none, or a dict of them by name."""
    construction: tuple[str, ...] = ()
    """What is the same in all agents with this mission, robot, law and voice."""


def _sent(numbers: Iterable[float]) -> Sent:
    since, speed, turn_rate = numbers
    return Sent(since, Command(speed, turn_rate))


_COMMAND = row(Command._make, real, real)
_TRACK = row(Track._make, real, plane, plane)
_AVOIDANCE = row(Avoidance._make, real, real, count, plane, real, real, real)
_TRAVEL = row(Travel._make, real, real, plane)
_MODELLED = row(Modelled._make, real, plane, plane, real, real, real, real)
_DISAGREEMENT = row(Disagreement._make, word(*Disagrees, of=Disagrees), real, real, real)
_TWO = row(tuple, real, real)
_NAMES = Kind(list, lambda said, where: tuple(several(text).read(said, where)))
_ORDER = model(Order)
_ODOMETRY = record(
    Odometry, stamp=real, position=plane, heading=plane, speed=real, turn_rate=real, frame=text,
    child_frame=text,
)  # fmt: skip
_SENT = Kind(  # hundreds of them: numbers of Python's own, and finite, so they are said as they are
    lambda sent: [sent.since, *sent.command],
    row(_sent, real, real, real).read,
)
_MOVE = row(Moving._make, real, _COMMAND)
_FLAT = several(real)


def _circle(said: Json, where: str) -> Circle:
    """Centre, radius and points, as numbers in a row."""
    numbers = _FLAT.read(said, where)
    if len(numbers) < 3 or len(numbers) % 2 == 0:
        refuse(said, where, "x, y, radius, and x and y of each point")
    rest = iter(numbers[3:])
    points = tuple(complex(x, y) for x, y in zip(rest, rest, strict=True))
    return Circle(complex(*numbers[:2]), numbers[2], points)


def _said_circle(one: Circle) -> Json:  # numbers as `_SENT` has them
    return [*_xy(one.at), one.radius, *[part for point in one.points for part in _xy(point)]]


def _xy(point: complex) -> tuple[float, float]:
    return point.real, point.imag


_CIRCLES = several(Kind(_said_circle, _circle))
_POSE = record(Pose, stamp=real, position=plane, heading=plane, frame=text)

_QUICKEST = row(Quickest._make, real, real)
_DELAYED = row(Delayed._make, real, real, real)

KEPT: Mapping[type, Kept] = {
    Agent: Kept(
        memory={
            "decision": row(Decision._make, word(*State, of=State), text, flag, flag),
            "_told": count,
            "_surroundings": record(
                Surroundings,
                connected=maybe(flag),
                routed=maybe(flag),
                refused=by_name(count),
                rival=flag,
            ),
            "_rival": real,
            "_moved": flag,
            "_integral": plane,
            "_finite": flag,
            "_outside": maybe(text),
            "_status_due": real,
            "_rest_due": real,
        },
        parts=(
            "_here",
            "_neighbours",
            "_avoiding",
            "_orders",
            "_tuning",
            "_slots",
            "_aside",
            "_motion",
            "_probe",
            "_wakefulness",
            "_commander",
            "_latch",
            "_hearing",
        ),
        construction=(
            "robot",
            "law_name",
            "_mission",
            "_spec",
            "_readonly",
            "_voice",
            "_fence",
            "_certificate",
            "_law",
            "_status_key",
            "_position_key",
        ),
    ),
    Hearing: Kept(
        memory={"dropped": by_name(count, Counter), "last_dropped": by_name(text)},
        construction=("_spec", "_leader", "_own", "_handlers", "_fence"),
    ),
    Localisation: Kept(
        memory={
            "jumped": maybe(text),
            "jumps": count,
            "follows": flag,
            "_joined": flag,
            "late": count,
            "position": plane,
            "travel": maybe(_TRAVEL),
            "_measured": plane,
            "_estimate": plane,
            "_course": plane,
            "_way": real,
            "trust": row(Trust._make, flag, real),
            "age_limit": real,
            "_judged": real,
            "_before": maybe(row(tuple, real, plane, plane)),
            "_calm": real,
        },
        parts=("stream", "_source"),
        construction=(
            "_printed",
            "_measures_heading",
            "_gain",
            "_sharp_gain",
            "_noise",
            "_limits",
            "_period",
            "_guessed",
            "_guesses",
        ),
    ),
    Odometer: Kept(
        memory={
            "realigned": count,
            "_rotation": plane,
            "_origin": plane,
            "_last": maybe(_ODOMETRY),
            "_why": text,
        },
        construction=("_counts_from_start", "_limits"),
    ),
    Overhead: Kept(
        memory={
            "_last": maybe(_POSE),
            "_sent": recent(_SENT),
        },
        construction=("_limits", "_reads_heading"),
    ),
    Stream: Kept(
        memory={
            "stamp": real,
            "arrived": maybe(real),
            "underway": real,
            "late": real,
            "received": real,
            "_suspect": maybe(row(tuple, real, real)),
            "_doubted": flag,
            "_quickest": maybe(_QUICKEST),
            "_delayed": maybe(_DELAYED),
        },
        construction=("limit", "longest_way"),
    ),
    Wakefulness: Kept(memory={"pause": real, "_stepped": maybe(real), "_woke": real}),
    Neighbourhood: Kept(
        memory={"guides": _NAMES, "_instead": flag, "_back": real},
        parts=("each",),
        construction=(
            "_mission",
            "_robot",
            "_neighbours",
            "_fallbacks",
            "_circular",
            "_carry",
            "_feed_forward",
            "_as_measured",
        ),
    ),
    Neighbour: Kept(
        memory={
            "displacement": plane,
            "aside": flag,
            "beyond": flag,
            "_anchor": plane,
            "_moved": real,
            "_track": maybe(_TRACK),
            "_body": maybe(_TRACK),
            "_unplaced": maybe(row(tuple, maybe(real))),
            "_other": row(tuple, text, real),
        },
        parts=("stream", "voice"),
        construction=("name", "_tag", "_offset", "_top_speed", "_filter"),
    ),
    Avoiding: Kept(
        memory={
            "memory": _AVOIDANCE,
            "avoided": count,
            "acting": flag,
        },
        parts=("others", "scanner"),
        construction=(
            "mode",
            "_minded",
            "_specs",
            "_first",
            "_local",
            "_limits",
            "_manners",
            "_apart",
            "_delay",
        ),
    ),
    Scanner: Kept(
        memory={
            "zone": word(*Zone, of=Zone),
            "_moves": recent(_MOVE),
            "_wrong": maybe(_MOVE),
            "_told": maybe(_COMMAND),
            "_circles": _CIRCLES,
            "_began": real,
            "_ended": real,
            "_range_min": real,
        },
        parts=("stream",),
        construction=(
            "required",
            "_scan",
            "_radius",
            "_limits",
            "_sees_from",
            "_body",
            "_lasts",
            "_reach",
            "_keeps",
        ),
    ),
    Voice: Kept(
        memory={
            "contested": real,
            "_bound": maybe(model(Told)),
            "_heard": real,
            "_leapt": maybe(row(tuple, count, real)),
            "_former": by_name(count),
        },
        construction=("limit", "_name", "_rate"),
    ),
    Orders: Kept(
        memory={
            "newest": maybe(_ORDER),
            "signed": row(tuple, text, text),
            "refused": maybe(row(tuple, text, real)),
            "forged": by_name(row(tuple, text, real)),
            "rose": real,
            "_lived": real,
            "_beats": maybe(row(Count._make, count, _QUICKEST, maybe(_DELAYED))),
            "_heard": by_name(row(tuple, _ORDER, real)),
        },
        parts=("voter",),
        construction=("_leader", "_votes", "_shapes", "_bearable", "_fence", "_rate", "_expiry"),
    ),
    Voter: Kept(
        memory={
            "promise": count,
            "echo": count,
            "refused": count,
            "because": maybe(word("ahead", "earlier")),
            "_given": count,
            "_renewed": real,
            "_rose": real,
            "_lived": real,
            "_commanded": real,
            "_alone": maybe(real),
            "_stepped": real,
            "_stalled": real,
            "_refused_at": real,
        },
        construction=(
            "_mission",
            "_votes",
            "_bound",
            "_expiry",
            "_longest_gap",
            "_reach",
            "_quarantine",
        ),
    ),
    Tuning: Kept(memory={"k_p": real, "k_i": real}, construction=("_limits", "_gains", "_original")),
    Slots: Kept(
        memory={
            "at": by_name(plane),
            "velocity": by_name(plane),
            "_order": maybe(_ORDER),
            "_ordered": by_name(plane),
            "_going": by_name(plane),
            "_beats_began": real,
            "_moment": real,
            "_standing": flag,
        },
        construction=("_mission", "_fastest", "_period"),
    ),
    Aside: Kept(
        memory={"told": flag, "behind": flag, "_set_out": flag, "_since": real, "_error": real},
    ),
    MotionModel: Kept(
        memory={"_command": _COMMAND, "_states": recent(_MODELLED)},
        construction=("longest", "_gap"),
    ),
    Leg: Kept(
        memory={
            "seen": plane,
            "_origins": several(plane),
            "_path_before": real,
            "_farthest": real,
            "_began": real,
        },
        construction=("_tolerance",),
    ),
    MotionCheck: Kept(
        memory={
            "doubt": maybe(_DISAGREEMENT),
            "confirmed": count,
            "_last": maybe(real),
            "_facing": plane,
            "_by_speeds": plane,
            "_by_positions": plane,
            "_reported": real,
            "_ahead_before": several(real),
            "_window_began": real,
        },
        parts=("model", "_position", "_heading"),
        construction=("_has_speeds", "_has_heading"),
    ),
    Mean: Kept(
        memory={
            "count": count,
            "position": plane,
            "heading": real,
            "_squares": real,
            "_turn_squares": real,
        },
    ),
    Probe: Kept(
        memory={
            "phase": word(*Phase, of=Phase),
            "tries": count,
            "_since": real,
            "_at": plane,
            "_facing": real,
            "_reported": real,
            "_direction": real,
            "_began": _TWO,
            "_asked": _TWO,
        },
        parts=("_before", "_after"),
        construction=("_speed", "_turn_rate", "_settling"),
    ),
    Commander: Kept(
        memory={
            "newest": _COMMAND,
            "remainder": _COMMAND,
            "_ramped": _COMMAND,
            "_said": real,
            "_gentle_until": real,
            "_began": maybe(real),
        },
        construction=(
            "steps",
            "topics",
            "_stamped",
            "_cmd_vel",
            "_alive",
            "_quantiser",
            "_limits",
            "_ramp",
            "_longest",
            "_guarded",
            "_period",
        ),
    ),
    Latch: Kept(
        memory={"why": text},
        parts=("rest", "once"),
        construction=("_robot",),
    ),
    Rest: Kept(memory={"stop": text, "hold": text}),
    Once: Kept(memory={"_rested": real, "_answers": by_name(spoken)}),
}
"""What every class that an agent is made of keeps."""
