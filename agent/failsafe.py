"""May this robot move? One table, read from the top: the first row that applies decides.

Whatever is not the last row ends in zero velocity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import NamedTuple

from agent.motion_check import SHARE, Disagreement, Kind
from formation.order import LEADER_LOST, Mode, Order, mixed


class State(StrEnum):
    """What an agent is doing."""

    WAITING = "waiting"
    """Has not yet heard all it needs to begin."""
    RUN = "run"
    """Follows the law."""
    HOLD = "hold"
    """Stands still, by order or by doubt, and goes on by itself when the reason is gone."""
    STOP = "stop"
    """Stands still until somebody releases it, or its process starts anew."""


class Facts(NamedTuple):
    """All that the table looks at."""

    latched: Mode | None
    """What the operator asked of this very robot."""
    silence: float
    """Of what tells the robot's own position [s]; infinite before the first message."""
    limit: float
    """[s]"""
    jumped: str | None
    """A recent jump of it, in words."""
    order: Order | None
    """The newest order that a neighbour relayed."""
    beat_silence: float
    """Since the leader's beat last rose [s]."""
    neighbours: Mapping[str, float]
    """Silence of each neighbour [s]; infinite before the first message."""
    fresh: int
    """How many of them are followed, or would be."""
    follows: bool = True
    """Whether the newest own position closed an interval."""
    finite: bool = True
    """Whether the law's result is a number."""
    source: str = "odometry"
    """What tells the robot's own position."""
    doubt: str | None = None
    """Why it is not believed though it did not jump, in words."""
    why: str = ""
    """Why `latched` is in force, where nobody asked that of this very process."""
    connected: bool | None = None
    """Whether there is a link to the robot; None if nobody knows."""
    routed: bool | None = None
    """Whether the robot listens to commands; None if nobody knows."""
    aside: tuple[str, ...] = ()
    """Neighbours that are heard, and are no guides: they do not follow, or only this robot."""
    scan_silence: float = 0.0
    """Of a scanner that the mission requires [s]; infinite before its first scan, 0 if none is required."""
    scan_limit: float = float("inf")
    """[s]"""
    scan_doubt: str | None = None
    """Why the newest scan of a scanner that the mission requires is not believed, in words."""
    outside: str | None = None
    """How the robot is outside the mission's bounds, in words."""
    beyond: tuple[str, ...] = ()
    """Neighbours that report positions outside the bounds; the robot does not follow them."""
    unsigned: str | None = None
    """Why an order that came just now was refused for its signature, in words."""
    too_old: bool = False
    """Whether the robot's own position is too old to act on, or was until just now."""
    age: float = 0.0
    """How old the newest own position was when it came [s] …"""
    age_limit: float = float("inf")
    """… and may be [s]."""
    leaderless: bool = False
    """Whether the leader itself is among the neighbours, and silent."""
    frozen: float = 0.0
    """For so long this process was frozen, and has not heard enough since [s]; 0 if it was not."""
    motion: Disagreement | None = None
    """How the robot does not move as it is told."""
    rival: bool = False
    """Whether another agent commands this robot."""
    mission: str = ""
    """Tag of the mission that this robot runs."""
    other_missions: Mapping[str, str] = MappingProxyType({})
    """Robots that it hears and that run another mission, with its tag."""


class Row(NamedTuple):
    """One row: when it applies, what the robot then does, and what it says."""

    applies: Callable[[Facts], bool]
    state: State
    reason: Callable[[Facts], str]
    own: bool = False
    """Whether it concerns this robot, while others may well go on."""
    probes: bool = False
    """Whether the robot may move a little, to see whether it moves as it is told."""


class Decision(NamedTuple):
    """What the table decided, and why in a few words."""

    state: State
    reason: str
    own: bool = False
    """Whether others may well go on without this robot."""
    probes: bool = False
    """Whether it may move a little, to see whether it moves as it is told."""


def _never(silence: float) -> bool:
    return silence == float("inf")


def _nobody(facts: Facts) -> str:
    each = ", ".join(
        f"{name} is outside the bounds"
        if name in facts.beyond
        else f"{name} is no guide"
        if name in facts.aside
        else f"{name} {age:.2f} s"
        for name, age in facts.neighbours.items()
    )
    return f"no neighbour {'can be followed' if facts.aside else 'is fresh'}: {each}"


def _mixed(facts: Facts) -> str:
    return mixed(*next(iter(facts.other_missions.items())), facts.mission)


_CHECK = {
    Kind.FROZEN: "{source} frozen or robot blocked: commanded {expected:.2f} m in {over:.1f} s, moved"
    " {seen:.2f} m; at least {least:.2f} m expected; check {sensor}, wheels and motors",
    Kind.TURN: "{source} heading frozen or robot blocked: commanded {expected:.2f} rad in {over:.1f} s,"
    " turned {seen:.2f} rad; at least {least:.2f} rad expected; check {sensor}, wheels and motors",
    Kind.SPEEDS: "{source} contradicts itself: positions moved {expected:+.2f} m in {over:.1f} s, its speeds"
    " say {seen:+.2f} m; check the speeds that the robot reports",
    Kind.CARRIED: "{source} moved without command: commanded {expected:.2f} m in {over:.1f} s, moved"
    " {seen:.2f} m; was the robot carried or pushed, or is another one seen?",
    Kind.TURNED: "{source} turned without command: commanded {expected:.2f} rad in {over:.1f} s, turned"
    " {seen:.2f} rad; was the robot turned by hand, or is another one seen?",
}
_SENSORS = {"odometry": "encoders", "pose": "tracker"}


def _motion(facts: Facts) -> str:
    """How the robot does not move as it is told; it probes by itself."""
    if facts.motion is None:
        return ""
    kind, expected, seen, over = facts.motion
    return _CHECK[kind].format(
        source=facts.source,
        sensor=_SENSORS[facts.source],
        expected=expected,
        seen=seen,
        over=over,
        least=SHARE * expected,
    )


def _too_old(facts: Facts) -> str:
    measured = f"{facts.source} was {facts.age:.2f} s old when it came; limit {facts.age_limit:.2f} s"
    if facts.age <= facts.age_limit:
        return f"{measured}; goes on when it stays below"
    return f"{measured}: check what publishes it, and its clock (chrony)"


TABLE: tuple[Row, ...] = (
    Row(lambda f: f.latched == "stop", State.STOP, lambda f: f.why or "stopped by the operator", own=True),
    Row(lambda f: not f.finite, State.HOLD, lambda _: "the law gave no finite command", own=True),
    Row(lambda f: f.connected is False, State.HOLD, lambda _: "no link to the robot", own=True),
    Row(
        lambda f: f.rival,
        State.HOLD,
        lambda _: "another agent commands this robot: end one of the two",
        own=True,
    ),
    Row(
        lambda f: f.frozen > 0.0,
        State.WAITING,
        lambda f: f"this process was frozen for {f.frozen:.1f} s: waits for new messages",
        own=True,
    ),
    Row(lambda f: _never(f.silence), State.WAITING, lambda f: f"no {f.source} yet", own=True),
    Row(
        lambda f: f.silence > f.limit,
        State.HOLD,
        lambda f: f"{f.source} silent for {f.silence:.2f} s",
        own=True,
    ),
    Row(lambda f: f.too_old, State.HOLD, _too_old, own=True),
    Row(lambda f: f.jumped is not None, State.HOLD, lambda f: f"{f.source} jumped {f.jumped}", own=True),
    Row(lambda f: f.doubt is not None, State.HOLD, lambda f: f"{f.source} {f.doubt}", own=True),
    Row(
        lambda f: not f.follows,
        State.HOLD,
        lambda f: f"no two {f.source} messages within {f.limit:.2f} s",
        own=True,
    ),
    Row(
        lambda f: f.outside is not None,
        State.HOLD,
        lambda f: f"outside the bounds: {f.outside}; bring it back inside, or widen the mission's [bounds]",
        own=True,
    ),
    Row(lambda f: _never(f.scan_silence), State.WAITING, lambda _: "no range scan yet", own=True),
    Row(
        lambda f: f.scan_silence > f.scan_limit,
        State.HOLD,
        lambda f: f"range scan silent for {f.scan_silence:.2f} s",
        own=True,
    ),
    Row(lambda f: f.scan_doubt is not None, State.HOLD, lambda f: f"range scan {f.scan_doubt}", own=True),
    Row(lambda f: f.routed is False, State.HOLD, lambda _: "the robot does not listen to cmd_vel", own=True),
    Row(lambda f: bool(f.other_missions), State.HOLD, _mixed, own=True),
    Row(
        lambda f: f.unsigned is not None and (f.order is None or f.beat_silence > LEADER_LOST),
        State.HOLD,
        lambda f: str(f.unsigned),
        own=True,
    ),
    Row(lambda f: f.order is None, State.WAITING, lambda _: "no order from the leader yet"),
    Row(
        lambda f: f.beat_silence > LEADER_LOST,
        State.HOLD,
        lambda f: f"the leader's beat stopped {f.beat_silence:.1f} s ago",
        own=True,  # to some it may still come
    ),
    Row(
        lambda f: f.order is not None and f.order.mode == "stop",
        State.STOP,
        lambda _: "stopped by the leader",
    ),
    Row(lambda f: f.latched == "hold", State.HOLD, lambda f: f.why or "held by the operator", own=True),
    Row(lambda f: f.order is not None and f.order.mode == "hold", State.HOLD, lambda _: "held by the leader"),
    # whether it is gone, or only from here, its beat will tell
    Row(lambda f: not f.fresh and f.leaderless, State.HOLD, _nobody),
    Row(lambda f: not f.fresh, State.HOLD, _nobody, own=True),
    # last of all doubts: a probe needs everything else to be well
    Row(lambda f: f.motion is not None, State.HOLD, _motion, own=True, probes=True),
    Row(lambda _: True, State.RUN, lambda _: "in formation control"),
)


def decide(facts: Facts) -> Decision:
    """The first row that applies."""
    row = next(row for row in TABLE if row.applies(facts))
    return Decision(row.state, row.reason(facts), row.own, row.probes)
