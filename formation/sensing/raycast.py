"""Measurements of a range scanner in a world of discs and walls, without and with its errors.

Pure, in plain numbers. Only beams that can hit an object are computed, so a scan costs as many
intersections as it has hits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import NamedTuple

from formation.control.plane import rotation


class Scanner(NamedTuple):
    """A scanner's properties; the numbers are those of an LDS-01, the scanner of a TurtleBot3 Burger.

    Range, beams and rate are from its data sheet. That bounds the precision by 10 mm up to half a metre
    and by 3.5 % beyond, here taken as two standard deviations. It does not give the share of lost beams.
    """

    beams: int = 360
    """In a full turn, counter-clockwise; the first along the x axis."""
    range_min: float = 0.12
    """[m]"""
    range_max: float = 3.5
    """[m]"""
    noise: float = 0.005
    """Standard deviation of a distance [m], at least."""
    relative_noise: float = 0.0175
    """The same as a share of the distance, where that is more than `growth_distance`."""
    growth_distance: float = 0.5
    """[m]"""
    lost: float = 0.0
    """Share of beams that do not come back, at random."""


MIN_NOISE = 1e-6
"""Least standard deviation of a distance [m]: no real scanner measures twice the same to the last bit."""
LOST_RANGE = 0.0
"""Range that an LDS-01 reports for a lost beam [m]."""


def cast(
    at: complex,
    heading: complex,
    discs: Iterable[tuple[complex, float]],
    walls: Iterable[tuple[complex, complex]],
    beams: int,
) -> list[float]:
    """Range of each beam [m]; infinite where nothing is hit.

    `at` [m] and unit `heading` are the scanner's, `discs` are (centre, radius) [m], `walls` straight
    between two points [m], all in one frame. In a disc that contains the scanner, all beams have 0 m.
    """
    found = [math.inf] * beams
    back = heading.conjugate()
    for centre, radius in discs:
        _meet_disc(found, back * (centre - at), radius)
    for begin, end in walls:
        _meet_wall(found, back * (begin - at), back * (end - at))
    return found


def measured(
    distances: Iterable[float],
    scanner: Scanner,
    normal: Sequence[float],
    uniform: Sequence[float],
    scale: float = 1.0,
) -> tuple[float, ...]:
    """Add a scanner's errors to true distances [m], with a normal and a uniform random number per beam.

    `scale` is the systematic ratio of measured to true distances.
    """
    readings = []
    least = max(scanner.noise, MIN_NOISE)
    for distance, deviation, chance in zip(distances, normal, uniform, strict=True):
        if distance == math.inf or chance < scanner.lost:
            readings.append(LOST_RANGE)
            continue
        share = scanner.relative_noise if distance > scanner.growth_distance else 0.0
        reading = scale * distance + max(least, share * distance) * deviation
        in_range = scanner.range_min <= reading <= scanner.range_max
        readings.append(reading if in_range else LOST_RANGE)
    return tuple(readings)


@cache
def _rays(beams: int) -> tuple[complex, ...]:
    """The direction of each beam, unit complex [scanner's frame]."""
    return tuple(rotation(number * math.tau / beams) for number in range(beams))


def _meet_disc(found: list[float], centre: complex, radius: float) -> None:
    """Shorten the beams that meet a disc [scanner's frame]."""
    distance = abs(centre)
    if distance <= radius:
        found[:] = [0.0] * len(found)
        return
    middle, half = math.atan2(centre.imag, centre.real), math.asin(radius / distance)
    rays = _rays(len(found))
    for number in _between(middle - half, middle + half, len(found)):
        along = rays[number].conjugate() * centre
        depth = radius * radius - along.imag * along.imag
        if depth >= 0.0:
            found[number] = min(found[number], along.real - math.sqrt(depth))


def _meet_wall(found: list[float], begin: complex, end: complex) -> None:
    """Shorten the beams that meet a wall [scanner's frame]."""
    wall = end - begin
    turn = begin.real * end.imag - begin.imag * end.real
    if turn == 0.0:  # from its end it is no wider than a beam
        return
    if turn < 0.0:
        begin, wall, turn = end, -wall, -turn
    first = math.atan2(begin.imag, begin.real)
    far = (begin + wall) * begin.conjugate()
    rays = _rays(len(found))
    for number in _between(first, first + math.atan2(far.imag, far.real), len(found)):
        ray = rays[number]
        across = ray.real * wall.imag - ray.imag * wall.real
        if across > 0.0:
            found[number] = min(found[number], turn / across)


def _between(first: float, last: float, beams: int) -> Iterator[int]:
    """The beams with angles from `first` to `last` [rad], `first` being the smaller."""
    step = math.tau / beams
    for number in range(math.ceil(first / step), math.floor(last / step) + 1):
        yield number % beams
