"""Who measures whom: the directed graph of a formation.

Source: section 2.2 and Assumption 1 of the paper. Robot 0 is the leader. An edge (i, j) means that robot i
measures robot j, so what the leader does travels against the edges. Sums over neighbours are sparse; only
what needs eigenvalues or Eq. (6) builds a matrix.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from formation.arrays import ComplexArray, FloatArray

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Graph:
    """Neighbour lists by robot index; `neighbours[0]`, the leader's, is empty."""

    neighbours: tuple[tuple[int, ...], ...]

    @property
    def size(self) -> int:
        """Number of robots n, the leader among them."""
        return len(self.neighbours)

    @cached_property
    def tails(self) -> Indices:
        """Robot i of each edge (i, j), ascending; shape (edges,)."""
        return np.repeat(np.arange(self.size), [len(js) for js in self.neighbours])

    @cached_property
    def heads(self) -> Indices:
        """Robot j of each edge (i, j), in the order of `tails`; shape (edges,)."""
        return np.array([j for js in self.neighbours for j in js], dtype=np.intp)

    @cached_property
    def degrees(self) -> FloatArray:
        """Number of neighbours of each follower; shape (n-1,)."""
        return np.array([len(js) for js in self.neighbours[1:]], dtype=np.float64)

    @cached_property
    def _first_edges(self) -> Indices:
        return np.concatenate(([0], np.cumsum(self.degrees[:-1]))).astype(np.intp)

    def sum_per_follower(self, per_edge: NDArray[Any]) -> NDArray[Any]:
        """Σ_j over each follower's edges: shape (..., edges) -> (..., n-1). Each needs a neighbour."""
        sums: NDArray[Any] = np.add.reduceat(per_edge, self._first_edges, axis=-1)
        return sums

    def along_edges(self, per_robot: NDArray[Any]) -> NDArray[Any]:
        """Value at j less value at i, for each edge: shape (..., n) -> (..., edges)."""
        differences: NDArray[Any] = per_robot[..., self.heads] - per_robot[..., self.tails]
        return differences

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

    def laplacian(self) -> FloatArray:
        """The Laplacian, rows summing to zero; shape (n, n)."""
        matrix = np.zeros((self.size, self.size))
        np.subtract.at(matrix, (self.tails, self.heads), 1.0)
        np.fill_diagonal(matrix, -matrix.sum(axis=1))
        return matrix

    def follower_laplacian(self) -> FloatArray:
        """L_ff, the followers' block of the Laplacian; shape (n-1, n-1)."""
        return self.laplacian()[1:, 1:]

    def desired_positions(self, leader: complex, slots: Sequence[complex] | ComplexArray) -> ComplexArray:
        """Followers' control points in formation [m; world frame], shape (n-1,): Eq. (6).

        `leader` is the leader's control point, `slots` the shape, the leader's own slot first; shape (n,).
        Raises numpy.linalg.LinAlgError where a follower has no path to the leader.
        """
        laplacian = self.laplacian()
        to_leader, among = laplacian[1:, :1], laplacian[1:, 1:]
        wanted = laplacian[1:, :] @ np.asarray(slots, dtype=np.complex128)
        held = wanted - to_leader[:, 0] * leader
        return np.linalg.solve(among.astype(np.complex128), held).astype(np.complex128)


def edge_errors(graph: Graph, points: ComplexArray, slots: ComplexArray) -> FloatArray:
    """|z_ij - z*_ij| of each edge [m]; `points`, `slots` of shape (..., n) -> (..., edges)."""
    errors: FloatArray = np.abs(graph.along_edges(points) - graph.along_edges(slots))
    return errors


def formation_error(graph: Graph, points: ComplexArray, slots: ComplexArray) -> FloatArray:
    """Σ over edges of |z_ij - z*_ij| [m]: shape (..., n) -> (...). The paper's Fig. 2(d)."""
    total: FloatArray = edge_errors(graph, points, slots).sum(axis=-1)
    return total
