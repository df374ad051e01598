"""Moves the figure from where it is to where it is wanted, smoothly and within what the followers can do.

What changes is q: each shape's share, the rotation, the scale. A carrot c goes straight from where it is to
each new wish, at a constant rate; the figure is where c was on average,

    q(φ) = 1/τ ∫_{φ-τ}^{φ} c(s) ds,

so it is continuous with a continuous velocity, never leaves the shapes' convex hull, and is exactly there τ
after the carrot. A new wish in the middle just turns the carrot. φ is the mover's own time: it goes by at
most as fast as the clock's, and slower where a slot would otherwise move faster than its `room`: with the
leader's velocity v, |ż_i| ≤ room_i gives |v + ż_i| ≤ |v| + room_i for every follower, wherever both point.

With `turning` the figure also follows the leader's heading, like a body with bounded turn rate and bounded
turn acceleration, within the same room.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from formation.arrays import ComplexArray, FloatArray
from formation.figure import Figure
from formation.intent import SAMPLES, SHARE
from formation.mission import Mission

LEAST = 0.01
"""Of a follower's top speed so much is for that, however fast the leader is."""
SMOOTH = 2.0
"""τ: from rest to full speed takes a slot so long [s]."""
MOST_SHAPES = 8
"""So many an order can mix …"""
LONGEST_MIX = 256
"""… with names of so many characters together."""
MOST_TURN = 1.0
"""Turn rate of the figure that is never exceeded, however small it is [rad/s]."""
GAIN = 2.0
"""Of the figure's turn rate over its lag behind the leader's heading, when that is small [1/s]."""
TURNS = 5
"""So many looks are taken at a figure that is to turn with the leader's heading."""
_HALVINGS = 24


class Wish(NamedTuple):
    """Which figure is wanted."""

    shape: str
    rotation: float = 0.0
    """From how it is drawn, or from the leader's heading [rad]."""
    scale: float = 1.0


class Way(NamedTuple):
    """The carrot's: straight from one point to the next."""

    times: tuple[float, ...]
    """When it is at each, rising [s of the mover's time]."""
    points: tuple[FloatArray, ...]

    def carrot(self, time: float) -> FloatArray:
        """Where the carrot is."""
        if time <= self.times[0]:
            return self.points[0]
        for k in range(1, len(self.times)):
            if time < self.times[k]:
                part = (time - self.times[k - 1]) / (self.times[k] - self.times[k - 1])
                return (1.0 - part) * self.points[k - 1] + part * self.points[k]
        return self.points[-1]

    def smooth(self, time: float) -> FloatArray:
        """Where the figure is: the carrot's mean over the last `SMOOTH`."""
        begin = time - SMOOTH
        if begin >= self.times[-1]:
            return self.points[-1]
        knots = [begin, *(t for t in self.times if begin < t < time), time]
        at = [self.carrot(t) for t in knots]
        whole = np.zeros_like(self.points[0])
        for (a, b), (before, after) in zip(pairwise(knots), pairwise(at), strict=True):
            whole += (b - a) * 0.5 * (before + after)
        return whole / SMOOTH

    def extended(self, time: float, point: FloatArray, lasts: float) -> Way:
        """From where the carrot is at `time` to `point` in `lasts` [s], and what the mean still needs."""
        first = max((k for k, t in enumerate(self.times) if t <= time - SMOOTH), default=0)
        kept = [k for k in range(first, len(self.times)) if self.times[k] < time]
        times = [*(self.times[k] for k in kept), time, time + lasts]
        return Way(tuple(times), (*(self.points[k] for k in kept), self.carrot(time), point))

    @property
    def end(self) -> float:
        """When the figure is there [s of the mover's time]."""
        return self.times[-1] + SMOOTH


class Mover:
    """The figure of a mission, and how it gets to where it is wanted."""

    def __init__(self, mission: Mission, figure: Figure, wish: Wish, speed: float = 0.0) -> None:
        """It goes on from `figure` to `wish`, beside a leader of this `speed` [m/s]."""
        self._mission = mission
        self._shapes = tuple(mission.shapes)
        self._drawn: ComplexArray = np.array(
            [[mission.slot(name, shape) for name in mission.followers] for shape in self._shapes]
        )
        self._top: FloatArray = np.array([mission.robots[name].max_speed for name in mission.followers])
        self.wish = wish
        """Which one is wanted."""
        self._turn = (
            figure.rotation - wish.rotation if mission.turning else 0.0
        )  # the leader's, as far as done
        self._turning = 0.0  # its rate [rad/s]
        shares = dict(figure.mix)
        q = np.array([shares.get(shape, 0.0) for shape in self._shapes] + [0.0, figure.scale])
        q[-2] = wish.rotation if mission.turning else figure.rotation
        self._time, self._pace = 0.0, 1.0
        self._way = Way((0.0,), (q,))
        target = self._target(wish)
        if not np.array_equal(target, q):
            self._way = self.way(wish, speed)

    @classmethod
    def first(cls, mission: Mission) -> Mover:
        """In the mission's first figure."""
        return cls(mission, Figure.first(mission), Wish(mission.first_shape))

    @property
    def arrived(self) -> bool:
        """Whether it is as it is wanted, but for the leader's heading."""
        return self._time >= self._way.end or len(self._way.times) == 1

    @property
    def remaining(self) -> float:
        """How long it takes at least until then [s]."""
        return 0.0 if self.arrived else self._way.end - self._time

    @property
    def figure(self) -> Figure:
        """Where the slots are."""
        return self._figure(self._now(self._time), self._turn)

    def way(self, wish: Wish, speed: float) -> Way:
        """How it would go to `wish` from where it is by a leader of this speed [m/s]."""
        begin, target = self._way.carrot(self._time), self._target(wish)
        lasts = self._lasts(begin, target, speed)
        return self._way.extended(self._time, target, lasts)

    def figures(self, way: Way) -> list[Figure]:
        """`SAMPLES` of them along a way, from where it is to its end."""
        times = np.linspace(self._time, way.end, SAMPLES)
        return [self._figure(way.smooth(float(time)), self._turn) for time in times]

    def ahead(self, heading: complex) -> list[Figure]:
        """What the figure goes through from now on if the leader looks along `heading` (unit) meanwhile."""
        figures = [self.figure] if self.arrived else self.figures(self._way)
        if not self._mission.turning:
            return figures
        left = cmath.phase(heading * cmath.rect(1.0, -self._turn))
        turns = [left * part / (TURNS - 1) for part in range(TURNS)]
        return [one._replace(rotation=one.rotation + turn) for one in figures for turn in turns]

    def sayable(self, way: Way) -> bool:
        """Whether an order can say what is mixed on it."""
        most = np.max([point[:-2] for point in way.points], axis=0)
        mixed = [shape for shape, share in zip(self._shapes, most, strict=True) if share > 0.0]
        return len(mixed) <= MOST_SHAPES and (len(mixed) <= 2 or len("".join(mixed)) <= LONGEST_MIX)

    def go(self, wish: Wish, way: Way) -> None:
        """From now on go this way, which `way` gave for this wish."""
        self.wish, self._way = wish, way

    def advance(self, dt: float, share: float, speed: float, heading: complex, turn_rate: float) -> None:
        """Let `dt` [s] go by, of which the mover may use a `share`.

        The leader is at most as fast as `speed` [m/s] meanwhile, and at the end of it looks along `heading`
        (unit) and turns at `turn_rate` [rad/s].
        """
        if dt <= 0.0:
            return
        pace = min(1.0, self._pace + dt / SMOOTH) if not self.arrived else 1.0
        room, before = self._room(speed), self._slots(self._now(self._time), self._turn)
        rate = self._turned(dt * share, heading, turn_rate, room, np.abs(before))

        def fits(part: float) -> bool:
            after = self._slots(
                self._now(self._time + part * pace * dt * share), self._turn + part * rate * dt * share
            )
            return bool(np.all(np.abs(after - before) <= room * dt))

        part = 1.0 if fits(1.0) else _largest(fits)
        self._pace = part * pace
        self._time += self._pace * dt * share
        self._turning = part * rate
        self._turn += self._turning * dt * share

    def rest(self) -> None:
        """Stand still from now on: what moves next begins gently."""
        self._pace, self._turning = 0.0, 0.0

    def _now(self, time: float) -> FloatArray:
        return self._way.points[0] if len(self._way.times) == 1 else self._way.smooth(time)

    def _turned(
        self, dt: float, heading: complex, turn_rate: float, room: FloatArray, reach: FloatArray
    ) -> float:
        """At which rate to turn after the leader's heading [rad/s]; `reach` is how far out the slots are."""
        if not self._mission.turning or dt <= 0.0:
            return 0.0
        most = float(np.min(room / np.maximum(reach, 1e-9), initial=MOST_TURN))
        sharp = most / SMOOTH  # [rad/s²]
        lag = cmath.phase(heading * cmath.rect(1.0, -self._turn - turn_rate * dt))
        wanted = turn_rate + min(max(_approach(lag, 0.7 * sharp), -abs(lag) / dt), abs(lag) / dt)
        wanted = min(max(wanted, -most), most)
        return self._turning + min(max(wanted - self._turning, -sharp * dt), sharp * dt)

    def _room(self, speed: float) -> FloatArray:
        """How fast each slot may move beside a leader of this speed [m/s]."""
        return np.asarray(np.maximum(SHARE * (self._top - speed), LEAST * self._top))

    def _lasts(self, begin: FloatArray, target: FloatArray, speed: float) -> float:
        """How long the carrot takes from one to the other [s]."""
        parts = np.linspace(0.0, 1.0, SAMPLES)
        slots = np.array([self._slots((1.0 - part) * begin + part * target, 0.0) for part in parts])
        fastest = np.max(np.abs(np.diff(slots, axis=0)), axis=0) * (SAMPLES - 1)
        return max(float(np.max(fastest / self._room(speed), initial=0.0)), 1e-3)

    def _target(self, wish: Wish) -> FloatArray:
        shares = [1.0 if shape == wish.shape else 0.0 for shape in self._shapes]
        before = float(self._way.carrot(self._time)[-2])
        shortest = math.remainder(wish.rotation - before, math.tau)
        return np.array([*shares, before + shortest, wish.scale])

    def _slots(self, q: FloatArray, turn: float) -> ComplexArray:
        """Of all followers, from the leader [m; world frame]."""
        return np.asarray(q[-1] * cmath.rect(1.0, float(q[-2]) + turn) * (q[:-2] @ self._drawn))

    def _figure(self, q: FloatArray, turn: float) -> Figure:
        mix = tuple((shape, float(share)) for shape, share in zip(self._shapes, q[:-2], strict=True) if share)
        return Figure(mix, math.remainder(float(q[-2]) + turn, math.tau), float(q[-1]))


def _approach(lag: float, sharp: float) -> float:
    """The rate to make up for a lag [rad] at, so that braking by `sharp` [rad/s²] ends it where it is 0."""
    near = sharp / GAIN**2
    if abs(lag) <= near:
        return GAIN * lag
    return math.copysign(math.sqrt(2.0 * sharp * (abs(lag) - near / 2.0)), lag)


def _largest(fits: Callable[[float], bool]) -> float:
    """About the largest part in [0, 1] that fits, where all below one that fits do."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low
