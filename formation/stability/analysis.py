"""Analysis of a mission before any robot moves: stability, settling time, and tolerated delay.

Pure. Poles are of the linear loop near formation (see `spectrum`), limits are checked in `feasibility`,
and the settling time comes from the closed loop itself, simulated once from the mission's own starts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from formation.control.arrays import ComplexArray
from formation.mission.graph import cyclic_core
from formation.mission.model import Mission
from formation.mission.route import Route
from formation.simulation.simulate import simulate
from formation.stability import crowding, feasibility, landmarks, spectrum
from formation.stability.certificate import Certificate, certificate
from formation.stability.losses import useless_fallbacks

MAX_AMPLIFICATION_RATIO = 2.0
"""Amplification of the last robots over that of the first beyond which there is a warning."""
MIN_DELAY_MARGIN_PERIODS = 3.0
"""Delay margin, in control periods, under which there is a warning."""


@dataclass(frozen=True, slots=True)
class Analysis:
    """Result of checking a mission. Mappings are by robot."""

    problems: tuple[str, ...]
    """Faults with which the mission cannot work."""
    warnings: tuple[str, ...]
    """Faults with which it will not work well."""
    eigenvalues: tuple[complex, ...]
    """Closed-loop poles of the PI loop (7) [1/s]."""
    stable: bool
    """Whether the linear loop of the law in use is stable."""
    slowest_mode: float
    """Largest real part of `eigenvalues` [1/s]."""
    settling_time_estimate: float | None
    """When the formation settles from the mission's own starts [s]; None if not within its horizon."""
    delay_margin: float
    """Greatest delay of the PI loop's whole measurement [s]; 0 if unstable."""
    depth: dict[str, int | None]
    """Hops to the leader; None if there is no path."""
    amplification: dict[str, float]
    """Peak over frequency of a robot's mean edge error per leader velocity [s]; infinite if unstable."""
    laplacian_eigenvalues: tuple[complex, ...]
    """μ of L_ff."""
    law: str
    certificate: Certificate
    """What is proven."""
    robots: int
    """Number of robots, the leader included."""
    edges: int
    unreachable: dict[str, str]
    """Robots without a path to the leader, and why."""

    @property
    def ok(self) -> bool:
        """Whether there is no problem."""
        return not self.problems

    def as_json(self) -> dict[str, Any]:
        """The results for JSON; None instead of NaN and infinity."""
        return {"ok": self.ok, **{one.name: _plain(getattr(self, one.name)) for one in fields(self)}}


def analyse(mission: Mission) -> Analysis:
    """Check a mission."""
    law, controller = mission.law.kind, mission.law.controller
    graph, gains = mission.graph, mission.gains
    mu, poles, faults, sampling = _linear_loop(mission)
    peaks = np.full(len(mission.followers), math.inf)
    if not faults:
        peaks = spectrum.amplification(graph, gains.k_p, gains.k_i, _forward(mission), mean=controller.mean)
    margin = spectrum.delay_margin(mu, gains.k_p, gains.k_i)
    settling, finite = _settling(mission)
    warnings = [*feasibility.warnings(mission), *useless_fallbacks(mission), *_shaky(mission, margin, peaks)]
    warnings += landmarks.warnings(mission)
    problems = [*faults, *sampling, *feasibility.problems(mission)]
    if controller.collision_filter:
        problems += crowding.problems(mission)
        warnings += [
            *crowding.could_meet(mission),
            *crowding.warnings(mission),
            *crowding.starts(mission),
            *crowding.rows(mission),
        ]
    else:
        warnings += crowding.unfiltered(mission)
    if not finite:
        problems.append(
            f"law.kind = {law!r}: simulated, it gives a command or an integral that is not finite"
        )
    elif settling is None:
        horizon = mission.simulation.horizon
        warnings.append(f"from its own starts the formation does not settle within {horizon:g} s ({law} law)")
    return Analysis(
        law=law,
        certificate=certificate(mission, stable=not faults and not sampling),
        robots=len(mission.names),
        edges=sum(map(len, graph.neighbours)),
        depth=dict(zip(mission.names, graph.depths, strict=True)),
        unreachable=feasibility.unreachable(graph, mission.names),
        laplacian_eigenvalues=tuple(mu.tolist()),
        eigenvalues=tuple(poles.tolist()),
        stable=not faults,
        slowest_mode=float(poles.real.max()),
        settling_time_estimate=settling,
        delay_margin=margin,
        amplification=dict(zip(mission.followers, peaks.tolist(), strict=True)),
        problems=tuple(problems),
        warnings=tuple(warnings),
    )


def certified(mission: Mission) -> Certificate:
    """What is proven of a mission, without the rest of its analysis."""
    loop = _linear_loop(mission)
    return certificate(mission, stable=not loop.faults and not loop.sampling)


class _LinearLoop(NamedTuple):
    """The loop near formation: eigenvalues of its graph, its poles [1/s], and what makes it unstable."""

    mu: ComplexArray
    poles: ComplexArray
    faults: list[str]
    sampling: list[str]


def _linear_loop(mission: Mission) -> _LinearLoop:
    mu = spectrum.laplacian(mission.graph, mean=mission.law.controller.mean)
    poles = spectrum.poles(mu, *mission.gains)
    faults = _instability(mission, mu, poles, _forward(mission))
    return _LinearLoop(mu, poles, faults, [] if faults else _sampling(mission, mu))


def _forward(mission: Mission) -> float | None:
    """Time constant with which the neighbours' velocities are fed forward [s]; None if they are not."""
    return mission.law.velocity_filter if mission.law.feeds_forward else None


def settling_time(mission: Mission) -> float | None:
    """Settling time from the mission's own starts, of `_settling` [s]; None if not within the horizon."""
    return _settling(mission)[0]


def _settling(mission: Mission) -> tuple[float | None, bool]:
    """Settling time from the mission's own starts [s], by the closed loop at the robots' period.

    It includes all that delays settling: the distance to a moving slot at top speed, headings that are not
    known yet, the integral accumulated meanwhile, and corners of the route. None if not within the
    horizon. With it, whether the formation error stayed finite.
    """
    period = 1.0 / min(mission.robots[name].rate for name in mission.followers)
    step = min(period, 0.2, mission.simulation.horizon)
    longest = mission.simulation.horizon
    route = Route.of(mission)
    # most missions settle long before the horizon; after the last corner nothing changes
    for horizon in (min(route.last_change + 30.0, longest), longest):
        result = simulate(mission, step=step, horizon=max(horizon, step), starts="mission")
        if result.converged[0]:
            return float(result.settling_time[0]), True
    return None, math.isfinite(result.final_error[0])


def _instability(mission: Mission, mu: ComplexArray, poles: ComplexArray, forward: float | None) -> list[str]:
    k_p, k_i = mission.gains
    cyclic = bool(cyclic_core(mission.graph))
    if not (forward is not None and cyclic) and not spectrum.stable(mu, k_p, k_i):
        # k_P² Re(μ)|μ|² / Im(μ)²
        turning = mu[np.abs(mu.imag) > 1e-12 * np.abs(mu)]
        bound = float((k_p**2 * turning.real * np.abs(turning) ** 2 / turning.imag**2).min())
        what = f"law.{_gain(mission)} = {k_p:g}, law.k_i = {k_i:g} on this graph"
        return [_unstable(what, poles, f"k_i must be below {bound:.3g} 1/s²")]
    if forward is not None and cyclic:
        loop = spectrum.cyclic_poles(mission, k_p, k_i)
        if loop.real.max() >= 0.0:
            what = (
                f"law.feed_forward with law.{_gain(mission)} = {k_p:g} and velocity_filter = {forward:g} s"
                f" on this graph, behind a leader at {mission.leader_speed:g} m/s"
            )
            return [_unstable(what, loop, "must be false, or the graph without the cycle")]
    return []


def _gain(mission: Mission) -> str:
    """The mission key of its law's proportional gain."""
    return "gain" if mission.law.controller.mean else "k_p"


def _unstable(what: str, poles: ComplexArray, legal: str) -> str:
    return f"unstable: {what}, slowest mode {poles.real.max():+.3g} 1/s; {legal}"


def _sampling(mission: Mission, mu: ComplexArray) -> list[str]:
    """Whether the robots' periods are short enough for the gains."""
    slowest = min(mission.followers, key=lambda name: mission.robots[name].rate)
    rate = mission.robots[slowest].rate
    k_p, k_i = mission.gains
    if mission.law.feeds_forward and cyclic_core(mission.graph):
        mu = mu[: len(mu) - len(cyclic_core(mission.graph))]  # the core is judged as it is fed forward
    radius = spectrum.sampled_radius(mu, k_p, k_i, 1.0 / rate) if len(mu) else 0.0
    if radius < 1.0:
        return _turning(mission)
    enough = (
        f"must be above {faster:.3g} Hz"
        for faster in rate * np.geomspace(1.01, 1e6, 2000)
        if spectrum.sampled_radius(mu, k_p, k_i, 1.0 / faster) < 1.0
    )
    most = max(map(len, mission.graph.neighbours))
    why = f"too low for law.{_gain(mission)} = {k_p:g} and up to {most} neighbours: commands overshoot"
    return [f"robots.{slowest}.rate = {rate:g} Hz: {why}; {next(enough, 'no rate is enough: lower law.k_i')}"]


def _turning(mission: Mission) -> list[str]:
    """Whether they are short enough for the robots' turns, behind the leader at its top speed."""
    worst, share = spectrum.worst_step(mission, mission.gains.k_p)
    if share < spectrum.MAX_STEP_SHARE:
        return []
    spec, gain = mission.robots[worst], mission.gains.k_p
    what = (
        f"law.{_gain(mission)} = {gain:g} and control_point_offset = {spec.control_point_offset:g} m behind a"
        f" leader at {mission.leader_speed:g} m/s"
    )
    enough = spec.rate * share / spectrum.MAX_STEP_SHARE
    why = f"too low for {what}: it turns too far between two commands"
    legal = f"must be above {enough:.3g} Hz, or the offset longer"
    return [f"robots.{worst}.rate = {spec.rate:g} Hz: {why}; {legal}"]


def _shaky(mission: Mission, margin: float, peaks: Any) -> list[str]:
    found = []
    rate = min(mission.robots[name].rate for name in mission.followers)
    if 0.0 < margin < MIN_DELAY_MARGIN_PERIODS / rate:
        found.append(
            f"the delay margin of {margin * 1e3:.0f} ms is less than"
            f" {MIN_DELAY_MARGIN_PERIODS:g} periods at {rate:g} Hz: "
            f"lower law.{_gain(mission)} or measure fewer neighbours"
        )
    first = min(
        peak for peak, depth in zip(peaks.tolist(), mission.graph.depths[1:], strict=True) if depth == 1
    )
    worst = int(np.argmax(peaks))
    if math.isfinite(first) and peaks[worst] > MAX_AMPLIFICATION_RATIO * first:
        last = f"{mission.followers[worst]}, {mission.graph.depths[1 + worst]} hops from the leader"
        times = f"{peaks[worst] / first:.1f} times as much as the first"
        found.append(
            f"errors grow along the graph: {last}, errs {times}; lower law.k_i, or make the graph shallower"
        )
    return found


def _plain(value: Any) -> Any:
    match value:
        case Certificate():
            return value.as_json()
        case dict():
            return {name: _plain(one) for name, one in value.items()}
        case tuple():
            return [_plain(one) for one in value]
        case complex():
            return [value.real, value.imag]
        case float():
            return value if math.isfinite(value) else None
    return value
