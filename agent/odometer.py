"""Odometry as a source of positions: placed in the world, and doubted when it says what cannot be.

`odometry_frame = "world"`: it counts in the world frame, and after a jump it is believed again where it then
says to be. `odometry_frame = "start"`: it counts from where the robot was switched on, which is the mission's
start pose, and goes on counting while an agent restarts. Whatever jumps then (`reset_odometry`, a restart of
the robot's own software) is a new count, and is placed so that the robot is still where it was.
"""

from __future__ import annotations

import cmath

from agent.sighting import Sighting
from formation.heading import Travel
from formation.law import Limits
from formation.mission import Mission
from formation.plane import angle_between
from formation.ros2.messages import Odometry
from formation.unicycle import Command, advance

FASTER = 1.5
"""A robot may go so many times as fast as its limit says; more is a mistake."""
JUMP_MARGIN = 0.1
"""How far a position may be off what the robot's limits explain before it counts as a jump [m]."""
TURN_MARGIN = 0.3
"""The same for its heading [rad]."""
SLACK, TURN_SLACK = 0.01, 0.05
"""How far a change may be off what the reported speeds explain, where the count may begin anew [m; rad]."""
SHARE = 0.1
"""… and the same as a share of the fastest change: for what happened between two messages."""
ORIGIN = 0.05
"""A robot whose odometry has been silent and is now this near its origin has begun to count anew [m]."""


def believable(moving: Command, limits: Limits) -> bool:
    """Whether a robot of these limits may well go and turn so fast."""
    return _can(moving.speed, limits.max_speed) and _can(moving.turn_rate, limits.max_turn_rate)


def impossible(moved: float, turned: float, most: float, most_turn: float, over: float) -> str | None:
    """Why limits of `most` [m/s] and `most_turn` [rad/s] do not allow so much [m; rad] in `over` [s]."""
    if moved > FASTER * most * over + JUMP_MARGIN:
        return f"{moved:.2f} m"
    if abs(turned) > FASTER * most_turn * over + TURN_MARGIN:
        return f"{turned:+.2f} rad"
    return None


class Odometer:
    """One robot's odometry in the world frame."""

    name = "odometry"
    doubt: str | None = None

    def __init__(self, mission: Mission, robot: str) -> None:
        spec = mission.robots[robot]
        self.realigned = 0
        """How often it was placed anew."""
        self._counts_from_start = spec.odometry_frame == "start"
        self._rotation, self._origin = 1.0 + 0.0j, 0j  # of the odometry's frame [world frame]
        if self._counts_from_start:
            self._rotation, self._origin = spec.start.heading, spec.start.position
        self._limits = spec.limits
        self._last: Odometry | None = None
        self._why = ""

    @property
    def alignment(self) -> str:
        """How it is placed in the world, in words."""
        if not self._counts_from_start:
            return "odometry in the world frame"
        if not self.realigned:
            return "odometry from the start pose"
        return f"odometry re-aligned {self.realigned} times, last after a jump of {self._why}"

    def see(self, odometry: Odometry, over: float | None, limit: float) -> Sighting:
        """Where it says to be, `over` [s] after the message before (None for the first).

        More than `limit` [s] are a gap, of which nobody knows what happened in it.
        """
        last, self._last = self._last, odometry
        if last is None or over is None:
            return Sighting(*self._placed(odometry), None)
        travel = Travel(
            distance=0.5 * (last.speed + odometry.speed) * over,
            # ∫ω dt exactly, however ω changed in between; the heading itself is never read
            turn=float(angle_between(last.heading, odometry.heading)),
            displacement=self._rotation * (odometry.position - last.position),
        )
        farthest = max(abs(travel.displacement), abs(travel.distance))
        jumped = impossible(farthest, travel.turn, self._limits.max_speed, self._limits.max_turn_rate, over)
        if not self._counts_from_start:
            return Sighting(*self._placed(odometry), travel, jumped)
        jumped = jumped or (
            _begun_anew(last, odometry, travel) if over > limit else self._unexplained(last, odometry, over)
        )
        if jumped is None:
            return Sighting(*self._placed(odometry), travel)
        turned = self._realign(last, odometry, min(over, limit))
        self._why = jumped
        return Sighting(*self._placed(odometry), travel, jumped, turned)

    def unlike(self, odometry: Odometry, over: float) -> str | None:
        """Why this cannot be the same robot's count `over` [s] after the newest message, in words."""
        last = self._last
        if last is None:
            return "no odometry had been heard"
        if (odometry.frame, odometry.child_frame) != (last.frame, last.child_frame):
            return f"odometry counts in {odometry.frame}, and counted in {last.frame}"
        if self._counts_from_start:  # a new count is found, and placed where the robot was
            return None
        moved, turn = (
            abs(odometry.position - last.position),
            float(angle_between(last.heading, odometry.heading)),
        )
        jumped = impossible(moved, turn, self._limits.max_speed, self._limits.max_turn_rate, over)
        return jumped and f"it moved {jumped} in {over:.1f} s"

    def _placed(self, odometry: Odometry) -> tuple[complex, complex]:
        return (
            self._origin + self._rotation * odometry.position,
            self._rotation * odometry.heading,
        )

    def _unexplained(self, last: Odometry, now: Odometry, over: float) -> str | None:
        """What the speeds that both messages report do not explain."""
        turn = float(angle_between(last.heading, now.heading))
        ahead = (now.position - last.position) / (last.heading * cmath.rect(1.0, 0.5 * turn))
        slow, fast = sorted((last.speed * over, now.speed * over))
        off = abs(complex(ahead.real - min(max(ahead.real, slow), fast), ahead.imag))
        if off > SLACK + SHARE * self._limits.max_speed * over:
            return f"{off:.2f} m"
        slow, fast = sorted((last.turn_rate * over, now.turn_rate * over))
        off = turn - min(max(turn, slow), fast)
        if abs(off) > TURN_SLACK + SHARE * self._limits.max_turn_rate * over:
            return f"{off:+.2f} rad"
        return None

    def _realign(self, last: Odometry, now: Odometry, over: float) -> complex:
        """Have `now` be where `last` led to; the turn meanwhile."""
        position, heading = self._placed(last)
        speed = last.speed if _can(last.speed, self._limits.max_speed) else 0.0
        turn_rate = last.turn_rate if _can(last.turn_rate, self._limits.max_turn_rate) else 0.0
        there, facing = advance(position, heading, speed, turn_rate, over)
        rotation = facing / now.heading
        self._rotation = rotation / abs(rotation)
        self._origin = there - self._rotation * now.position
        self.realigned += 1
        return facing / heading


def _can(rate: float, most: float) -> bool:
    return abs(rate) <= FASTER * most


def _begun_anew(last: Odometry, now: Odometry, travel: Travel) -> str | None:
    """Whether a count that was silent for long has begun again at zero."""
    if abs(now.position) > ORIGIN:
        return None
    if abs(now.position - last.position) > ORIGIN:
        return f"{abs(now.position - last.position):.2f} m"
    # a robot that turns where it was switched on is near its origin all the time, and has not begun anew
    facing = abs(cmath.phase(now.heading))
    return f"{travel.turn:+.2f} rad" if abs(travel.turn) > TURN_MARGIN >= facing else None
