"""Gains that are stable for a mission's graph, and so may be tuned by an operator while it drives.

The same conditions as of `formation check`, each with the eigenvalue that violates it and the gain that
would not:

| condition | for | |
|---|---|---|
| Hurwitz | every μ that no velocity is fed forward to | `k_P² Re(μ)|μ|² > k_I Im(μ)²` |
| sampled | the same, at the slowest follower's rate | `spectrum.sampled_radius` < 1 |
| turning | the others, at their own rates, for laws without integral | `spectrum.step_share` < 2 |
| fed forward | the cyclic core, if velocities are fed forward | `spectrum.cyclic_poles` left of 0 |

The first is a half-plane in (ln k_P, ln k_I) for each μ, so gains on a straight line from one stable point
to another in these coordinates are stable: this is how `formation.agent.following.gains` ramps them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from formation.control.arrays import ComplexArray
from formation.mission.graph import cyclic_core
from formation.mission.model import Mission
from formation.protocol.order import MAX_GAIN, MIN_GAIN, Tuned
from formation.stability import spectrum

GAIN_STEP_FACTOR = 1.3
"""Factor between the steps of the search for legal gains."""
HALVING_COUNT = 16
"""Number of halvings between a legal and an illegal gain that follow."""
MAX_CORE_SIZE = 32
"""Size of a cyclic core above which the search for legal gains omits the poles with velocities fed forward:
it takes long, and the leader does not lead meanwhile."""


class _Fault(NamedTuple):
    """The violation of a condition."""

    why: str
    what: str
    """The eigenvalue or pole, in words."""
    first: str
    """The gain to change first."""


_Condition = Callable[[Mission, ComplexArray, Tuned], _Fault | None]


def refusal(mission: Mission, wanted: Tuned, requested: tuple[str, ...] = ("k_p", "k_i")) -> str | None:
    """Why these gains are refused, with the eigenvalue and the legal range; None if they are legal.

    `requested`: the requested ones; if there is a choice, the range is of one of these.
    """
    for name, value in (("k_p", wanted.k_p), ("k_i", wanted.k_i)):
        without = name == "k_i" and value == 0.0
        if not (without or MIN_GAIN <= value <= MAX_GAIN):
            return f"{name} = {value:g}: must be from {MIN_GAIN:g} to {MAX_GAIN:g}"
    if not mission.law.controller.integral:
        wanted = wanted.model_copy(update={"k_i": 0.0})
    mu = spectrum.laplacian(mission.graph, mean=mission.law.controller.mean)
    if mission.law.feeds_forward:  # the cyclic core is judged as it is fed forward
        mu = mu[: len(mu) - len(cyclic_core(mission.graph))]
    cheap: tuple[_Condition, ...] = (_hurwitz, _sampled, _turning)
    looked_at = cheap if len(cyclic_core(mission.graph)) > MAX_CORE_SIZE else (*cheap, _fed_forward)

    def legal(gains: Tuned) -> bool:
        return not any(condition(mission, mu, gains) for condition in looked_at)

    for condition in (*cheap, _fed_forward):
        fault = condition(mission, mu, wanted)
        if fault is not None and condition in looked_at:
            return _explained(legal, fault, wanted, requested)
        if fault is not None:
            return f"{wanted.words}: {fault.why}, {fault.what}; other gains are needed"
    return None


def _hurwitz(_mission: Mission, mu: ComplexArray, gains: Tuned) -> _Fault | None:
    if spectrum.stable(mu, gains.k_p, gains.k_i):
        return None
    room = gains.k_p**2 * mu.real * np.abs(mu) ** 2 - gains.k_i * mu.imag**2
    worst = complex(mu[np.argmin(room / np.abs(mu) ** 3)])
    return _Fault("unstable", f"eigenvalue {spelled(worst)}", "k_i")


def _sampled(mission: Mission, mu: ComplexArray, gains: Tuned) -> _Fault | None:
    slowest = min(mission.followers, key=lambda name: mission.robots[name].rate)
    rate = mission.robots[slowest].rate
    radii = spectrum.sampled_radii(mu, gains.k_p, gains.k_i, 1.0 / rate)
    if not len(mu) or radii.max() < 1.0:
        return None
    worst = complex(mu[np.argmax(radii)])
    first = "k_i" if gains.k_i / rate >= gains.k_p else "k_p"
    return _Fault(f"overshoots at {slowest}'s {rate:g} Hz", f"eigenvalue {spelled(worst)}", first)


def _turning(mission: Mission, _mu: ComplexArray, gains: Tuned) -> _Fault | None:
    name, share = spectrum.worst_step(mission, gains.k_p)
    if share < spectrum.MAX_STEP_SHARE:
        return None
    what = f"period x (gain + leader's speed / L) = {share:.3g}"
    return _Fault(f"turns too far at {name}'s {mission.robots[name].rate:g} Hz", what, "k_p")


def _fed_forward(mission: Mission, _mu: ComplexArray, gains: Tuned) -> _Fault | None:
    law = mission.law
    if not law.feeds_forward or not cyclic_core(mission.graph):
        return None
    poles = spectrum.cyclic_poles(mission, gains.k_p, gains.k_i)
    if poles.real.max() < 0.0:
        return None
    worst = complex(poles[np.argmax(poles.real)])
    return _Fault("unstable with law.feed_forward", f"pole {spelled(worst)} 1/s", "k_i")


def _explained(
    legal: Callable[[Tuned], bool], fault: _Fault, wanted: Tuned, requested: tuple[str, ...]
) -> str:
    """``k_i = 30: unstable, eigenvalue 0.5+0.87i needs k_i < 11.9 at k_p = 2``."""
    for name in sorted(requested, key=lambda name: name != fault.first):
        other = "k_p" if name == "k_i" else "k_i"
        bound = _nearest(legal, wanted, name)
        if bound is not None:
            needs = f"needs {name} {bound} at {other} = {getattr(wanted, other):g}"
            return f"{name} = {getattr(wanted, name):g}: {fault.why}, {fault.what} {needs}"
    return f"{wanted.words}: {fault.why}, {fault.what}; no {' or '.join(requested)} will do without the other"


def _nearest(legal: Callable[[Tuned], bool], wanted: Tuned, name: str) -> str | None:
    """The nearest bound of legal values of one gain, as ``< 11.9``; None if no value is legal."""
    value = getattr(wanted, name)
    if value == 0.0:
        return None

    def fits(other: float) -> bool:
        return legal(wanted.model_copy(update={name: other}))

    steps = math.ceil(math.log(MAX_GAIN / MIN_GAIN, GAIN_STEP_FACTOR))
    for step in range(1, steps + 1):
        for sign, ends in ((-1, value > MIN_GAIN), (1, value < MAX_GAIN)):
            tried = min(max(value * GAIN_STEP_FACTOR ** (sign * step), MIN_GAIN), MAX_GAIN)
            if ends and fits(tried):
                return ("< " if sign < 0 else "> ") + _inside(_edge(fits, tried, value), sign)
    return None


def _edge(fits: Callable[[float], bool], legal: float, illegal: float) -> float:
    """Last legal value between the two."""
    for _ in range(HALVING_COUNT):
        middle = math.sqrt(legal * illegal)
        legal, illegal = (middle, illegal) if fits(middle) else (legal, middle)
    return legal


def _inside(edge: float, sign: int) -> str:
    """Three digits, rounded towards the legal side."""
    unit = 10.0 ** (math.floor(math.log10(edge)) - 2)
    rounded = (math.floor if sign < 0 else math.ceil)(edge / unit) * unit
    return f"{rounded:.3g}"


def spelled(value: complex) -> str:
    """``0.5+0.87i``; one of a pair of conjugates stands for both."""
    imaginary = abs(value.imag)
    return f"{value.real:.2g}" + (f"+{imaginary:.2g}i" if imaginary > 1e-9 * abs(value) else "")
