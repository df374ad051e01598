"""The measurement graph: rooted at the leader, shallow, and with short edges between slots.

Each robot measures only robots with fewer hops from the leader than itself, so the graph has no cycle: the
eigenvalues of L_ff are the numbers of neighbours, and k_P² Re(μ)|μ|² > k_I Im(μ)² holds for all gains.
With the fallbacks it has no cycle either.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple

from formation.mission.graph import Graph

MAX_HOPS = 4
"""Most hops of a robot from the leader."""
MAX_NEIGHBOURS = 2
"""Most neighbours of a robot: one is enough, a second replaces it if it is lost."""
EQUAL_DISTANCE_RATIO = 1.0 + 1e-6
"""Ratio below which distances are equal, however the slots were rounded."""


class Measured(NamedTuple):
    """The robots that each robot measures, by index; 0 is the leader, which measures none."""

    neighbours: tuple[tuple[int, ...], ...]
    fallbacks: tuple[tuple[int, ...], ...]
    """Robots that it measures while none of its neighbours can be followed."""

    @property
    def graph(self) -> Graph:
        """The graph of the neighbours."""
        return Graph(self.neighbours)


def measured(slots: Sequence[complex], deepest: int = MAX_HOPS) -> Measured:
    """The graph for these slots, the leader's own (0) first [m; from the leader].

    The reach is the least with which every robot is within `deepest` hops of the leader, from slot to
    slot. A robot that reaches the leader measures only the leader. The others measure the nearest robots
    with fewer hops from the leader, two if two are within reach, and otherwise one with another as a
    fallback. So any single follower may be lost, and the others continue.
    """
    reach, hops = _least_reach(slots, deepest)
    neighbours: list[tuple[int, ...]] = [()]
    fallbacks: list[tuple[int, ...]] = [()]
    for i in range(1, len(slots)):
        if hops[i] == 1:
            neighbours.append((0,))
            fallbacks.append(())
            continue
        nearest = sorted((j for j in range(len(slots)) if j != i), key=partial(_far, slots, reach, i))
        within = [
            j
            for j in nearest
            if hops[j] < hops[i] and abs(slots[j] - slots[i]) <= reach * EQUAL_DISTANCE_RATIO
        ][:MAX_NEIGHBOURS]
        neighbours.append(tuple(within))
        others = [j for j in nearest if (hops[j], j) < (hops[i], i) and j not in within]
        fallbacks.append(tuple(others[: MAX_NEIGHBOURS - len(within)]))
    return Measured(tuple(neighbours), tuple(fallbacks))


def _far(slots: Sequence[complex], reach: float, i: int, j: int) -> tuple[float, float, int]:
    """Sort key for j near i; among equally near ones the nearer to the leader, then the first listed.

    Distances are rounded to a ten-thousandth of the reach, so that ties are the same on every machine.
    """
    return round(abs(slots[j] - slots[i]) / reach, 4), round(abs(slots[j]) / reach, 4), j


def _least_reach(slots: Sequence[complex], deepest: int) -> tuple[float, list[int]]:
    """The least distance [m] that links all slots to the leader within `deepest` hops, and all their hops."""
    distances = sorted({abs(a - b) for i, a in enumerate(slots) for b in slots[:i]})
    distances = [now for now, after in pairwise([*distances, math.inf]) if after > now * EQUAL_DISTANCE_RATIO]
    # the longest links every robot with the leader directly
    enough = bisect_left(distances, True, key=lambda reach: max(_hops(slots, reach, deepest)) <= deepest)
    return distances[enough], _hops(slots, distances[enough], deepest)


def _hops(slots: Sequence[complex], reach: float, deepest: int) -> list[int]:
    """Hops of each slot from the leader, by steps of at most `reach` [m]; `deepest` + 1 if there are more."""
    hops, left, last = [0] + [deepest + 1] * (len(slots) - 1), set(range(1, len(slots))), [0]
    for count in range(1, deepest + 1):
        last = [
            j for j in left if any(abs(slots[j] - slots[i]) <= reach * EQUAL_DISTANCE_RATIO for i in last)
        ]
        left.difference_update(last)
        for j in last:
            hops[j] = count
    return hops
