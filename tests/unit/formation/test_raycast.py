from __future__ import annotations

import cmath
import math
import random

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from formation.sensing.raycast import LOST_RANGE, Scanner, cast, measured

BEAMS, FEW = 360, 72
metres = st.floats(-5.0, 5.0)
places = st.builds(complex, metres, metres)
headings = st.floats(-math.pi, math.pi).map(lambda angle: cmath.rect(1.0, angle))
discs = st.lists(st.tuples(places, st.floats(0.01, 0.5)), max_size=4)
walls = st.lists(st.tuples(places, places), max_size=4)


def ray(number: int, heading: complex, beams: int) -> complex:
    return heading * cmath.rect(1.0, number * math.tau / beams)


def off_wall(point: complex, begin: complex, end: complex) -> float:
    """How far a point is from a wall."""
    way = end - begin
    share = ((point - begin) * way.conjugate()).real / max(abs(way) ** 2, 1e-300)
    return abs(point - begin - min(max(share, 0.0), 1.0) * way)


@given(places, headings, discs, walls)
def test_a_beam_ends_on_what_it_hit_and_passes_through_nothing(
    at: complex,
    heading: complex,
    discs: list[tuple[complex, float]],
    walls: list[tuple[complex, complex]],
) -> None:
    found = cast(at, heading, discs, walls, FEW)
    for number, distance in enumerate(found):
        if distance in {0.0, math.inf}:
            continue
        end = at + distance * ray(number, heading, FEW)
        on = [abs(abs(end - centre) - radius) for centre, radius in discs]
        on += [off_wall(end, *wall) for wall in walls]
        assert min(on) < 1e-5
        for share in (0.1, 0.5, 0.9, 0.999):
            point = at + share * distance * ray(number, heading, FEW)
            assert all(abs(point - centre) > radius - 1e-6 for centre, radius in discs)


@given(places, headings, discs.filter(bool))
def test_beam_towards_a_disc_hits_it(
    at: complex, heading: complex, discs: list[tuple[complex, float]]
) -> None:
    found = cast(at, heading, discs, [], BEAMS)
    for centre, radius in discs:
        distance = abs(centre - at)
        if distance > radius / math.sin(math.tau / BEAMS) or distance <= radius:
            continue  # narrower than the space between two beams, or all around
        number = round(cmath.phase((centre - at) / heading) / math.tau * BEAMS) % BEAMS
        assert found[number] <= distance


def test_a_wall_ahead_is_as_far_as_geometry_says() -> None:
    found = cast(0j, 1 + 0j, [], [(2 - 1j, 2 + 1j)], BEAMS)
    assert found[0] == pytest.approx(2.0)
    assert found[20] == pytest.approx(2.0 / math.cos(math.radians(20)))
    assert found[27] == found[180] == math.inf  # past its end, and behind
    assert found[340] == pytest.approx(found[20])


def test_it_does_not_matter_which_end_of_a_wall_comes_first() -> None:
    one = cast(0.3j, 1j, [], [(2 - 1j, 2 + 1j)], BEAMS)
    assert one == pytest.approx(cast(0.3j, 1j, [], [(2 + 1j, 2 - 1j)], BEAMS))


def test_a_robot_hides_what_is_behind_it() -> None:
    found = cast(0j, 1 + 0j, [(1 + 0j, 0.1), (2 + 0j, 0.1)], [(3 - 3j, 3 + 3j)], BEAMS)
    assert found[0] == pytest.approx(0.9)
    assert found[30] == pytest.approx(3.0 / math.cos(math.radians(30)))


def test_within_a_disc_nothing_is_far() -> None:
    assert set(cast(0j, 1 + 0j, [(0.05 + 0j, 0.1)], [], BEAMS)) == {0.0}


@given(places, headings, discs, walls)
def test_a_mirrored_world_gives_a_mirrored_scan(
    at: complex,
    heading: complex,
    discs: list[tuple[complex, float]],
    walls: list[tuple[complex, complex]],
) -> None:
    assume(all(off_wall(at, *wall) > 1e-3 for wall in walls))  # on a wall one sees one of its sides
    found = cast(at, heading, discs, walls, FEW)
    mirrored = cast(
        at.conjugate(),
        heading.conjugate(),
        [(centre.conjugate(), radius) for centre, radius in discs],
        [(begin.conjugate(), end.conjugate()) for begin, end in walls],
        FEW,
    )
    # at the very edge of a thing a beam may hit on one side and miss on the other
    differ = [n for n in range(FEW) if abs(found[n] - mirrored[-n % FEW]) > 1e-6]
    assert len(differ) <= 2 * (len(discs) + len(walls))


def test_a_scanner_says_what_it_can_and_loses_its_share() -> None:
    rng, beams = random.Random(1), 20_000
    scanner = Scanner(lost=0.1)
    normal = [rng.gauss(0.0, 1.0) for _ in range(beams)]
    uniform = [rng.random() for _ in range(beams)]
    near = [d for d in measured([0.3] * beams, scanner, normal, uniform) if d != LOST_RANGE]
    far = [d for d in measured([3.0] * beams, scanner, normal, uniform) if d != LOST_RANGE]
    assert len(near) / beams == pytest.approx(0.9, abs=0.01)
    assert math.sqrt(sum((d - 0.3) ** 2 for d in near) / len(near)) == pytest.approx(0.005, rel=0.03)
    assert math.sqrt(sum((d - 3.0) ** 2 for d in far) / len(far)) == pytest.approx(0.0525, rel=0.03)


@pytest.mark.parametrize("distance", [0.05, 4.0, math.inf])
def test_what_is_out_of_its_range_it_does_not_see(distance: float) -> None:
    assert measured([distance], Scanner(), [0.0], [0.5]) == (LOST_RANGE,)
