"""Move the shape to the wanted one, smoothly and within the followers' limits.

The state of a shape is q: each shape's share, the rotation, the scale. A reference point c, the *carrot*,
moves straight and at a constant rate to each ordered shape; q is its mean over the last τ,

    q(φ) = 1/τ ∫_{φ-τ}^{φ} c(s) ds.

So q and its velocity are continuous, q never leaves the shapes' convex hull, and arrives exactly τ after the
carrot. A new order only gives the carrot another direction. φ is the transition's own time: it passes at most
as fast as the clock's, and slower where a slot would otherwise be faster than its limit s_i (`_max_speeds`):
with the leader's velocity v, |ż_i| ≤ s_i gives |v + ż_i| ≤ |v| + s_i for every follower, in any direction of
both.

With `turning` the shape also follows the leader's heading, like a body with bounded turn rate and bounded
turn acceleration, within the same limits.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from formation.control.arrays import ComplexArray, FloatArray
from formation.control.plane import clip
from formation.mission.model import Mission
from formation.slots.shape import PlacedShape
from formation.stability.intent import SLOT_SPEED_SHARE, TRANSITION_SAMPLES

MIN_SLOT_SPEED_SHARE = 0.01
"""Least share of a follower's top speed for its slot's motion, at any speed of the leader."""
SMOOTHING_TIME = 2.0
"""τ: the time in which a slot gets from rest to full speed [s]."""
MAX_MIXED_SHAPES = 8
"""Largest number of shapes that an order can mix."""
MAX_MIX_CHARS = 256
"""Largest total length of the names of mixed shapes [characters]."""
MAX_TURN_RATE = 1.0
"""Highest turn rate of the placed shape, at any scale [rad/s]."""
TURN_GAIN = 2.0
"""Ratio of the shape's turn rate to its lag behind the leader's heading, for a small lag [1/s]."""
TURN_SAMPLES = 5
"""Number of samples of a shape that turns with the leader's heading."""
_HALVINGS = 24


class OrderedShape(NamedTuple):
    """The wanted shape."""

    shape: str
    rotation: float = 0.0
    """Relative to the shape as drawn, or to the leader's heading [rad]."""
    scale: float = 1.0


class Path(NamedTuple):
    """The carrot's path: straight from one point to the next."""

    times: tuple[float, ...]
    """When it is at each point, rising [s of the transition's time]."""
    points: tuple[FloatArray, ...]

    def carrot(self, time: float) -> FloatArray:
        """Return the carrot's point."""
        if time <= self.times[0]:
            return self.points[0]
        for k in range(1, len(self.times)):
            if time < self.times[k]:
                part = (time - self.times[k - 1]) / (self.times[k] - self.times[k - 1])
                return (1.0 - part) * self.points[k - 1] + part * self.points[k]
        return self.points[-1]

    def smooth(self, time: float) -> FloatArray:
        """Return the shape's point: the carrot's mean over the last `SMOOTHING_TIME`."""
        begin = time - SMOOTHING_TIME
        if begin >= self.times[-1]:
            return self.points[-1]
        knots = [begin, *(t for t in self.times if begin < t < time), time]
        at = [self.carrot(t) for t in knots]
        whole = np.zeros_like(self.points[0])
        for (a, b), (before, after) in zip(pairwise(knots), pairwise(at), strict=True):
            whole += (b - a) * 0.5 * (before + after)
        return whole / SMOOTHING_TIME

    def extended(self, time: float, point: FloatArray, duration: float) -> Path:
        """Return the path from the carrot at `time` to `point` in `duration` [s], with its past."""
        first = max((k for k, t in enumerate(self.times) if t <= time - SMOOTHING_TIME), default=0)
        kept = [k for k in range(first, len(self.times)) if self.times[k] < time]
        times = [*(self.times[k] for k in kept), time, time + duration]
        return Path(tuple(times), (*(self.points[k] for k in kept), self.carrot(time), point))

    @property
    def end(self) -> float:
        """When the shape arrives [s of the transition's time]."""
        return self.times[-1] + SMOOTHING_TIME


class ShapeTransition:
    """The shape of a mission, and its motion to the wanted shape."""

    def __init__(
        self, mission: Mission, placed_shape: PlacedShape, ordered: OrderedShape, speed: float = 0.0
    ) -> None:
        """Move from `placed_shape` to `ordered`, with the leader at this `speed` [m/s]."""
        self._mission = mission
        self._shapes = tuple(mission.shapes)
        self._drawn: ComplexArray = np.array(
            [[mission.slot(name, shape) for name in mission.followers] for shape in self._shapes]
        )
        self._top: FloatArray = np.array([mission.robots[name].max_speed for name in mission.followers])
        self.ordered = ordered
        """The wanted shape."""
        # turn with the leader's heading so far [rad], and its rate [rad/s]
        self._turn = placed_shape.rotation - ordered.rotation if mission.turning else 0.0
        self._turn_rate = 0.0
        shares = dict(placed_shape.mix)
        q = np.array([shares.get(shape, 0.0) for shape in self._shapes] + [0.0, placed_shape.scale])
        q[-2] = ordered.rotation if mission.turning else placed_shape.rotation
        self._time, self._pace = 0.0, 1.0
        self._path = Path((0.0,), (q,))
        target = self._target(ordered)
        if not np.array_equal(target, q):
            self._path = self.plan_path(ordered, speed)

    @classmethod
    def first(cls, mission: Mission) -> ShapeTransition:
        """Return a transition that rests in the mission's first shape."""
        return cls(mission, PlacedShape.first(mission), OrderedShape(mission.first_shape))

    @property
    def arrived(self) -> bool:
        """Whether it is the wanted shape, apart from the leader's heading."""
        return self._time >= self._path.end or len(self._path.times) == 1

    @property
    def remaining(self) -> float:
        """Shortest time until arrival [s]."""
        return 0.0 if self.arrived else self._path.end - self._time

    @property
    def placed_shape(self) -> PlacedShape:
        """Where the slots are."""
        return self._placed_shape(self._at(self._time), self._turn)

    def plan_path(self, ordered: OrderedShape, speed: float) -> Path:
        """Return the path from the current shape to `ordered` with the leader at this speed [m/s]."""
        begin, target = self._path.carrot(self._time), self._target(ordered)
        return self._path.extended(self._time, target, self._duration(begin, target, speed))

    def placed_shapes(self, path: Path) -> list[PlacedShape]:
        """Return `TRANSITION_SAMPLES` shapes along a path, from the current one to its end."""
        times = np.linspace(self._time, path.end, TRANSITION_SAMPLES)
        return [self._placed_shape(path.smooth(float(time)), self._turn) for time in times]

    def ahead(self, heading: complex) -> list[PlacedShape]:
        """Return the shapes from now on if the leader's heading is `heading` (unit) meanwhile."""
        placed_shapes = [self.placed_shape] if self.arrived else self.placed_shapes(self._path)
        if not self._mission.turning:
            return placed_shapes
        left = cmath.phase(heading * cmath.rect(1.0, -self._turn))
        turns = [left * part / (TURN_SAMPLES - 1) for part in range(TURN_SAMPLES)]
        return [one._replace(rotation=one.rotation + turn) for one in placed_shapes for turn in turns]

    def fits_order(self, path: Path) -> bool:
        """Return whether an order can express the mix of shapes on the path."""
        shares = np.max([point[:-2] for point in path.points], axis=0)
        mixed = [shape for shape, share in zip(self._shapes, shares, strict=True) if share > 0.0]
        return len(mixed) <= MAX_MIXED_SHAPES and (len(mixed) <= 2 or len("".join(mixed)) <= MAX_MIX_CHARS)

    def follow(self, ordered: OrderedShape, path: Path) -> None:
        """Follow `path` from now on, which `plan_path` gave for `ordered`."""
        self.ordered, self._path = ordered, path

    def advance(self, dt: float, share: float, speed: float, heading: complex, turn_rate: float) -> None:
        """Advance by `dt` [s], of which the transition may use a `share`.

        The leader is at most as fast as `speed` [m/s] meanwhile, and in the end has `heading` (unit) and
        turns at `turn_rate` [rad/s].
        """
        if dt <= 0.0:
            return
        pace = min(1.0, self._pace + dt / SMOOTHING_TIME) if not self.arrived else 1.0
        max_speeds, before = self._max_speeds(speed), self._slots(self._at(self._time), self._turn)
        rate = self._next_turn_rate(dt * share, heading, turn_rate, max_speeds, np.abs(before))

        def fits(part: float) -> bool:
            after = self._slots(
                self._at(self._time + part * pace * dt * share), self._turn + part * rate * dt * share
            )
            return bool(np.all(np.abs(after - before) <= max_speeds * dt))

        part = 1.0 if fits(1.0) else _largest_fitting(fits)
        self._pace = part * pace
        self._time += self._pace * dt * share
        self._turn_rate = part * rate
        self._turn += self._turn_rate * dt * share

    def rest(self) -> None:
        """Stand still: the next motion starts from rest."""
        self._pace, self._turn_rate = 0.0, 0.0

    def _at(self, time: float) -> FloatArray:
        """Return q at `time` [s of the transition's time]."""
        return self._path.points[0] if len(self._path.times) == 1 else self._path.smooth(time)

    def _next_turn_rate(
        self, dt: float, heading: complex, turn_rate: float, max_speeds: FloatArray, reach: FloatArray
    ) -> float:
        """Return the turn rate towards the leader's heading [rad/s]; `reach`: the slots' distances [m]."""
        if not self._mission.turning or dt <= 0.0:
            return 0.0
        limit = float(np.min(max_speeds / np.maximum(reach, 1e-9), initial=MAX_TURN_RATE))
        acceleration = limit / SMOOTHING_TIME  # [rad/s²]
        lag = cmath.phase(heading * cmath.rect(1.0, -self._turn - turn_rate * dt))
        wanted = turn_rate + clip(_braking_rate(lag, 0.7 * acceleration), abs(lag) / dt)
        change = clip(clip(wanted, limit) - self._turn_rate, acceleration * dt)
        return self._turn_rate + change

    def _max_speeds(self, speed: float) -> FloatArray:
        """Return how fast each slot may move with the leader at this speed [m/s]."""
        return np.asarray(
            np.maximum(SLOT_SPEED_SHARE * (self._top - speed), MIN_SLOT_SPEED_SHARE * self._top)
        )

    def _duration(self, begin: FloatArray, target: FloatArray, speed: float) -> float:
        """Return how long the carrot takes from `begin` to `target` [s]."""
        parts = np.linspace(0.0, 1.0, TRANSITION_SAMPLES)
        slots = np.array([self._slots((1.0 - part) * begin + part * target, 0.0) for part in parts])
        fastest = np.max(np.abs(np.diff(slots, axis=0)), axis=0) * (TRANSITION_SAMPLES - 1)
        return max(float(np.max(fastest / self._max_speeds(speed), initial=0.0)), 1e-3)

    def _target(self, ordered: OrderedShape) -> FloatArray:
        shares = [1.0 if shape == ordered.shape else 0.0 for shape in self._shapes]
        before = float(self._path.carrot(self._time)[-2])
        shortest = math.remainder(ordered.rotation - before, math.tau)
        return np.array([*shares, before + shortest, ordered.scale])

    def _slots(self, q: FloatArray, turn: float) -> ComplexArray:
        """Return all followers' slots relative to the leader [m; world frame]."""
        return np.asarray(q[-1] * cmath.rect(1.0, float(q[-2]) + turn) * (q[:-2] @ self._drawn))

    def _placed_shape(self, q: FloatArray, turn: float) -> PlacedShape:
        mix = tuple((shape, float(share)) for shape, share in zip(self._shapes, q[:-2], strict=True) if share)
        return PlacedShape(mix, math.remainder(float(q[-2]) + turn, math.tau), float(q[-1]))


def _braking_rate(lag: float, deceleration: float) -> float:
    """Return the turn rate from which braking by `deceleration` [rad/s²] ends at lag 0; `lag` in rad."""
    near = deceleration / TURN_GAIN**2
    if abs(lag) <= near:
        return TURN_GAIN * lag
    return math.copysign(math.sqrt(2.0 * deceleration * (abs(lag) - near / 2.0)), lag)


def _largest_fitting(fits: Callable[[float], bool]) -> float:
    """Return about the largest part in [0, 1] that fits; all parts below a fitting one must fit."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low
