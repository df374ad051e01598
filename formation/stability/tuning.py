"""Which gains a mission's graph bears while it drives: what an operator may tune, and what not.

The same conditions as of `formation check`, each with the eigenvalue that breaks it and the gain that would
not:

| condition | for | |
|---|---|---|
| Hurwitz | every μ of L_ff | `k_P² Re(μ)|μ|² > k_I Im(μ)²` |
| sampled | every μ, at the slowest follower's rate | `spectrum.sampled_radius` < 1 |
| fed forward | the cyclic core, if velocities are fed forward | `spectrum.feed_forward_poles` left of 0 |

The first is a half-plane in (ln k_P, ln k_I) for each μ, so gains that go straight from one stable point to
another in these coordinates are stable all the way: so `agent.tuning` ramps them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from formation.arrays import ComplexArray
from formation.graph import cyclic_core
from formation.mission import Mission
from formation.order import LEAST_GAIN, MOST_GAIN, Tuned
from formation.stability import spectrum

STEP = 1.3
"""Legal gains are looked for by so large a factor, …"""
HALVINGS = 16
"""… and then by so many halvings between one that is legal and one that is not."""
LARGEST = 32
"""For a cyclic core of more robots poles with velocities fed forward are not looked for so often: meanwhile
the leader leads nobody."""


class _Fault(NamedTuple):
    """What breaks a condition."""

    why: str
    what: str
    """The eigenvalue or pole, as it is said."""
    first: str
    """The gain that is rather to be another."""


_Condition = Callable[[Mission, ComplexArray, Tuned], _Fault | None]


def refusal(mission: Mission, wanted: Tuned, asked: tuple[str, ...] = ("k_p", "k_i")) -> str | None:
    """Why these gains would not do, with the eigenvalue and the legal range; None if they would.

    `asked`: which of them were asked for; if there is a choice, the range is of one of these.
    """
    for name, value in (("k_p", wanted.k_p), ("k_i", wanted.k_i)):
        without = name == "k_i" and value == 0.0
        if not (without or LEAST_GAIN <= value <= MOST_GAIN):
            return f"{name} = {value:g}: must be from {LEAST_GAIN:g} to {MOST_GAIN:g}"
    mu = spectrum.laplacian(mission.graph)
    cheap: tuple[_Condition, ...] = (_hurwitz, _sampled)
    looked_at = cheap if len(cyclic_core(mission.graph)) > LARGEST else (*cheap, _fed_forward)

    def legal(gains: Tuned) -> bool:
        return not any(condition(mission, mu, gains) for condition in looked_at)

    for condition in (*cheap, _fed_forward):
        fault = condition(mission, mu, wanted)
        if fault is not None and condition in looked_at:
            return _said(legal, fault, wanted, asked)
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
    if radii.max() < 1.0:
        return None
    worst = complex(mu[np.argmax(radii)])
    first = "k_i" if gains.k_i / rate >= gains.k_p else "k_p"
    return _Fault(f"overshoots at {slowest}'s {rate:g} Hz", f"eigenvalue {spelled(worst)}", first)


def _fed_forward(mission: Mission, _mu: ComplexArray, gains: Tuned) -> _Fault | None:
    law = mission.law
    if law.kind != "field" or not law.feed_forward or not cyclic_core(mission.graph):
        return None
    poles = spectrum.feed_forward_poles(mission.graph, gains.k_p, gains.k_i, law.velocity_filter)
    if poles.real.max() < 0.0:
        return None
    worst = complex(poles[np.argmax(poles.real)])
    return _Fault("unstable with law.feed_forward", f"pole {spelled(worst)} 1/s", "k_i")


def _said(legal: Callable[[Tuned], bool], fault: _Fault, wanted: Tuned, asked: tuple[str, ...]) -> str:
    """``k_i = 30: unstable, eigenvalue 0.5+0.87i needs k_i < 11.9 at k_p = 2``."""
    for name in sorted(asked, key=lambda name: name != fault.first):
        other = "k_p" if name == "k_i" else "k_i"
        bound = _nearest(legal, wanted, name)
        if bound is not None:
            needs = f"needs {name} {bound} at {other} = {getattr(wanted, other):g}"
            return f"{name} = {getattr(wanted, name):g}: {fault.why}, {fault.what} {needs}"
    return f"{wanted.words}: {fault.why}, {fault.what}; no {' or '.join(asked)} will do without the other"


def _nearest(legal: Callable[[Tuned], bool], wanted: Tuned, name: str) -> str | None:
    """The nearest bound of legal values of one gain, as ``< 11.9``; None if no value is legal."""
    value = getattr(wanted, name)
    if value == 0.0:
        return None

    def fits(other: float) -> bool:
        return legal(wanted.model_copy(update={name: other}))

    steps = math.ceil(math.log(MOST_GAIN / LEAST_GAIN, STEP))
    for step in range(1, steps + 1):
        for sign, ends in ((-1, value > LEAST_GAIN), (1, value < MOST_GAIN)):
            tried = min(max(value * STEP ** (sign * step), LEAST_GAIN), MOST_GAIN)
            if ends and fits(tried):
                return ("< " if sign < 0 else "> ") + _inside(_edge(fits, tried, value), sign)
    return None


def _edge(fits: Callable[[float], bool], legal: float, illegal: float) -> float:
    """Where legal values end between the two; itself legal."""
    for _ in range(HALVINGS):
        middle = math.sqrt(legal * illegal)
        legal, illegal = (middle, illegal) if fits(middle) else (legal, middle)
    return legal


def _inside(edge: float, sign: int) -> str:
    """Three figures, rounded to the legal side."""
    unit = 10.0 ** (math.floor(math.log10(edge)) - 2)
    rounded = (math.floor if sign < 0 else math.ceil)(edge / unit) * unit
    return f"{rounded:.3g}"


def spelled(value: complex) -> str:
    """``0.5+0.87i``; one of a pair of conjugates stands for both."""
    imaginary = abs(value.imag)
    return f"{value.real:.2g}" + (f"+{imaginary:.2g}i" if imaginary > 1e-9 * abs(value) else "")
