"""A path that a planner sends again and again: the leader joins it where it is.

A planner such as Nav2's plans from where the robot is, about once a second. The leader is ahead of the robot,
and moves on until a path arrives. If it followed each path from its first point, it would turn back again.
"""

from __future__ import annotations

import cmath
import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate, dropwhile, pairwise, takewhile
from typing import NamedTuple

from formation.mission.route import Leg, Straight, Waypoints

JOINING_TIME = 1.0
"""Time from the point of a path that is nearest to the leader to where it joins, at the leg's speed [s]."""
BRANCH_TOLERANCE = 0.5
"""The leader joins the first part of a path that is less than this farther off than the nearest point [m]."""


class Joined(NamedTuple):
    """What is left of a path for the leader."""

    legs: tuple[Leg, ...]
    passed: float
    """Length of the path up to the point that is nearest to the leader [m]."""


def joined(legs: Sequence[Leg], place: complex, heading: complex, since: float = 0.0) -> Joined:
    """Return the route along `legs` for a leader at `place` [m; world frame] with unit `heading`.

    Waypoints of the first leg that the leader has passed are left out, as are the first `since` [m] of it. A
    straight first leg of speed 0 keeps the leader's heading.
    """
    first, passed = legs[0], 0.0
    if isinstance(first, Waypoints):
        points = [complex(x, y) for x, y in first.waypoints]
        lengths = tuple(accumulate((abs(b - a) for a, b in pairwise(points)), initial=0.0))
        passed = _nearest(points, lengths, place, since)
        left = _after(points, lengths, passed + first.speed * JOINING_TIME)
        first = first.model_copy(update={"waypoints": tuple((point.real, point.imag) for point in left)})
    elif isinstance(first, Straight) and first.speed == 0.0:
        first = first.model_copy(update={"heading_deg": math.degrees(cmath.phase(heading))})
    return Joined((first, *legs[1:]), passed)


def _nearest(points: Sequence[complex], lengths: Sequence[float], place: complex, since: float) -> float:
    """Return the length up to the nearest point to `place` on a path, not before `since` [m]."""
    found = []  # of each stretch, the distance of its nearest point and the length up to that [m]
    for (a, b), (begin, end) in zip(pairwise(points), pairwise(lengths), strict=True):
        if begin < end and since <= end:
            direction = (b - a) / (end - begin)
            part = min(max(((place - a) * direction.conjugate()).real, since - begin, 0.0), end - begin)
            found.append((abs(place - a - part * direction), begin + part))
    near = min(found, default=(0.0, 0.0))[0] + BRANCH_TOLERANCE
    branch = takewhile(lambda one: one[0] <= near, dropwhile(lambda one: one[0] > near, found))
    return min(branch, default=(0.0, 0.0))[1]


def _after(points: Sequence[complex], lengths: Sequence[float], length: float) -> Sequence[complex]:
    """Return the rest of a path from this length on [m]; beyond its end, the last point."""
    number = bisect_right(lengths, length)
    if number == len(points):
        return points[-1:]
    a, b = points[number - 1 : number + 1]
    part = (length - lengths[number - 1]) / (lengths[number] - lengths[number - 1])
    return [a + part * (b - a), *points[number:]]
