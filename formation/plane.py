"""The plane as the complex numbers.

A planar vector is one complex number, a heading is a unit complex number ζ = e^{iθ}, rotating is
multiplying and the 90° matrix is `i`. Every function takes one value or an array of values.
"""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

ComplexArray: TypeAlias = NDArray[np.complex128]
FloatArray: TypeAlias = NDArray[np.float64]

Vectors = TypeVar("Vectors", complex, ComplexArray)
"""One planar vector (complex) or an array of them; what goes in as one comes out as one."""

Reals: TypeAlias = Any
"""One float, or an array of floats that broadcasts with the vectors beside it."""

SHORTEST = float(np.finfo(np.float64).tiny)
"""The smallest length that numbers of full precision have."""


def rotation(angle: Reals) -> Any:
    """The rotation by `angle` [rad] as unit complex numbers."""
    return np.cos(angle) + 1j * np.sin(angle)  # several times faster than a complex exponential


def unit(vector: Vectors, otherwise: complex = 1.0 + 0.0j) -> Vectors:
    """`vector` at length one; `otherwise` where it is zero, or too short to be divided by its length."""
    length = abs(vector)
    if isinstance(length, float):
        return vector / length if length > SHORTEST else otherwise
    return np.where(length > SHORTEST, vector / np.where(length > SHORTEST, length, 1.0), otherwise)


def clip(value: Reals, limit: Reals) -> Any:
    """`value` brought into [-limit, limit]."""
    return np.minimum(np.maximum(value, -limit), limit)


def shorten(vector: Vectors, limit: Reals) -> Vectors:
    """`vector` with its length cut to `limit` (> 0), its direction kept."""
    shortened: Vectors = vector * (limit / np.maximum(abs(vector), limit))
    return shortened


def angle_between(first: Vectors, second: Vectors) -> Any:
    """The signed angle from `first` to `second` [rad], in (-π, π]."""
    return np.angle(second * first.conjugate())
