"""Association of scan segments with neighbours (`formation.agent.perception.association`)."""

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
"""Standard deviation of all expected positions [m]."""


def body(angle: float, distance: float, radius: float = RADIUS) -> Segment:
    """The segment of a cylinder [rad; m]."""
    middle, half = round(math.degrees(angle)) % COUNT, int(math.degrees(math.asin(radius / distance)))
    return Segment(middle - half, middle + half, 2 * half + 1, distance - math.pi / 4.0 * radius)


def wall(distance: float) -> Segment:
    """The segment of a wall all around the scanner [m]."""
    return Segment(0, COUNT - 1, COUNT, distance)


def expected(name: str, angle: float, distance: float) -> Candidate:
    """A robot expected at that angle and distance [rad; m]."""
    return Candidate(name, distance, angle, RADIUS, DEVIATION)


def outcomes(segments: Sequence[Segment], *robots: Candidate) -> Mapping[str, Outcome]:
    """The outcome of the association for each robot."""
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
        pytest.param([body(0.5, 1.0)], Outcome.SEEN, id="body at expected position"),
        pytest.param([], Outcome.HIDDEN, id="empty scan"),
        pytest.param([ELSEWHERE], Outcome.MISSING, id="no beam from expected position"),
        pytest.param([ELSEWHERE, body(0.5, 0.5)], Outcome.HIDDEN, id="body in front"),
        pytest.param([ELSEWHERE, body(0.3, 0.9)], Outcome.ABSENT, id="same body beside and nearer"),
        pytest.param([ELSEWHERE, body(0.5, 1.0, 0.01)], Outcome.HIDDEN, id="pole at expected position"),
        pytest.param([body(0.5, 0.5), wall(2.0)], Outcome.HIDDEN, id="body in front, wall behind"),
        pytest.param([wall(2.0)], Outcome.ABSENT, id="wall behind expected position"),
        pytest.param([body(0.8, 1.0)], Outcome.ABSENT, id="same body beside expected position"),
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


def test_body_of_another_known_robot_leaves_robot_hidden() -> None:
    seen = outcomes([body(0.8, 1.0)], A, expected("b", 0.8, 1.0))
    assert seen == {"a": Outcome.HIDDEN, "b": Outcome.SEEN}


def test_robot_near_range_max_is_hidden() -> None:
    assert outcomes([wall(3.49)], expected("a", 0.5, 3.4)) == {"a": Outcome.HIDDEN}


@given(st.floats(0.6, 2.0), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_segment_is_chosen_only_if_clearly_better(distance: float, one: float, other: float) -> None:
    """There are two cylinders near the expected position."""
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
def test_body_that_fits_two_robots_shows_neither(apart: float) -> None:
    seen = outcomes([body(0.5, 1.0)], expected("a", 0.5 - apart, 1.0), expected("b", 0.5 + apart, 1.0))
    assert Outcome.SEEN not in seen.values()
