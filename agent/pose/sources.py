"""Where a robot's positions come from: odometry, or external poses (a camera or motion capture).

Odometry is placed in the world, and doubted when it is impossible. `odometry_frame = "world"`: it counts in
the world frame, and after a jump it is believed again at its new position. `odometry_frame = "start"`: it
counts from where the robot was switched on, which is the mission's start pose, and continues while an agent
restarts. A jump then (`reset_odometry`, a restart of the robot's own software) is a new count, and is placed
so that the robot's position does not change.

External poses are the paper's other source. The distance and turn between two positions are computed from the
commands sent to the robot, as in the paper; odometry is not read.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

from formation.agent.pose.motion_model import Held, forget, spans
from formation.control.controller import Limits
from formation.control.observer import Travel
from formation.control.plane import angle_between, clip, rotation, shorten, unit
from formation.control.unicycle import AT_REST, Command, advance
from formation.mission.model import Mission
from formation.mission.robot import Start
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import Localised
from formation.ros2.messages import Odometry, Pose

MAX_SPEED_RATIO = 1.5
"""Greatest ratio of a robot's speed to its limit; more is an error."""
JUMP_MARGIN = 0.1
"""Distance from what the robot's limits explain that counts as a jump [m]."""
TURN_MARGIN = 0.3
"""The same for its heading [rad]."""
SPEED_JUMP_DISTANCE, SPEED_JUMP_ANGLE = 0.01, 0.05
"""Difference from what the reported speeds explain that counts as a jump, where the count may restart [m;
rad]."""
JUMP_DEVIATIONS = 8.5
"""Where more noise is stated, so many deviations replace `SPEED_JUMP_DISTANCE`: 6 of the difference
of two positions, so that noise exceeds them once in 60 million messages."""
JUMP_SHARE = 0.1
"""The same as a share of the fastest change: for motion between two messages."""
ORIGIN_DISTANCE = 0.05
"""Distance to its origin below which odometry, after a silence, has restarted [m]."""
ALIGN_TIME = 0.3
"""Time constant with which odometry is placed anew where a better pose is known [s]."""
MAX_ALIGN_SPEED, MAX_ALIGN_RATE = 0.05, math.radians(3.0)
"""Fastest change of that placement [m/s; rad/s]."""
HISTORY_TIME = 5.0
"""Age after which commands are forgotten [s]."""
COASTING_TIME = 0.5
"""Approximate time that a robot moves on after its agent's death [s]."""


class PoseUpdate(NamedTuple):
    """A robot's position, and its motion since the one before."""

    position: complex
    """Centre [m; world frame]."""
    heading: complex
    """As it was measured, unit [world frame]."""
    travel: Travel | None
    """Since the message before; None for the first."""
    jumped: Reason | None = None
    """The impossible motion since then."""
    turned: complex = 1.0 + 0.0j
    """Its turn, as a unit complex number, where `jumped` means that `travel` does not contain it."""


def believable(moving: Command, limits: Limits) -> bool:
    """Whether a robot of these limits can move and turn so fast."""
    return _can(moving.speed, limits.max_speed) and _can(moving.turn_rate, limits.max_turn_rate)


def impossible(source: str, moved: float, turned: float, limits: Limits, over: float) -> Reason | None:
    """The jump of `source` if `limits` do not allow so much [m; rad] in `over` [s]; else None."""
    if moved > MAX_SPEED_RATIO * limits.max_speed * over + JUMP_MARGIN:
        return Reason.of(Code.POSITION_JUMPED, source=source, distance=moved)
    if abs(turned) > MAX_SPEED_RATIO * limits.max_turn_rate * over + TURN_MARGIN:
        return Reason.of(Code.HEADING_JUMPED, source=source, angle=turned)
    return None


@dataclass(slots=True, kw_only=True)
class OdometryState:
    """Where odometry is placed, and its newest message."""

    realigned: int = 0
    """Number of times that it was placed anew."""
    realigned_after: Reason | None = None
    """The newest jump after which it was placed anew."""
    rotation: complex = 1.0 + 0.0j
    """Heading of the odometry's frame, unit [world frame]."""
    origin: complex = 0j
    """Origin of the odometry's frame [m; world frame]."""
    last: Odometry | None = None
    """The newest message; None before the first."""
    corrected: complex = 0j
    """What `align` has made of the world's origin [m; world frame]."""
    turned: complex = 1.0 + 0.0j
    """By how much it has turned odometry's frame, unit."""


class OdometrySource:
    """One robot's odometry in the world frame."""

    name = "odometry"

    def __init__(self, mission: Mission, robot: str) -> None:
        spec = mission.robots[robot]
        self.state = OdometryState()
        self._frame = spec.odometry_frame
        self._counts_from_start = spec.odometry_frame != "world"
        if spec.odometry_frame == "start":
            self.state.rotation, self.state.origin = spec.start.heading, spec.start.position
        self._limits = spec.limits
        self._jump_distance = max(SPEED_JUMP_DISTANCE, JUMP_DEVIATIONS * mission.collisions.noise)

    @property
    def alignment(self) -> Localised:
        """How it is placed in the world."""
        if self._frame == "map":
            return Localised.ODOMETRY_MAP
        return Localised.ODOMETRY_START if self._counts_from_start else Localised.ODOMETRY_WORLD

    def place(self, rotation: complex, origin: complex) -> complex:
        """Place odometry's frame in the world at once [unit; m]; return the turn, unit complex."""
        turn, self.state.rotation = rotation / self.state.rotation, rotation
        self.state.origin, self.state.corrected, self.state.turned = origin, 0j, 1.0 + 0.0j
        return turn

    def make_update(self, odometry: Odometry, over: float | None, limit: float) -> PoseUpdate:
        """The update, `over` [s] after the message before (None for the first).

        More than `limit` [s] are a gap, in which the motion is unknown.
        """
        state = self.state
        last, state.last = state.last, odometry
        if last is None or over is None:
            return PoseUpdate(*self._placed(odometry), None)
        travel = Travel(
            distance=0.5 * (last.speed + odometry.speed) * over,
            # ∫ω dt exactly, however ω changed in between; the heading itself is not read
            turn=float(angle_between(last.heading, odometry.heading)),
            displacement=state.rotation * (odometry.position - last.position),
        )
        farthest = max(abs(travel.displacement), abs(travel.distance))
        jumped = impossible(self.name, farthest, travel.turn, self._limits, over)
        if not self._counts_from_start:
            return PoseUpdate(*self._placed(odometry), travel, jumped)
        jumped = jumped or (
            _begun_anew(last, odometry, travel) if over > limit else self._unexplained(last, odometry, over)
        )
        if jumped is None:
            return PoseUpdate(*self._placed(odometry), travel)
        turned = self._realign(last, odometry, min(over, limit))
        state.realigned_after = jumped
        return PoseUpdate(*self._placed(odometry), travel, jumped, turned)

    @property
    def correction(self) -> float:
        """Distance of the newest position from where odometry would be without `align` [m]."""
        state = self.state
        if state.last is None:
            return 0.0
        at, _ = self._placed(state.last)
        return abs(at - (at - state.corrected) * state.turned.conjugate())

    def align(self, position: complex, heading: complex, elapsed: float) -> tuple[complex, complex]:
        """Move the placement towards a better pose of the newest message; return the step [m] and unit turn.

        `position` [m] and unit `heading` are in the world frame. In `elapsed` [s] it moves by a share of the
        difference, and at most by `MAX_ALIGN_SPEED` and `MAX_ALIGN_RATE`: the robot makes no jump.
        """
        state = self.state
        if state.last is None:
            return 0j, 1.0 + 0.0j
        at, facing = self._placed(state.last)
        share = -math.expm1(-elapsed / ALIGN_TIME)
        step = shorten(share * (position - at), MAX_ALIGN_SPEED * elapsed)
        turn = rotation(clip(share * float(angle_between(facing, heading)), MAX_ALIGN_RATE * elapsed))
        state.rotation = unit(state.rotation * turn)
        state.origin = at + step - state.rotation * state.last.position
        state.corrected = at + step + turn * (state.corrected - at)
        state.turned = unit(state.turned * turn)
        return step, turn

    def unlike(self, odometry: Odometry, over: float) -> str | None:
        """Why this cannot be the same robot's odometry `over` [s] after the newest message, in words."""
        last = self.state.last
        if last is None:
            return "no odometry had been received"
        if (odometry.frame, odometry.child_frame) != (last.frame, last.child_frame):
            return f"odometry counts in {odometry.frame}, and counted in {last.frame}"
        if self._counts_from_start:  # a new count is detected, and placed where the robot was
            return None
        moved, turn = (
            abs(odometry.position - last.position),
            float(angle_between(last.heading, odometry.heading)),
        )
        jumped = impossible(self.name, moved, turn, self._limits, over)
        return None if jumped is None else f"{jumped} in {over:.1f} s"

    def _placed(self, odometry: Odometry) -> tuple[complex, complex]:
        return (
            self.state.origin + self.state.rotation * odometry.position,
            self.state.rotation * odometry.heading,
        )

    def _unexplained(self, last: Odometry, now: Odometry, over: float) -> Reason | None:
        """What the speeds of both messages do not explain."""
        turn = float(angle_between(last.heading, now.heading))
        ahead = (now.position - last.position) / (last.heading * cmath.rect(1.0, 0.5 * turn))
        slow, fast = sorted((last.speed * over, now.speed * over))
        off = abs(complex(ahead.real - min(max(ahead.real, slow), fast), ahead.imag))
        if off > self._jump_distance + JUMP_SHARE * self._limits.max_speed * over:
            return Reason.of(Code.POSITION_JUMPED, source=self.name, distance=off)
        slow, fast = sorted((last.turn_rate * over, now.turn_rate * over))
        off = turn - min(max(turn, slow), fast)
        if abs(off) > SPEED_JUMP_ANGLE + JUMP_SHARE * self._limits.max_turn_rate * over:
            return Reason.of(Code.HEADING_JUMPED, source=self.name, angle=off)
        return None

    def _realign(self, last: Odometry, now: Odometry, over: float) -> complex:
        """Place `now` where `last` led to; return the turn meanwhile."""
        state = self.state
        position, heading = self._placed(last)
        speed = last.speed if _can(last.speed, self._limits.max_speed) else 0.0
        turn_rate = last.turn_rate if _can(last.turn_rate, self._limits.max_turn_rate) else 0.0
        there, facing = advance(position, heading, speed, turn_rate, over)
        turned = facing / now.heading
        state.rotation = turned / abs(turned)
        state.origin = there - state.rotation * now.position
        state.realigned += 1
        return facing / heading


def counts_from_start_pose(state: OdometryState, odometry: Odometry, start: Start) -> bool:
    """Whether `odometry` goes on with the count of a robot that stood, and that counts from the `start` pose.

    Otherwise it may have begun anew elsewhere.
    """
    last = state.last
    if last is None:
        return False
    placed = abs(state.origin - start.position) <= JUMP_MARGIN
    faces = abs(angle_between(state.rotation, start.heading)) <= TURN_MARGIN
    stood = abs(odometry.position - last.position) <= JUMP_MARGIN
    return placed and faces and stood and abs(angle_between(last.heading, odometry.heading)) <= TURN_MARGIN


def _can(rate: float, most: float) -> bool:
    return abs(rate) <= MAX_SPEED_RATIO * most


def _begun_anew(last: Odometry, now: Odometry, travel: Travel) -> Reason | None:
    """Whether odometry has restarted at zero after a long silence."""
    if abs(now.position) > ORIGIN_DISTANCE:
        return None
    source, moved = OdometrySource.name, abs(now.position - last.position)
    if moved > ORIGIN_DISTANCE:
        return Reason.of(Code.POSITION_JUMPED, source=source, distance=moved)
    # a robot that turns where it was switched on is near its origin all the time, without a restart
    facing = abs(cmath.phase(now.heading))
    if not abs(travel.turn) > TURN_MARGIN >= facing:
        return None
    return Reason.of(Code.HEADING_JUMPED, source=source, angle=travel.turn)


@dataclass(slots=True, kw_only=True)
class ExternalPoseState:
    """The newest external pose, and the commands since."""

    realigned: ClassVar[int] = 0
    realigned_after: ClassVar[Reason | None] = None
    last: Pose | None = None
    """The newest message; None before the first."""
    sent: deque[Held] = field(default_factory=deque)
    """The commands of the last `HISTORY_TIME` seconds, oldest first."""


class ExternalPoseSource:
    """The external poses of one robot."""

    name = "pose"
    alignment = Localised.EXTERNAL

    def __init__(self, mission: Mission, robot: str) -> None:
        spec = mission.robots[robot]
        self._limits = spec.limits
        self._reads_heading = spec.heading == "measured"
        self.state = ExternalPoseState()

    def commanded(self, moment: float, command: Command) -> None:
        """Record that the robot was sent `command` at `moment` [s, monotonic]."""
        forget(self.state.sent, moment - HISTORY_TIME)
        if not self.state.sent or self.state.sent[-1].command != command:
            self.state.sent.append(Held(moment, command))

    def unlike(self, pose: Pose, over: float) -> str | None:
        """Why the robot's turn in the `over` [s] since the newest position is unknown, in words.

        It was sent no commands since: a robot that moved was carried, or drove on without being stopped.
        """
        if self.state.last is None:
            return "it had not been seen"
        moved, over = abs(pose.position - self.state.last.position), min(over, COASTING_TIME)
        jumped = impossible(self.name, moved, 0.0, self._limits, over)
        return None if jumped is None else f"{jumped} while no agent drove the robot"

    def stood(self, since: float) -> None:
        """Assume that the robot has stood since then [s, monotonic]: the agent that drove it has ended."""
        self.state.sent = deque([Held(since, AT_REST)])

    def make_update(self, pose: Pose, over: float | None, moment: float) -> PoseUpdate:
        """The update for a pose at `moment` [s, monotonic], `over` [s] after the one before."""
        last, self.state.last = self.state.last, pose
        if last is None or over is None:
            return PoseUpdate(pose.position, pose.heading, None)
        distance, turn = 0.0, 0.0
        for held, command in spans(self.state.sent, moment - over, moment):
            distance += command.speed * held
            turn += command.turn_rate * held
        moved, seen_turn = pose.position - last.position, 0.0
        if self._reads_heading:  # it also shows turns by hand
            turn = seen_turn = float(angle_between(last.heading, pose.heading))
        jumped = impossible(self.name, abs(moved), seen_turn, self._limits, over)
        return PoseUpdate(pose.position, pose.heading, Travel(distance, turn, moved), jumped, rotation(turn))
