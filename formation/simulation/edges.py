"""The edges of a formation's graph as arrays: sums over neighbours, formation errors, the Laplacian.

For computations with many robots at once. Sums over neighbours are sparse; only eigenvalues need a matrix.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from formation.control.arrays import ComplexArray, FloatArray
from formation.mission.graph import Graph

Indices = NDArray[np.intp]


class Edges:
    """The edges of a graph, by follower."""

    def __init__(self, graph: Graph) -> None:
        self.size = graph.size
        """Number of robots n, the leader among them."""
        self.tails: Indices = np.repeat(np.arange(graph.size), [len(js) for js in graph.neighbours])
        """Robot i of each edge (i, j), ascending; shape (edges,)."""
        self.heads: Indices = np.array([j for js in graph.neighbours for j in js], dtype=np.intp)
        """Robot j of each edge (i, j), in the order of `tails`; shape (edges,)."""
        self.degrees: FloatArray = np.array([len(js) for js in graph.neighbours[1:]], dtype=np.float64)
        """Number of neighbours of each follower; shape (n-1,)."""

    def sum_per_follower(self, per_edge: NDArray[Any]) -> NDArray[Any]:
        """Σ_j over each follower's edges: shape (..., edges) -> (..., n-1). Each needs a neighbour."""
        first_edges = np.concatenate(([0], np.cumsum(self.degrees[:-1]))).astype(np.intp)
        sums: NDArray[Any] = np.add.reduceat(per_edge, first_edges, axis=-1)
        return sums

    def along_edges(self, per_robot: NDArray[Any]) -> NDArray[Any]:
        """Value at j less value at i, for each edge: shape (..., n) -> (..., edges)."""
        differences: NDArray[Any] = per_robot[..., self.heads] - per_robot[..., self.tails]
        return differences

    def laplacian(self) -> FloatArray:
        """The Laplacian, rows summing to zero; shape (n, n)."""
        matrix = np.zeros((self.size, self.size))
        np.subtract.at(matrix, (self.tails, self.heads), 1.0)
        np.fill_diagonal(matrix, -matrix.sum(axis=1))
        return matrix

    def follower_laplacian(self) -> FloatArray:
        """L_ff, the followers' block of the Laplacian; shape (n-1, n-1)."""
        return self.laplacian()[1:, 1:]


def edge_errors(edges: Edges, points: ComplexArray, slots: ComplexArray) -> FloatArray:
    """|z_ij - z*_ij| of each edge [m]; `points`, `slots` of shape (..., n) -> (..., edges)."""
    errors: FloatArray = np.abs(edges.along_edges(points) - edges.along_edges(slots))
    return errors


def formation_error(edges: Edges, points: ComplexArray, slots: ComplexArray) -> FloatArray:
    """Σ over edges of |z_ij - z*_ij| [m]: shape (..., n) -> (...). The paper's Fig. 2(d)."""
    total: FloatArray = edge_errors(edges, points, slots).sum(axis=-1)
    return total
