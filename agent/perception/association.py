"""Which segment of a scan is which neighbour: decided by published places, and only where it is clear.

Pure. A neighbour is expected where it says that it is, as seen from where this robot believes to be. A
cylinder of its radius that is near enough, in units of the uncertainty of both, is that neighbour, unless
another one fits almost as well, also one that is partly hidden, or that one fits another robot almost as
well: then none is chosen. Where the way to the expected place is free, beams that end behind it, or a
cylinder of that size beside it, show that the neighbour is not there. So do several scans in which no beam
comes back from there, though others do from elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from enum import StrEnum
from typing import NamedTuple

from formation.sensing.detection import (
    Beams,
    Detection,
    Segment,
    around,
    covered,
    detection,
    expected_beams,
)

MAX_SQUARED_DISTANCE = 11.8
"""Greatest squared Mahalanobis distance of a neighbour: 0.3 % of true ones are further off."""
CLEAR_DIFFERENCE = 6.0
"""Squared distance by which the next best choice must be worse."""
SEARCH_DISTANCE, SEARCH_DEVIATIONS, SEARCH_RANGE_DEVIATIONS = 0.06, 3.5, 2.0
"""Distance from the expected place within which is searched [m], and in addition deviations of place and
range."""
MAX_SEARCH_DISTANCE = 0.6
"""Most of it [m]."""
MIN_EXPECTED_BEAMS = 1.5
"""Number of beams on a neighbour from which on its absence is believed."""
MIN_COVERED_SHARE = 0.7
"""Share of the beams towards its place that must have ended behind it."""


class Outcome(StrEnum):
    """What one scan says about one neighbour."""

    SEEN = "seen"
    """It is where it says."""
    HIDDEN = "hidden"
    """Nothing is known: out of range, hidden, or no beam of the scan came back."""
    MISSING = "missing"
    """No beam came back from its place, nor from anything before it: they may be lost."""
    UNCLEAR = "unclear"
    """Several cylinders, or several robots, fit."""
    ABSENT = "absent"
    """Beams pass through the place where it says that it is."""


class Candidate(NamedTuple):
    """A robot that may be in sight, as it is expected."""

    name: str
    distance: float
    """From the scanner [m]."""
    angle: float
    """[rad; scanner's frame, at the moment of the beam]"""
    radius: float
    """Of what scanners see of it [m]."""
    deviation: float
    """Standard deviation of its place relative to this robot [m]."""


Fit = Callable[[str, Detection], float]
"""Squared Mahalanobis distance of a detection, if it is the robot of that name."""


class Found(NamedTuple):
    """What a scan says about one robot."""

    outcome: Outcome
    detection: Detection | None = None
    """Only if it is seen."""
    missed: float = 0.0
    """Only if it is missing: number of beams that should have met it."""


def search_distance(candidate: Candidate, scan: Beams) -> float:
    """Distance from the expected place within which a robot is searched in a scan [m]."""
    spread = SEARCH_DEVIATIONS * candidate.deviation
    noise = SEARCH_RANGE_DEVIATIONS * scan.noise.deviation(candidate.distance)
    return min(MAX_SEARCH_DISTANCE, SEARCH_DISTANCE + spread + noise)


def associate(scan: Beams, candidates: Sequence[Candidate], fit: Fit) -> dict[str, Found]:
    """Say of each candidate what the scan shows of it."""
    near = {one.name: _near(scan, one, search_distance(one, scan)) for one in candidates}
    fits: dict[str, list[tuple[float, Segment, Detection]]] = {
        one.name: sorted([(fit(one.name, found), segment, found) for segment, found in near[one.name]])
        for one in candidates
    }
    return {one.name: _found(scan, one, fits) for one in candidates}


def _near(scan: Beams, one: Candidate, reach: float) -> list[tuple[Segment, Detection]]:
    """What may contain the robot, within `reach` [m] of where it is expected."""
    found = []
    for segment in around(scan, one.angle, _half_angle(one, reach + one.radius)):
        seen = detection(segment, scan, one.radius)
        if seen is not None and _apart(one, seen) <= reach:
            found.append((segment, seen))
    return found


def _half_angle(one: Candidate, reach: float) -> float:
    """Half of the angle under which a disc of radius `reach` [m] around the expected place is seen [rad]."""
    return math.asin(min(1.0, reach / max(one.distance, reach)))


def _apart(one: Candidate, seen: Detection) -> float:
    """Distance of a detection from the expected place [m]."""
    turn = seen.angle - one.angle
    square = one.distance**2 + seen.distance**2 - 2.0 * one.distance * seen.distance * math.cos(turn)
    return math.sqrt(max(0.0, square))


def _found(
    scan: Beams, one: Candidate, fits: Mapping[str, Sequence[tuple[float, Segment, Detection]]]
) -> Found:
    mine = fits[one.name]
    if not mine or mine[0][0] > MAX_SQUARED_DISTANCE:
        taken = {
            segment
            for name, theirs in fits.items()
            if name != one.name
            for squared, segment, _ in theirs
            if squared <= MAX_SQUARED_DISTANCE
        }
        if _is_absent(scan, one, taken):
            return Found(Outcome.ABSENT)
        missed = _missed(scan, one)
        return Found(Outcome.MISSING if missed else Outcome.HIDDEN, missed=missed)
    squared, segment, seen = mine[0]
    if not seen.whole:
        return Found(Outcome.UNCLEAR)
    rivals = [squared for squared, _, _ in mine[1:]]
    rivals += [
        squared
        for name, theirs in fits.items()
        if name != one.name
        for squared, other, _ in theirs
        if other == segment
    ]
    if any(rival < squared + CLEAR_DIFFERENCE for rival in rivals):
        return Found(Outcome.UNCLEAR)
    return Found(Outcome.SEEN, seen)


def _is_absent(scan: Beams, one: Candidate, taken: Collection[Segment]) -> bool:
    """Whether the way to the expected place is free, and the robot is not there.

    Beams end behind all places where it can be, or a cylinder of its size stands beside them that is no
    other robot, none of the segments `taken`.
    """
    reach = search_distance(one, scan)
    expected = expected_beams(one.radius, one.distance, scan.increment)
    if expected < MIN_EXPECTED_BEAMS or one.distance + reach > scan.range_max:
        return False
    if any(segment.distance < one.distance - reach for segment in around(scan, one.angle, 0.0)):
        return False
    near = _near(scan, one, MAX_SEARCH_DISTANCE)
    if any(not seen.whole and _apart(one, seen) <= reach for _, seen in near):
        return False
    if any(seen.whole and segment not in taken for segment, seen in near):
        return True
    half = _half_angle(one, reach)
    segments = tuple(around(scan, one.angle, half))
    return (
        not any(segment.distance < one.distance for segment in segments)
        and covered(scan, segments, one.angle, half) > MIN_COVERED_SHARE
    )


def _missed(scan: Beams, one: Candidate) -> float:
    """Number of beams that should have met a robot, where no beam came back from its place.

    0 if something before it may hide it, if it is too far away, and for a scan without any hit: its scanner
    may be covered.
    """
    reach = search_distance(one, scan)
    expected = expected_beams(one.radius, one.distance, scan.increment)
    if not scan.segments or expected < MIN_EXPECTED_BEAMS or one.distance + reach > scan.range_max:
        return 0.0
    half = _half_angle(one, reach + one.radius)
    if not scan.covers(one.angle, half):
        return 0.0
    hidden = any(segment.distance < one.distance + reach for segment in around(scan, one.angle, half))
    return 0.0 if hidden else expected
