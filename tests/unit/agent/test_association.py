"""Which segment is which neighbour (`formation.agent.perception.association`)."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping, Sequence

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from formation.agent.perception.association import (
    CLEAR_DIFFERENCE,
    MAX_SQUARED_DISTANCE,
    Candidate,
    Outcome,
    associate,
)
from formation.sensing.detection import Beams, Detection, Segment

RADIUS, COUNT = 0.1, 360
INCREMENT = math.tau / COUNT
DEVIATION = 0.02
"""Of all places [m]."""


def body(angle: float, distance: float, radius: float = RADIUS) -> Segment:
    """The segment of a cylinder [rad; m]."""
    middle, half = round(math.degrees(angle)) % COUNT, int(math.degrees(math.asin(radius / distance)))
    return Segment(middle - half, middle + half, 2 * half + 1, distance - math.pi / 4.0 * radius)


def wall(distance: float) -> Segment:
    """What surrounds the scanner at that distance [m]."""
    return Segment(0, COUNT - 1, COUNT, distance)


def expected(name: str, angle: float, distance: float) -> Candidate:
    """A robot that should be there [rad; m]."""
    return Candidate(name, distance, angle, RADIUS, DEVIATION)


def outcomes(segments: Sequence[Segment], *robots: Candidate) -> Mapping[str, Outcome]:
    """What the scan says of each robot."""
    scan = Beams(tuple(segments), 0.0, INCREMENT, COUNT, 3.5)
    by_name = {one.name: one for one in robots}

    def fit(name: str, seen: Detection) -> float:
        one = by_name[name]
        away = cmath.rect(seen.distance, seen.angle) - cmath.rect(one.distance, one.angle)
        return (abs(away) / DEVIATION) ** 2

    return {name: one.outcome for name, one in associate(scan, robots, fit).items()}


A, ELSEWHERE = expected("a", 0.5, 1.0), body(3.0, 1.0)


@pytest.mark.parametrize(
    ("segments", "outcome"),
    [
        pytest.param([body(0.5, 1.0)], Outcome.SEEN, id="at its place"),
        pytest.param([], Outcome.HIDDEN, id="nothing in sight"),
        pytest.param([ELSEWHERE], Outcome.MISSING, id="no beam from an empty place"),
        pytest.param([ELSEWHERE, body(0.5, 0.5)], Outcome.HIDDEN, id="body before it"),
        pytest.param([ELSEWHERE, body(0.3, 0.9)], Outcome.ABSENT, id="same body beside it and nearer"),
        pytest.param([ELSEWHERE, body(0.5, 1.0, 0.01)], Outcome.HIDDEN, id="pole at its place"),
        pytest.param([body(0.5, 0.5), wall(2.0)], Outcome.HIDDEN, id="body before it, wall behind"),
        pytest.param([wall(2.0)], Outcome.ABSENT, id="wall behind an empty place"),
        pytest.param([body(0.8, 1.0)], Outcome.ABSENT, id="same body beside an empty place"),
        pytest.param([body(0.5, 1.0, 0.16)], Outcome.UNCLEAR, id="wide post"),
        pytest.param(
            [body(0.5, 1.0)._replace(free=False), body(0.45, 1.3)], Outcome.UNCLEAR, id="partly hidden rival"
        ),
    ],
)
def test_outcome_for_one_robot(segments: Sequence[Segment], outcome: Outcome) -> None:
    assert outcomes(segments, A) == {"a": outcome}


def test_robot_outside_of_view_is_not_missing() -> None:
    scan, one = Beams((body(1.0, 1.0),), 0.0, INCREMENT, 180, 3.5), expected("a", 3.3, 1.0)
    assert associate(scan, [one], lambda *_: math.inf)["a"].outcome is Outcome.HIDDEN


def test_body_beside_is_another_known_robot() -> None:
    seen = outcomes([body(0.8, 1.0)], A, expected("b", 0.8, 1.0))
    assert seen == {"a": Outcome.HIDDEN, "b": Outcome.SEEN}


def test_far_robot_is_not_expected_to_be_seen() -> None:
    assert outcomes([wall(3.49)], expected("a", 0.5, 3.4)) == {"a": Outcome.HIDDEN}


@given(st.floats(0.6, 2.0), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_never_picks_one_of_two_that_fit(distance: float, one: float, other: float) -> None:
    """Neither of two cylinders near the place is chosen, unless it fits clearly better."""
    segments = [body(1.0 + one / distance, distance), body(1.0 + other / distance, distance + 0.05)]
    squares = sorted(
        (abs(cmath.rect(at, math.radians(s.middle)) - cmath.rect(distance, 1.0)) / DEVIATION) ** 2
        for s, at in zip(segments, (distance, distance + 0.05), strict=True)
    )
    assume(abs(squares[1] - squares[0] - CLEAR_DIFFERENCE) > 1e-6)
    (seen,) = outcomes(segments, expected("a", 1.0, distance)).values()
    clear = squares[0] <= MAX_SQUARED_DISTANCE and squares[1] >= squares[0] + CLEAR_DIFFERENCE
    assert (seen is Outcome.SEEN) == clear


@pytest.mark.parametrize("apart", [0.0, 0.02, 0.04])
def test_body_that_fits_two_robots_is_neither(apart: float) -> None:
    seen = outcomes([body(0.5, 1.0)], expected("a", 0.5 - apart, 1.0), expected("b", 0.5 + apart, 1.0))
    assert Outcome.SEEN not in seen.values()
