"""Random graphs and gains on both sides of the boundary beyond which their loops are unstable."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from formation.control.arrays import ComplexArray
from formation.mission.model import Mission
from formation.protocol.order import Tuned
from formation.simulation.edges import Edges
from formation.stability import spectrum
from tests.unit.formation import scenarios

MARGIN = 0.01
"""Gains are drawn so near to the boundary."""


def drawn(random: np.random.Generator, rate: float = 20.0, **law: Any) -> Mission:
    """A random graph of 2 to 9 followers with a path to the leader for each, with cycles or without."""
    size = int(random.integers(3, 11))
    neighbours: list[list[int]] = [[]]
    for i in range(1, size):
        others = [j for j in range(size) if j != i and random.random() < 0.25]
        parent = int(random.integers(0, i))
        neighbours.append(sorted({parent, *others}))
    slots: ComplexArray = np.arange(size, dtype=np.complex128)
    return scenarios.build(slots, neighbours, law=law, robot={"rate": rate})


def held(mission: Mission, gains: Tuned, period: float) -> float:
    """Largest |z| of the whole sampled loop, from its matrix: what the eigenvalues μ must lead to as well."""
    laplacian = Edges(mission.graph).follower_laplacian()
    unit = np.eye(len(laplacian))
    loop = np.block(
        [[unit - period * gains.k_p * laplacian, -period * gains.k_i * laplacian], [period * unit, unit]]
    )
    return float(np.abs(np.linalg.eigvals(loop)).max())


def growth(mission: Mission, gains: Tuned) -> float:
    """Largest real part of the continuous loop's poles, from its matrix [1/s]."""
    laplacian = Edges(mission.graph).follower_laplacian()
    zero = np.zeros_like(laplacian)
    loop = np.block([[-gains.k_p * laplacian, -gains.k_i * laplacian], [np.eye(len(laplacian)), zero]])
    return float(np.linalg.eigvals(loop).real.max())


def most(mu: ComplexArray, k_p: float) -> float:
    """k_I up to which the continuous loop is stable; infinite for real eigenvalues."""
    with np.errstate(divide="ignore"):
        return float((k_p**2 * mu.real * np.abs(mu) ** 2 / mu.imag**2).min())


def turning(random: np.random.Generator) -> tuple[Mission, float, float]:
    """A mission of some graph with complex eigenvalues, a k_P, and the k_I at which it becomes unstable."""
    while True:
        mission = drawn(random, 200.0, kind="paper")
        k_p, mu = float(random.uniform(0.3, 3.0)), spectrum.laplacian(mission.graph)
        bound = most(mu, k_p)
        if bound < 5.0 and held(mission, Tuned(k_p=k_p, k_i=bound * 0.9), 1 / 200.0) < 1.0:
            return mission, k_p, bound


def unstable(draws: int) -> Iterator[tuple[Mission, Tuned]]:
    """Gains a little beyond the exact bound, by the poles of the loop's own matrix."""
    random = np.random.default_rng(7)
    for _ in range(draws):
        mission, k_p, bound = turning(random)
        gains = Tuned(k_p=k_p, k_i=bound * (1.0 + MARGIN))
        assert growth(mission, gains) > 0.0
        yield mission, gains


def stable(draws: int) -> Iterator[tuple[Mission, Tuned, bool]]:
    """Gains below the bound, and whether they are within a tenth of it: one of two is, or nearly."""
    random = np.random.default_rng(8)
    for number in range(draws):
        mission, k_p, bound = turning(random)
        share = 1.0 - MARGIN * float(random.uniform(1.0, 10.0)) if number % 2 else float(random.random())
        gains = Tuned(k_p=k_p, k_i=bound * share)
        if held(mission, gains, 1 / 200.0) >= 1.0:  # the sampled loop ends a little before
            gains = Tuned(k_p=k_p, k_i=bound * 0.5)
        assert growth(mission, gains) < 0.0
        assert held(mission, gains, 1 / 200.0) < 1.0
        yield mission, gains, gains.k_i > 0.9 * bound
