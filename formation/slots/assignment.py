"""Assignment of robots to slots: least total distance, or least longest distance.

Exact, for costs c[i, k] >= 0 of robot i on place k. `least_total` is the Hungarian method by shortest
augmenting paths, O(n³), its inner loop over arrays. `least_longest` finds by bisection the least bound
under which there is a perfect matching, O(n³ log n), and of all within it the one with the least total.

Source: R. Burkard, M. Dell'Amico, S. Martello, Assignment Problems, SIAM 2009, sections 4.4 and 6.2.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation.control.arrays import FloatArray


class Aim(NamedTuple):
    """The quantity to minimise."""

    assign: Callable[[FloatArray], tuple[int, ...]]
    """The place of each robot; costs are of shape (n, n), and finite."""
    worth: Callable[[FloatArray, Sequence[int]], tuple[float, ...]]
    """Cost of an assignment; the less, the better."""


def least_total(costs: FloatArray) -> tuple[int, ...]:
    """The place of each robot with the least sum of costs; `costs` of shape (n, n), all finite."""
    n = len(costs)
    of_robot, of_place = np.zeros(n + 1), np.zeros(n + 1)  # potentials; place n stands for "none yet"
    taken_by = np.full(n + 1, -1)
    for robot in range(n):
        taken_by[n] = robot
        place, least = n, np.full(n, np.inf)
        came_from, seen = np.full(n, n), np.zeros(n + 1, dtype=bool)
        while taken_by[place] >= 0:
            seen[place] = True
            i = taken_by[place]
            reduced = costs[i] - of_robot[i] - of_place[:n]
            better = ~seen[:n] & (reduced < least)
            least[better], came_from[better] = reduced[better], place
            place = int(np.where(seen[:n], np.inf, least).argmin())
            step = least[place]
            of_robot[taken_by[seen]] += step
            of_place[seen] -= step
            least[~seen[:n]] -= step
        while place != n:
            before = int(came_from[place])
            taken_by[place] = taken_by[before]
            place = before
    places = np.empty(n, dtype=np.intp)
    places[taken_by[:n]] = np.arange(n)
    return tuple(places.tolist())


def least_longest(costs: FloatArray) -> tuple[int, ...]:
    """The place of each robot with the least largest cost and, of these, the least sum; `costs` as above."""
    bounds = np.unique(costs).tolist()  # under the greatest one every place is allowed
    enough = bisect_left(bounds, True, hi=len(bounds) - 1, key=lambda bound: _matched(costs <= bound))
    longest: float = bounds[enough]
    beyond = (len(costs) + 1.0) * (longest + 1.0)  # more than all allowed costs together
    return least_total(np.where(costs <= longest, costs, beyond))


def total(costs: FloatArray, places: Sequence[int]) -> tuple[float, ...]:
    """Sum of the costs of these places."""
    return (float(costs[range(len(costs)), places].sum()),)


def longest_then_total(costs: FloatArray, places: Sequence[int]) -> tuple[float, ...]:
    """Largest cost and sum of the costs of these places."""
    return (float(costs[range(len(costs)), places].max()), *total(costs, places))


AIMS = {"total": Aim(least_total, total), "longest": Aim(least_longest, longest_then_total)}
"""By name, the default first."""


def _matched(allowed: NDArray[np.bool_]) -> bool:
    """Whether each robot can have an allowed place of its own: by augmenting paths."""
    choices: list[list[int]] = [np.flatnonzero(row).tolist() for row in allowed]
    taken_by: dict[int, int] = {}

    def placed(robot: int, tried: set[int]) -> bool:
        """Give the robot a place, even if others have to move to another."""
        for place in sorted(choices[robot], key=taken_by.__contains__):  # free ones first
            if place not in tried:
                tried.add(place)
                if place not in taken_by or placed(taken_by[place], tried):
                    taken_by[place] = robot
                    return True
        return False

    return all(placed(robot, set()) for robot in range(len(choices)))
