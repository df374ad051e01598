"""What is proven of a mission's closed loop, and the error that is left on curves.

Theorem 1 of docs/theory/convergence.md: while the leader drives straight, a formation of ideal robots comes
together from every start if the assumptions of `broken_assumptions` hold. Where they do not, only the linear
loop near formation is judged, by its poles.

On an arc the leader's velocity turns, and what neighbours' positions show of it is a little old.
`curve_errors` solves the sampled loop for that. With ideal bodies, T the control period, φ = z⁻¹ the
delay by a period, and s the share of a low pass:

| symbol | meaning |
|---|---|
| z = e^{iωT} | one step on an arc of turn rate ω |
| V = s (1 - φ)/T / (1 - (1 - s) φ) | velocity estimate of a neighbour |
| B = (z - 1)/(iω) | way in one step at a velocity of 1 that turns with the robot |
| f | share of the neighbours' mean velocity that is kept: it is cut to the leader's top speed |
| d | weighted mean of the neighbours' positions, less that with weights which are equal in all directions |
| G = B (k + f V)/(z - 1 + k B) | from the weighted mean of the neighbours to a robot, without d |
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from formation.control.arrays import ComplexArray, FloatArray
from formation.control.controller import Limits
from formation.control.laws.field import REVERSE_LEVERS, REVERSE_TURNS
from formation.control.plane import rotation
from formation.control.tracker import learned
from formation.control.trust import FULL_TRUST, mean, trust, weighted
from formation.mission.graph import cyclic_core
from formation.mission.model import Mission
from formation.mission.route import Circle, Route
from formation.stability import spectrum

MAX_PROVEN_STEP = 1.0
"""`spectrum.step_share` up to which a loop that is sampled counts as one in continuous time [–]: no step
overshoots, neither along the leader's direction nor across it."""
CIRCLES_ONLY = "the leader must drive straight: its route has circles only"
MAX_SUBSTITUTIONS, LEAST_CHANGE = 200, 1e-12
"""Number of substitutions on an arc, and the change of a place at which they end [–]."""
LEAST_SPEED = 1e-12
"""[m/s]"""


class Certificate(NamedTuple):
    """What is proven of a mission."""

    convergence: str
    """``every start`` (while the leader drives straight), ``near formation`` or ``none``."""
    broken: tuple[str, ...]
    """The assumptions of Theorem 1 that do not hold."""
    curve_errors: dict[str, float]
    """Error of each follower's worst edge on the worst of the leader's arcs [m]; empty without one."""

    def as_json(self) -> dict[str, Any]:
        """The same for JSON."""
        return {**self._asdict(), "broken": list(self.broken)}


def certificate(mission: Mission, *, stable: bool) -> Certificate:
    """Return what is proven of a mission; `stable`: its linear loop is, as it is sampled."""
    if not stable:
        return Certificate("none", ("the linear loop must be stable",), {})
    broken = tuple(broken_assumptions(mission))
    return Certificate("near formation" if broken else "every start", broken, curve_errors(mission))


def broken_assumptions(mission: Mission) -> Iterator[str]:
    """Yield the assumptions of Theorem 1 that do not hold, with the numbers."""
    law, graph = mission.law, mission.graph
    if not (law.controller.mean and law.feeds_forward):
        yield f"the law must be `field`, and feed velocities forward: it is `{law.kind}`"
        return
    if graph.unreachable:
        names = ", ".join(mission.names[one] for one in graph.unreachable)
        yield f"every follower must have a path to the leader: {names} has none"
    if core := cyclic_core(graph):
        yield f"no cycle: {', '.join(mission.names[one] for one in core)} measure each other"
    if all(isinstance(leg, Circle) for leg in mission.route):
        yield CIRCLES_ONLY
    yield from _too_weak(mission)
    yield from _too_slow(mission)


def _too_weak(mission: Mission) -> Iterator[str]:
    """Robots for which the leader is too fast, and those too slow where they reverse."""
    speed, gain = mission.leader_speed, mission.gains.k_p
    bodies = {name: mission.robots[name].limits for name in mission.followers}
    for name, limits in bodies.items():
        sideways = limits.offset * limits.max_turn_rate
        most = min(limits.max_speed, sideways)
        if speed >= most:
            which = "max_speed" if most == limits.max_speed else "L x max_turn_rate"
            yield f"the leader must be slower than {name}: {speed:g} m/s, {which} {most:g} m/s"
            break
    for name, limits in bodies.items():
        if (behind := least_reverse(limits)) * gain < limits.max_speed:
            yield (
                f"gain x the distance behind {name} from which it reverses must be at least its max_speed:"
                f" {gain:g} 1/s x {behind:.3g} m, {limits.max_speed:g} m/s"
            )
            break


def _too_slow(mission: Mission) -> Iterator[str]:
    """Control periods that are too long for continuous time."""
    gain = mission.gains.k_p
    period = 1.0 / min(mission.robots[name].rate for name in mission.followers)
    worst = max(mission.followers, key=lambda name: spectrum.step_share(mission, name, gain))
    if gain * period > 1.0:
        yield f"gain x control period must be at most 1: {gain:g} 1/s x {period:g} s"
    elif spectrum.step_share(mission, worst, gain) > MAX_PROVEN_STEP:
        spec = mission.robots[worst]
        yield (
            f"(gain + leader's speed / L) x control period must be at most {MAX_PROVEN_STEP:g}: {worst} has"
            f" ({gain:g} 1/s + {mission.leader_speed:g} m/s / {spec.control_point_offset:g} m)"
            f" x {1.0 / spec.rate:g} s"
        )


def least_reverse(limits: Limits) -> float:
    """Least distance behind a robot of a slot to which it reverses [m]."""
    return max(REVERSE_LEVERS * limits.offset, REVERSE_TURNS * limits.max_speed / limits.max_turn_rate)


def curve_errors(mission: Mission) -> dict[str, float]:
    """Error of each follower's worst edge on the worst of the leader's arcs [m], by name.

    Empty where the route has no arc, where the shape turns with the leader, and for laws that do not feed
    velocities forward. Ideal bodies, no noise, and all robots at the slowest one's rate.
    """
    if mission.turning or not (mission.law.controller.mean and mission.law.feeds_forward):
        return {}
    period = 1.0 / min(mission.robots[name].rate for name in mission.followers)
    worst: dict[str, float] = dict.fromkeys(mission.followers, 0.0)
    arcs = [arc for arc in Route.of(mission).arcs if arc.turn_rate and arc.speed]
    for arc in arcs:
        points = on_arc(mission, arc.turn_rate, period, arc.speed) * (arc.speed / arc.turn_rate)
        for index, name in enumerate(mission.followers, start=1):
            errors = [float(abs(points[j] - points[index])) for j in mission.graph.neighbours[index]]
            worst[name] = max(worst[name], *errors)
    return worst if arcs else {}


def on_arc(mission: Mission, turn_rate: float, period: float, speed: float) -> ComplexArray:
    """Where each robot is beside its slot's place, on a circle of radius 1 about the leader's centre [–].

    Shape (n,), the leader's 1 first; `turn_rate` [rad/s] and `speed` [m/s] of the leader, `period` [s] of
    control. Robots on larger circles are faster than the leader's top speed: they count less, and the mean
    of their velocities is cut. What counts, and d, are solved for by repeated substitution.
    """
    size, gain = mission.graph.size, mission.gains.k_p
    z = rotation(turn_rate * period)
    way = (z - 1.0) / (1j * turn_rate)
    share = learned(period, mission.law.velocity_filter)
    estimate = share * (1.0 - 1.0 / z) / period / (1.0 - (1.0 - share) / z)
    step = z - 1.0 + gain * way
    ordered = mission.law.uses_orders(signed=False)
    places = np.ones(size, np.complex128)
    for _ in range(MAX_SUBSTITUTIONS):
        velocities = estimate * places * (speed / turn_rate)
        counts, kept, skewed = _counts(mission, places, velocities, ordered=ordered)
        response = (way * (gain + kept * estimate) / step).astype(np.complex128)
        known = response * counts[:, 0] + way * gain / step * skewed
        known += 1j * turn_rate * way / step if ordered else 0j
        followers = np.linalg.solve(np.eye(size - 1) - response[:, None] * counts[:, 1:], known)
        before, places = places, np.concatenate([[1.0 + 0.0j], followers])
        if float(np.abs(places - before).max()) < LEAST_CHANGE:
            break
    return places


def _counts(
    mission: Mission,
    places: ComplexArray,
    velocities: ComplexArray,
    *,
    ordered: bool,
) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """What each robot counts for each follower, (n-1, n); the share f of each, and d, (n-1,).

    Robots are at `places` [–] on circles about the same centre and move at `velocities` [m/s]; `ordered`:
    all as orders say, and no velocity of a neighbour counts.
    """
    top, graph = mission.leader_speed, mission.graph
    counts, skewed = np.zeros((graph.size - 1, graph.size)), np.zeros(graph.size - 1, np.complex128)
    for i, neighbours in enumerate(graph.neighbours[1:]):
        total, weights, skew = 0j, 0.0, 0j
        for j in neighbours:
            most = mission.robots[mission.names[j]].top_speed
            one = FULL_TRUST if ordered else trust(complex(velocities[j]), top, most)
            counts[i, j] = one.weight
            total += weighted(one.weight, one.skew, complex(places[j]))
            weights, skew = weights + one.weight, skew + one.skew
        counts[i] /= weights
        skewed[i] = mean(weights, skew, total) - counts[i] @ places
    if ordered:
        return counts, np.zeros(graph.size - 1), skewed
    speeds = np.abs(counts @ velocities)
    return counts, np.minimum(1.0, top / np.maximum(speeds, LEAST_SPEED)), skewed


def worst_curve(found: Certificate) -> tuple[str, float] | None:
    """The follower that errs most on curves, and by how much [m]; None without curves."""
    if not found.curve_errors:
        return None
    name = max(found.curve_errors, key=lambda one: found.curve_errors[one])
    return name, found.curve_errors[name]
