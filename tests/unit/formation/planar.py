"""Strategies of hypothesis for vectors, angles, headings, lengths and gains."""

from __future__ import annotations

import cmath

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

coordinates = st.floats(-10.0, 10.0)
vectors = st.builds(complex, coordinates, coordinates)
angles = st.floats(-6.0, 6.0)
headings = angles.map(lambda angle: cmath.rect(1.0, angle))
lengths = st.floats(0.01, 5.0)
gains = st.floats(0.05, 5.0)


def pair(vector: complex) -> NDArray[np.float64]:
    """Return the vector as an array in R²."""
    return np.array([vector.real, vector.imag])
