"""What followers hear of their neighbours in a simulation: samples late, lost, or measured on the spot.

Shapes: R runs, N robots (leader first), E edges of the graph. Freshness and ages follow the agent's rules: a
neighbour is followed while its newest sample arrived within the limit, a sample is carried forward by its age
if it was on the way for a believable time, and after a long silence the velocity is learned anew.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation.edges import Edges
from formation.neighbour import FORGOTTEN, Track, first_seen, seen
from formation.plane import ComplexArray, FloatArray

Mask = NDArray[np.bool_]


class Terms(NamedTuple):
    """How well the links work."""

    step: float
    """Time between samples [s]."""
    delay: int
    """Age of a sample when it is used, in steps."""
    loss: float
    """Share of samples that never arrive."""
    limit: FloatArray
    """Longest silence of a fresh neighbour, and oldest believable age [s]; shape (E,)."""
    top_speed: FloatArray
    """Fastest a neighbour's control point can be [m/s]; shape (E,)."""
    time_constant: float | None
    """Low pass of the velocity estimate [s]; None where nobody needs velocities."""
    carry: bool
    """Whether samples are carried forward to the present."""
    local: Mask
    """Edges measured by a sensor on the robot, neither late nor lost; shape (E,)."""


class Heard(NamedTuple):
    """What followers know of their neighbours now."""

    point: ComplexArray
    """Control point of the edge's neighbour [m; world frame]; shape (R, E)."""
    velocity: ComplexArray
    """Its estimated velocity [m/s; world frame]; shape (R, E)."""
    fresh: Mask | None
    """Whether the neighbour may be followed, shape (R, E); None where all may."""


class Links:
    """Every edge's link, and the newest sample that came over it."""

    def __init__(self, edges: Edges, terms: Terms, rng: np.random.Generator) -> None:
        self._heads = edges.heads
        self._terms = terms
        self._rng = rng
        self._sent: deque[ComplexArray] = deque(maxlen=terms.delay + 1)
        self._late = np.where(terms.local, 0.0, terms.delay * terms.step)
        self._track: Track | None = None

    def hear(self, now: float, sent: ComplexArray, sensed: ComplexArray | None) -> Heard:
        """One step of every link.

        `sent` (R, N) is what all robots publish now; before the first step they stood where they start.
        `sensed` (R, E) is where sensors see the neighbours of local edges, None where there is no sensor.
        """
        while len(self._sent) < self._terms.delay:
            self._sent.append(sent)
        self._sent.append(sent)
        sample = np.take(self._sent[0], self._heads, axis=-1)
        if sensed is not None:
            sample = np.where(self._terms.local, sensed, sample)
        track = self._track = self._admit(now - self._late, sample)
        return self._now(now, track)

    def _admit(self, stamp: FloatArray, sample: ComplexArray) -> Track:
        terms, last = self._terms, self._track
        if last is None:
            return first_seen(stamp, sample)
        if terms.time_constant is None:
            newest = Track(stamp, sample, last.velocity)
        else:
            newest = seen(last, stamp, sample, terms.time_constant, terms.top_speed)
        if terms.loss <= 0.0:
            return newest
        velocity = np.where(stamp - last.stamp > FORGOTTEN, 0.0, newest.velocity)
        arrived = terms.local | (self._rng.random(sample.shape) >= terms.loss)
        return Track(
            np.where(arrived, stamp, last.stamp),
            np.where(arrived, sample, last.point),
            np.where(arrived, velocity, last.velocity),
        )

    def _now(self, now: float, track: Track) -> Heard:
        terms = self._terms
        if terms.delay == 0 and terms.loss <= 0.0:
            return Heard(track.point, track.velocity, None)
        age = now - track.stamp
        silence = age - self._late
        point = track.point
        if terms.carry:
            believed = np.where(self._late <= terms.limit + 1e-9, age, silence)
            point = point + track.velocity * believed
        return Heard(point, track.velocity, None if terms.loss <= 0.0 else silence <= terms.limit + 1e-9)
