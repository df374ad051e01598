from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.plane import angle_between, clip, rotation, shorten, unit
from formation.simulation.compiled import compiled
from tests.unit.formation.planar import angles, lengths, vectors


@given(angles, angles)
def test_rotations_add_up(first: float, second: float) -> None:
    assert rotation(first) * rotation(second) == pytest.approx(rotation(first + second), abs=1e-12)


@given(angles, vectors)
def test_a_rotation_keeps_lengths(angle: float, vector: complex) -> None:
    assert abs(rotation(angle) * vector) == pytest.approx(abs(vector), abs=1e-12)


def test_the_quarter_turn_is_i() -> None:
    assert rotation(math.pi / 2.0) == pytest.approx(1j)


@given(vectors.filter(lambda vector: abs(vector) > 1e-6))
def test_a_unit_vector_has_length_one_and_the_same_direction(vector: complex) -> None:
    assert abs(unit(vector)) == pytest.approx(1.0)
    assert (unit(vector) * vector.conjugate()).real == pytest.approx(abs(vector))


def test_a_vector_without_direction_becomes_the_one_asked_for() -> None:
    assert unit(0j) == 1.0
    assert unit(0j, 1j) == 1j


def test_what_is_no_number_is_not_clipped_to_one() -> None:
    assert math.isnan(clip(math.nan, 0.2))
    assert math.isnan(compiled(clip)(math.nan, 0.2))


@given(st.floats(-10.0, 10.0), lengths)
def test_what_is_clipped_lies_within_the_limit(value: float, limit: float) -> None:
    clipped = clip(value, limit)
    assert -limit <= clipped <= limit
    assert clipped == value or abs(value) > limit


@given(vectors, lengths)
def test_what_is_shortened_keeps_its_direction(vector: complex, limit: float) -> None:
    shortened = shorten(vector, limit)
    assert abs(shortened) == pytest.approx(min(abs(vector), limit))
    assert (shortened * vector.conjugate()).imag == pytest.approx(0.0, abs=1e-9)


@given(angles, st.floats(-3.1, 3.1), lengths)
def test_angle_between_vectors_rotates_one_onto_other(angle: float, turn: float, length: float) -> None:
    first = complex(length * rotation(angle))
    assert angle_between(first, complex(first * rotation(turn))) == pytest.approx(turn, abs=1e-9)
