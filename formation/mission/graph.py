"""The directed graph of a formation: which robot measures which.

Source: section 2.2 and Assumption 1 of the paper. Robot 0 is the leader. An edge (i, j) means that robot i
measures robot j, so what the leader does travels against the edges. For sums and matrices over many robots
at once there is `formation.simulation.edges`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import cached_property


@dataclass(frozen=True)
class Graph:
    """Neighbour lists by robot index; `neighbours[0]`, the leader's, is empty."""

    neighbours: tuple[tuple[int, ...], ...]

    @property
    def size(self) -> int:
        """Number of robots n, the leader among them."""
        return len(self.neighbours)

    @cached_property
    def depths(self) -> tuple[int | None, ...]:
        """Hops from each robot to the leader; None where no path leads there."""
        measured_by: list[list[int]] = [[] for _ in range(self.size)]
        for i, js in enumerate(self.neighbours):
            for j in js:
                measured_by[j].append(i)
        depth: list[int | None] = [0] + [None] * (self.size - 1)
        waiting: deque[tuple[int, int]] = deque([(0, 0)])
        while waiting:
            j, hops = waiting.popleft()
            for i in measured_by[j]:
                if depth[i] is None:
                    depth[i] = hops + 1
                    waiting.append((i, hops + 1))
        return tuple(depth)

    @property
    def unreachable(self) -> tuple[int, ...]:
        """Robots without a path to the leader; empty exactly where Assumption 1 holds."""
        return tuple(i for i, depth in enumerate(self.depths) if depth is None)


def cyclic_core(graph: Graph) -> tuple[int, ...]:
    """Followers on a cycle of the graph, or between two; empty for an acyclic graph.

    The rest can be ordered so that L_ff, the followers' block of the Laplacian, is triangular: each of them
    adds its own degree to the eigenvalues.
    """
    measures = [set(js) - {0} for js in graph.neighbours]
    measured_by: list[set[int]] = [set() for _ in graph.neighbours]
    for i, js in enumerate(measures):
        for j in js:
            measured_by[j].add(i)
    left = set(range(1, graph.size))
    for ahead, behind in ((measures, measured_by), (measured_by, measures)):
        waiting = deque(i for i in left if not ahead[i])
        while waiting:
            gone = waiting.popleft()
            left.discard(gone)
            for i in behind[gone]:
                ahead[i].discard(gone)
                if not ahead[i] and i in left:
                    waiting.append(i)
            behind[gone] = set()
    return tuple(sorted(left))
