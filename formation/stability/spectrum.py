"""Poles, delay margin and error amplification of a formation's linear loop.

Source: Eqs. (7), (10), (11) of the paper without saturation and with true headings, where every follower's
control point obeys dh = k_P e + k_I ξ, dξ = e, e = Σ_j (z_ij - z*_ij). Theorem 1 takes the eigenvalues μ of
L_ff for real; on a directed graph they need not be, and then its conclusion fails. `stable` is exact.

| symbol | here | meaning | unit |
|---|---|---|---|
| μ | `laplacian` | eigenvalues of L_ff | – |
| λ | `poles` | λ² + k_P μ λ + k_I μ = 0 | 1/s |
| τ | `time_constant` | of the velocity estimate that the field law feeds forward | s |
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from graphlib import TopologicalSorter

import numpy as np
from numpy.typing import NDArray

from formation.control.arrays import ComplexArray, FloatArray
from formation.control.tracker import learned
from formation.mission.graph import Graph, cyclic_core
from formation.mission.model import Mission
from formation.simulation.edges import Edges

LEAST_STEP = 1e-12
"""Poles of a step with a smaller modulus are gone at once [–]."""
MAX_STEP_SHARE = 2.0
"""`step_share` from which on a robot swings across the leader's direction [–]."""


def laplacian(graph: Graph, *, mean: bool = False) -> ComplexArray:
    """Eigenvalues μ of L_ff; shape (n-1,). Exact for robots outside `cyclic_core`.

    `mean`: of D⁻¹ L_ff, for a law that takes the mean of its neighbours' errors instead of their sum.
    """
    core, edges = np.array(cyclic_core(graph), dtype=np.intp), Edges(graph)
    apart = np.delete(edges.degrees, core - 1).astype(np.complex128)
    if mean:
        apart = np.ones_like(apart)
    if not len(core):
        return apart
    return np.concatenate([apart, np.linalg.eigvals(_among(edges, core - 1, mean=mean))])


def _among(edges: Edges, core: NDArray[np.intp], *, mean: bool) -> FloatArray:
    """The block of L_ff, or of D⁻¹ L_ff, for the followers of `core`."""
    among = edges.follower_laplacian()[np.ix_(core, core)]
    return among / edges.degrees[core][:, None] if mean else among


def poles(mu: ComplexArray, k_p: float, k_i: float) -> ComplexArray:
    """λ of the PI loop (7) [1/s]: two for each μ, or one where there is no integral."""
    if k_i == 0.0:
        return -k_p * mu
    root = np.sqrt((k_p * mu) ** 2 - 4.0 * k_i * mu)
    # the sign without cancellation, then Vieta for the other root
    root = np.where((k_p * mu * root.conjugate()).real < 0.0, -root, root)
    fast = -0.5 * (k_p * mu + root)
    return np.concatenate([fast, k_i * mu / fast])


def stable(mu: ComplexArray, k_p: float, k_i: float) -> bool:
    """Whether λ² + k_P μ λ + k_I μ is Hurwitz for every μ: Theorem 1 with complex μ; not in the paper."""
    exact = k_p**2 * mu.real * np.abs(mu) ** 2 > k_i * mu.imag**2
    return bool(np.all((mu.real > 0.0) & (exact | (mu.imag == 0.0))))  # a tiny k_P² is rounded to 0


def sampled_radius(mu: ComplexArray, k_p: float, k_i: float, period: float) -> float:
    """Largest |z| of the PI loop when each command holds for `period` [s]; from 1 on it does not settle."""
    return float(sampled_radii(mu, k_p, k_i, period).max())


def sampled_radii(mu: ComplexArray, k_p: float, k_i: float, period: float) -> FloatArray:
    """The same for each μ by itself.

    One mode is δ ← δ - T μ (k_P δ + k_I ξ), ξ ← ξ + T δ.
    """
    if k_i == 0.0:  # δ is independent of ξ
        return np.abs(1.0 - k_p * mu * period)
    trace = 2.0 - k_p * mu * period
    root = np.sqrt(trace**2 - 4.0 * (1.0 - k_p * mu * period + k_i * mu * period**2))
    radii: FloatArray = np.maximum(np.abs(trace + root), np.abs(trace - root)) / 2.0
    return radii


def step_share(mission: Mission, robot: str, k_p: float) -> float:
    """T (k + v/L) of a follower [–], by which it swings across the leader's direction, where it turns.

    T is its period, v the leader's top speed, k its gain: `k_p` for each neighbour of a law that takes sums.
    Exact outside of `cyclic_core` for laws without integral (Proposition 2 of docs/theory/convergence.md).
    """
    spec = mission.robots[robot]
    return (_gain(mission, robot, k_p) + mission.leader_speed / spec.control_point_offset) / spec.rate


def worst_step(mission: Mission, k_p: float) -> tuple[str, float]:
    """The follower with the greatest `step_share`, and that; 0 for laws with an integral."""
    shares = {name: step_share(mission, name, k_p) for name in _turning(mission)}
    worst = max(shares, key=lambda name: shares[name], default=mission.followers[0])
    return worst, shares.get(worst, 0.0)


def greatest_leader_speed(mission: Mission, k_p: float) -> tuple[str, float]:
    """The speed of the leader at which a first follower has `MAX_STEP_SHARE` [m/s], and that follower.

    Infinite for laws with an integral.
    """
    speeds = {}
    for name in _turning(mission):
        spec = mission.robots[name]
        reserve = MAX_STEP_SHARE * spec.rate - _gain(mission, name, k_p)
        speeds[name] = max(0.0, reserve * spec.control_point_offset)
    first = min(speeds, key=lambda name: speeds[name], default=mission.followers[0])
    return first, speeds.get(first, math.inf)


def _gain(mission: Mission, robot: str, k_p: float) -> float:
    return k_p * mission.law.controller.degree(len(mission.robots[robot].neighbours))


def _turning(mission: Mission) -> list[str]:
    """The followers of which `step_share` decides: the core of cycles is judged by `cyclic_poles`."""
    if mission.law.controller.integral:
        return []
    core = cyclic_core(mission.graph) if mission.law.feeds_forward else ()
    return [name for name in mission.followers if mission.names.index(name) not in core]


def feed_forward_poles(
    graph: Graph,
    k_p: float,
    k_i: float,
    time_constant: float,
    period: float,
    *,
    mean: bool = False,
    speed: float = 0.0,
    offsets: Sequence[float] = (),
) -> ComplexArray:
    """Poles [1/s] of the sampled loop with the neighbours' velocity fed forward, for the `cyclic_core`.

    Each command holds for `period` [s]; velocities are low-passed differences of positions. A pole z of the
    step is given as ln z / period: sampling alone can make a ring unstable. Outside of the core
    feed-forward closes no loop: there the poles are those of the PI loop, and of the low pass.

    With the leader's `speed` [m/s] and the `offsets` L of all followers [m], also the poles across its
    direction, where a robot turns: while a command holds, the robot drives on into the turn.
    """
    core, edges = np.array(cyclic_core(graph), dtype=np.intp) - 1, Edges(graph)
    among = _among(edges, core, mean=mean)
    averaged = np.eye(len(core)) - _among(edges, core, mean=True)  # velocities of the core's neighbours
    share = learned(period, time_constant)
    loops = [_step(among, averaged, k_p, k_i, share, period)]
    if speed > 0.0:
        levers = np.array(offsets)[core]
        loops.append(_step(among, averaged, k_p, k_i, share, period, speed, levers))
    steps = np.concatenate([np.linalg.eigvals(loop) for loop in loops]).astype(np.complex128)
    lasting = steps[np.abs(steps) > LEAST_STEP]
    values: ComplexArray = (np.log(lasting) / period).astype(np.complex128)
    return values


def cyclic_poles(mission: Mission, k_p: float, k_i: float) -> ComplexArray:
    """The same of a mission with these gains, at the greatest speed of its leader and the longest period."""
    return feed_forward_poles(
        mission.graph,
        k_p,
        k_i,
        mission.law.velocity_filter,
        1.0 / min(mission.robots[name].rate for name in mission.followers),
        mean=mission.law.controller.mean,
        speed=mission.leader_speed,
        offsets=[mission.robots[name].control_point_offset for name in mission.followers],
    )


def _step(
    among: FloatArray, averaged: FloatArray, k_p: float, k_i: float, share: float, period: float,
    speed: float = 0.0, offsets: FloatArray | None = None,
) -> FloatArray:  # fmt: skip
    """One step of positions, their velocity until now, its low pass before, integrals and headings.

    Without `offsets` [m] along the leader's direction, where headings play no part. Across it a robot that
    wants the velocity w turns at (w - uθ)/L, and its control point moves at w + uT/(2L) (w - uθ) on average.
    """
    count = len(among)
    zero, unit = np.zeros((count, count)), np.eye(count)
    low_passed = np.hstack([zero, share * unit, (1.0 - share) * unit, zero, zero])
    wanted = np.hstack([-k_p * among, zero, zero, k_i * unit, zero]) + averaged @ low_passed
    rates = np.zeros(count) if offsets is None else 1.0 / offsets
    turn = rates[:, None] * (wanted - np.hstack([zero, zero, zero, zero, speed * unit]))
    motion = wanted + 0.5 * period * speed * turn
    position = np.hstack([unit, zero, zero, zero, zero]) + period * motion
    integral = np.hstack([-period * among, zero, zero, unit, zero])
    heading = np.hstack([zero, zero, zero, zero, unit]) + period * turn
    loop = np.vstack([position, motion, low_passed, integral, heading])
    kept = np.repeat([True, True, True, k_i != 0.0, offsets is not None], count)
    step: FloatArray = loop[np.ix_(kept, kept)]
    return step


def delay_margin(mu: ComplexArray, k_p: float, k_i: float) -> float:
    """Greatest delay of the whole measurement before the PI loop oscillates [s]; 0 if it is unstable.

    λ² + (k_P λ + k_I) μ e^{-λτ} has a root iω where ω⁴ = |μ|² (k_P² ω² + k_I²), and there
    ωτ = arg μ + atan(k_P ω / k_I). The smallest over all μ counts.
    """
    if not stable(mu, k_p, k_i):
        return 0.0
    gain = np.abs(mu)
    omega = np.sqrt(0.5 * (gain**2 * k_p**2 + np.sqrt(gain**4 * k_p**4 + 4.0 * gain**2 * k_i**2)))
    phase = np.angle(mu) + np.arctan2(k_p * omega, k_i)
    return float((phase / omega).min())


def amplification(
    graph: Graph, k_p: float, k_i: float, time_constant: float | None, *, mean: bool = False
) -> FloatArray:
    """Peak over frequency of each follower's mean edge error per leader velocity [s]; shape (n-1,).

    `time_constant` [s] of the velocity that is fed forward, None for none. Only for a stable loop. In the
    frequency domain, with C = k_P + k_I/s and F = 1/(1 + τs) (or 0), a follower is δ_i away from its slot:
    (s + C d_i) δ_i = Σ_j (C + F s/d_i) δ_j + (F - 1) v.
    """
    scale = max(k_p, np.sqrt(k_i))
    s = 1j * scale * np.logspace(-4.0, 2.0, 601)
    control = k_p + k_i / s
    forward = np.zeros_like(s) if time_constant is None else 1.0 / (1.0 + time_constant * s)
    solve = _solve_cyclic if cyclic_core(graph) else _solve_acyclic
    away = solve(graph, s, control, forward, mean=mean)  # (frequencies, n), the leader's zero
    edges = Edges(graph)
    mean_errors = edges.sum_per_follower(edges.along_edges(away)) / edges.degrees
    peak: FloatArray = np.abs(mean_errors).max(axis=0)
    return peak


def _solve_acyclic(
    graph: Graph, s: ComplexArray, control: ComplexArray, forward: ComplexArray, *, mean: bool
) -> ComplexArray:
    away = np.zeros((len(s), graph.size), dtype=np.complex128)
    measured = {i: js for i, js in enumerate(graph.neighbours) if i}
    for i in TopologicalSorter(measured).static_order():  # each after all that it measures
        if i == 0:
            continue
        js, degree = list(graph.neighbours[i]), len(graph.neighbours[i])
        each = control / degree if mean else control
        seen = (each + forward * s / degree) * away[:, js].sum(axis=1)
        away[:, i] = (seen + forward - 1.0) / (s + each * degree)
    return away


def _solve_cyclic(
    graph: Graph, s: ComplexArray, control: ComplexArray, forward: ComplexArray, *, mean: bool
) -> ComplexArray:
    away = np.zeros((len(s), graph.size), dtype=np.complex128)
    edges, followers = Edges(graph), np.arange(graph.size - 1)
    among = _among(edges, followers, mean=mean)
    averaged = np.eye(graph.size - 1) - _among(edges, followers, mean=True)
    unit = np.eye(graph.size - 1)
    for k in range(len(s)):
        matrix = s[k] * (unit - forward[k] * averaged) + control[k] * among
        away[k, 1:] = np.linalg.solve(matrix, np.full(graph.size - 1, forward[k] - 1.0))
    return away
