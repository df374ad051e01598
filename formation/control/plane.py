"""The plane as the complex numbers.

A planar vector is one complex number, a heading is a unit complex number ζ = e^{iθ}, rotating is
multiplying and the 90° matrix is `i`. Like all mathematics of this package these are functions of plain
numbers: an agent calls them directly, a simulation of a million robots compiles them
(`formation.simulation.compiled`).
"""

from __future__ import annotations

import math

MIN_LENGTH = 2.2250738585072014e-308
"""Smallest length with full floating-point precision."""


def rotation(angle: float) -> complex:
    """The rotation by `angle` [rad] as a unit complex number."""
    return complex(math.cos(angle), math.sin(angle))


def unit(vector: complex, otherwise: complex = 1.0 + 0.0j) -> complex:
    """`vector` at length one; `otherwise` if it is zero, or too short to be normalised."""
    length = abs(vector)
    return vector * (1.0 / length) if length > MIN_LENGTH else otherwise


def clip(value: float, limit: float) -> float:
    """`value` brought into [-limit, limit]; NaN stays NaN."""
    return max(min(value, limit), -limit)  # in this order, so that NaN is kept


def shorten(vector: complex, limit: float) -> complex:
    """`vector` with its length cut to `limit` (> 0), its direction kept."""
    length = abs(vector)
    return vector * (limit / length) if length > limit else vector


def angle_between(first: complex, second: complex) -> float:
    """The signed angle from `first` to `second` [rad], in (-π, π]."""
    turned = second * first.conjugate()
    return math.atan2(turned.imag, turned.real)
