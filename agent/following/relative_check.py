"""Does a measured displacement change as the robot moves? Own motion against the sensor, without a heading.

The displacement z of a neighbour from the robot's centre [m; body frame] must change at least by what the
robot's own motion and turn do to it, less the distance that the neighbour can have gone:

    least = |exp(-iθ) (z - d) - z|  -  REPORTED_RATIO |w|

with the robot's own turn θ and shift d [body frame], by odometry, and the net shift w that the neighbour says
it made, of which only the size counts, so frames that differ do no harm. It is the least of several delays of
the displacement, less the motion of one interval. With external poses the turn is only commanded: then it is
|d| - |z θ|. A displacement is frozen if it shows less, with the tolerances of
`formation.agent.pose.motion_check`; and, also where the neighbour's motion is unknown, if it stays the same
bit for bit. The doubt lasts until the displacement changes, or an operator orders a hold.

It is contradicted if it is farther from exp(-iθ) (z - d) than the neighbour can have gone, as where its axes
are exchanged or mirrored, with each delay of either odometry or displacement. That doubt lasts until an
operator orders a hold. Both doubts, and how far a displacement has stayed the same bit for bit, outlive the
agent (`RelativeMemory`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from formation.agent.pose.motion_check import (
    FORGETTING_TIME,
    MAX_COMMAND_LOOP_DELAY,
    MIN_MOTION_SHARE,
    POSITION,
)
from formation.control.observer import Travel
from formation.control.unicycle import along
from formation.protocol.reasons import Code, Reason

RECENT_TIME = MAX_COMMAND_LOOP_DELAY
"""Longest delay of a displacement, and of what the neighbour says, that is considered [s]."""
REPORTED_RATIO = 1.2
"""Share of the distance that a neighbour says it went that it may have gone: odometry is no more precise."""
MAX_EQUAL_MOTION = 0.25
"""Change by own motion that a displacement may miss while it stays the same bit for bit [m]."""
EXPLAINED_PATH = 0.3
"""Own path after which a leg begins anew if the neighbour's motion explains all of it [m]."""
MAX_COURSE_ERROR, MAX_COURSE_ERROR_RATIO = 0.15, 0.15
"""Error that noise and odometry may cause [m], and as a share of the change by own motion."""
COURSE_PATH, COURSE_TURN = 3.0, 3.0
"""Own path [m] and turn [rad] after which the comparison of its course begins anew."""
FAR = 1e9
"""A change that no displacement makes [m]."""
MIN_DOUBT_TIME = 1.0
"""Time for which a doubt lasts before an order may end it [s]."""


class Moved(NamedTuple):
    """The robot's motion since its agent started."""

    moment: float
    """[s, monotonic]"""
    shift: complex = 0j
    """Net motion of its centre [m; world frame]."""
    at: complex = 0j
    """The same by dead reckoning [m; frame of the first heading]."""
    facing: complex = 1.0 + 0.0j
    """Its heading, unit [the same frame]."""
    path: float = 0.0
    """Path length [m]."""
    turning: float = 0.0
    """Sum of the turn's absolute value [rad]."""


@dataclass(slots=True, kw_only=True)
class OwnMotion:
    """The robot's motion by its own position source, over the last `RECENT_TIME`."""

    recent: deque[Moved] = field(default_factory=lambda: deque([Moved(-math.inf)]))
    """Oldest first; never empty."""
    gaps: int = 1
    """Number of intervals in which it is unknown, the time before the first one among them."""

    @property
    def now(self) -> Moved:
        """The newest."""
        return self.recent[-1]

    def add(self, moment: float, travel: Travel | None) -> None:
        """Add an interval that ends at `moment` [s, monotonic]; None if its motion is unknown."""
        last = self.now
        if travel is None:
            self.gaps += 1
            travel = Travel(0.0, 0.0, 0j)
        at, facing = along(last.at, last.facing, travel.distance, travel.turn)
        self.recent.append(
            Moved(
                moment,
                last.shift + travel.displacement,
                at,
                facing / abs(facing),
                last.path + abs(travel.displacement),
                last.turning + abs(travel.turn),
            )
        )
        while len(self.recent) > 1 and self.recent[1].moment <= moment - RECENT_TIME:
            self.recent.popleft()


@dataclass(slots=True, kw_only=True)
class Leg:
    """What a displacement was when a comparison began, and what it showed since."""

    first: complex = 0j
    """From the robot's centre [m; body frame]."""
    own: tuple[Moved, ...] = (Moved(-math.inf),)
    """The robot's recent motion then, oldest first."""
    reported: complex | None = None
    """Where the neighbour said it was [m]; None if unknown."""
    farthest: float = 0.0
    """Largest change of the displacement since [m]."""


class Seen(NamedTuple):
    """A displacement."""

    moment: float
    """Of the own motion that was newest then [s, monotonic]."""
    displacement: complex
    """From the robot's centre [m; body frame]."""


class Course(NamedTuple):
    """What was known when the comparison of a displacement's course began."""

    seen: tuple[Seen, ...]
    """Recent displacements, oldest first."""
    own: tuple[Moved, ...]
    """The robot's recent motion, oldest first."""
    reported: complex
    """Where the neighbour said it was [m]."""


class RelativeDoubt(NamedTuple):
    """Why a displacement is not believed, and until when."""

    why: Reason
    since: float
    """When it began [s, monotonic]."""
    frozen: complex
    """The displacement then [m; body frame]."""
    ends_beyond: float
    """Change of the displacement that ends it [m]."""


class RelativeMemory(NamedTuple):
    """What the next agent of the robot must know of one neighbour's displacements."""

    doubt: RelativeDoubt | None
    newest: complex
    """The newest displacement that was checked [m; body frame]."""
    missed: float
    """Change by own motion since it first was the same bit for bit [m]."""


@dataclass(slots=True, kw_only=True)
class RelativeCheckState:
    """What is known of one neighbour's displacements."""

    gaps: int = 0
    """`OwnMotion.gaps` when both comparisons began; 0 before the first."""
    leg: Leg = field(default_factory=Leg)
    """Since the displacement last showed motion."""
    equal: Leg = field(default_factory=Leg)
    """Since it last changed at all."""
    seen: deque[Seen] = field(default_factory=deque)
    """The displacements of the last `RECENT_TIME` without a gap, oldest first."""
    course: Course | None = None
    """Since its course is compared; None while it is not."""
    missed: float = 0.0
    """Change by own motion since it first was what it is, bit for bit [m]."""
    missed_before: float = 0.0
    """The part of `missed` before `equal` began [m]."""
    doubt: RelativeDoubt | None = None
    """Why it is not believed."""


class RelativeCheck:
    """Checks the displacements of one neighbour."""

    def __init__(self, name: str, offset: float, top_speed: float, *, by_odometry: bool) -> None:
        """`offset` [m] is from the robot's centre to its control point.

        `top_speed` [m/s] is that of the neighbour's control point.
        `by_odometry`: the robot's own motion is; otherwise only its commands tell how it turns.
        """
        self.state = RelativeCheckState()
        self._name, self._offset, self._by_odometry = name, offset, by_odometry
        self._top_speed = top_speed

    @property
    def memory(self) -> RelativeMemory:
        """What the next agent must know."""
        return RelativeMemory(self.state.doubt, self.state.equal.first, self._kept)

    @property
    def _kept(self) -> float:
        """Change that a displacement has certainly missed before the next leg [m].

        What noise at rest may be does not count, or it would add up: of external poses that is more.
        """
        state, noise = self.state, POSITION.still if self._by_odometry else POSITION.still_min
        return state.missed_before + max(0.0, state.missed - state.missed_before - noise)

    def restore(self, memory: RelativeMemory) -> None:
        """Have it know what the check of another agent did."""
        self.state.doubt, self.state.equal = memory.doubt, Leg(first=memory.newest)
        self.state.missed = self.state.missed_before = memory.missed

    def trust(self, moment: float) -> None:
        """End a doubt: an operator has checked the sensor, or holds the robot."""
        if self.state.doubt is not None and moment - self.state.doubt.since >= MIN_DOUBT_TIME:
            self._trust()

    def _trust(self) -> None:
        """Begin anew with the next displacement."""
        state = self.state
        state.doubt, state.course, state.gaps, state.missed, state.missed_before = None, None, 0, 0.0, 0.0

    def saw(
        self,
        displacement: complex,
        own: OwnMotion,
        reported: complex | None,
        *,
        report_age: float = 0.0,
        anew: bool = False,
    ) -> None:
        """Check a displacement [m; body frame].

        `reported` is where the neighbour said it was [m], None if unknown; that arrived `report_age` [s] ago.
        `anew`: it does not follow the one before.
        """
        state, seen, now = self.state, displacement + self._offset, tuple(own.recent)
        if state.doubt is not None:
            if abs(seen - state.doubt.frozen) <= state.doubt.ends_beyond:
                return
            self._trust()
        if anew or state.gaps != own.gaps:
            state.gaps, state.leg = own.gaps, Leg(first=seen, own=now, reported=reported)
            state.course = None
            state.seen.clear()
            state.equal, state.missed_before = Leg(first=state.equal.first, own=now), self._kept
        if seen != state.equal.first:
            state.equal, state.missed_before = Leg(first=seen, own=now), 0.0
        state.missed = state.missed_before + max(0.0, self._change(state.equal, now))
        if state.missed > MAX_EQUAL_MOTION:
            self._doubt(seen, state.equal, state.missed, 0.0, now[-1])
            return
        if self._by_odometry and self._contradicts(seen, now, reported, report_age):
            return
        leg = state.leg
        changed = abs(seen - leg.first)
        leg.farthest = max(leg.farthest, changed)
        if reported is None or leg.reported is None:
            state.leg = Leg(first=seen, own=now, reported=reported)
            return
        least = self._change(leg, now) - REPORTED_RATIO * abs(reported - leg.reported)
        if (least > POSITION.still_min and leg.farthest < POSITION.still) or (
            least > POSITION.net_min and changed < MIN_MOTION_SHARE * least
        ):
            self._doubt(seen, leg, least, POSITION.moved, now[-1])
        elif _is_over(leg, changed, least, now[-1]):
            state.leg = Leg(first=seen, own=now, reported=reported)

    def _contradicts(
        self, seen: complex, own: tuple[Moved, ...], reported: complex | None, report_age: float
    ) -> bool:
        """Doubt it if own motion and the neighbour's cannot have brought it to `seen` [m; body frame].

        Either own motion or the displacement may be late, by up to `RECENT_TIME`.
        """
        state, now = self.state, own[-1]
        state.seen.append(Seen(now.moment, seen))
        while len(state.seen) > 1 and state.seen[1].moment <= now.moment - RECENT_TIME:
            state.seen.popleft()
        recent = tuple(state.seen)
        if state.course is None or reported is None:
            full = recent[0].moment <= now.moment - RECENT_TIME
            state.course = Course(recent, own, reported) if full and reported is not None else None
            return False
        course, then = state.course, state.course.own[0]
        path, turn, duration = now.path - then.path, now.turning - then.turning, now.moment - then.moment
        first = course.seen[-1].displacement
        limit = MAX_COURSE_ERROR + MAX_COURSE_ERROR_RATIO * (path + abs(first) * turn)
        limit += REPORTED_RATIO * abs(reported - course.reported)
        limit += self._top_speed * (RECENT_TIME + report_age)  # it may have gone so far since
        limit += _step(first, course.own) + _step(seen, own)
        if all(error > limit for error in _errors(course, recent, own)):
            distance = min(_errors(course, recent, own))
            why = Reason.of(
                Code.RELATIVE_CONTRADICTED,
                robot=self._name,
                distance=distance,
                duration=duration,
                limit=limit,
            )
            state.doubt = RelativeDoubt(why, now.moment, seen, FAR)
            return True
        if path > COURSE_PATH or turn > COURSE_TURN or duration > FORGETTING_TIME:
            state.course = Course(recent, own, reported)
        return False

    def _change(self, leg: Leg, recent: tuple[Moved, ...]) -> float:
        """Least change of the displacement by own motion since `leg` began [m]; may be negative."""
        pairs = zip(reversed(leg.own), reversed(recent), strict=False)
        return min(self._changed(leg.first, *pair) for pair in pairs) - _step(leg.first, recent)

    def _changed(self, seen: complex, then: Moved, now: Moved) -> float:
        """Change of a displacement `seen`, of what stands, by the motion from `then` to `now` [m]."""
        if not self._by_odometry:
            return abs(now.shift - then.shift) - abs(seen) * (now.turning - then.turning)
        return abs(_unmoved(seen, then, now) - seen)

    def _doubt(self, seen: complex, leg: Leg, least: float, ends_beyond: float, now: Moved) -> None:
        why = Reason.of(
            Code.RELATIVE_FROZEN,
            robot=self._name,
            expected=least,
            seen=abs(seen - leg.first),
            duration=now.moment - leg.own[-1].moment,
            least=MIN_MOTION_SHARE * least,
        )
        self.state.doubt = RelativeDoubt(why, now.moment, seen, ends_beyond)


def _unmoved(seen: complex, then: Moved, now: Moved) -> complex:
    """Where something that stands is seen after the motion from `then` to `now`, if it was at `seen`.

    [m; body frame]
    """
    back = then.facing.conjugate()
    shift, facing = back * (now.at - then.at), back * now.facing
    return facing.conjugate() * (seen - shift)


def _step(seen: complex, recent: tuple[Moved, ...]) -> float:
    """Greatest change of a displacement `seen` by the own motion of one interval, on average [m]."""
    old, now = recent[0], recent[-1]
    change = now.path - old.path + abs(seen) * (now.turning - old.turning)
    return change / max(1, len(recent) - 1)


def _errors(course: Course, seen: tuple[Seen, ...], own: tuple[Moved, ...]) -> Iterator[float]:
    """Distances of a displacement from where own motion took it, with each delay of either [m]."""
    newest, last = seen[-1].displacement, course.seen[-1].displacement
    for then, now in zip(reversed(course.own), reversed(own), strict=False):
        yield abs(newest - _unmoved(last, then, now))
    for before, after in zip(reversed(course.seen), reversed(seen), strict=False):
        yield abs(after.displacement - _unmoved(before.displacement, course.own[-1], own[-1]))


def _is_over(leg: Leg, changed: float, least: float, now: Moved) -> bool:
    """Whether a leg ends: motion was seen, none is left to be explained, or it is old."""
    shown = changed > POSITION.moved and changed > MIN_MOTION_SHARE * least
    explained = least <= 0.0 and now.path - leg.own[-1].path > EXPLAINED_PATH
    return shown or explained or now.moment - leg.own[-1].moment > FORGETTING_TIME
