"""Paths that a camera sees beside the commands: mirrored, delayed, noisy, slipping."""

from __future__ import annotations

import cmath
from collections import deque
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.pose.mirror import MirrorCheck
from formation.control.observer import Travel
from formation.control.unicycle import along

PERIOD = 0.05


def judged(
    random: Random, *, delay: float = 0.0, noise: float = 0.0, slip: float = 0.0, mirrored: bool = False
) -> bool:
    """Whether a path of random commands counts as mirrored; `slip` is the share of turns that is lost."""
    check, frame = MirrorCheck(), cmath.rect(1.0, random.uniform(-3.0, 3.0))
    at, heading, seen = 0j, frame, 0j
    places = deque([0j] * (1 + round(delay / PERIOD)))
    for _ in range(40):
        speed = random.choice((-0.2, 0.0, 0.05, 0.2, 0.2, random.uniform(-0.2, 0.2)))
        turn_rate = random.choice((0.0, random.uniform(-2.6, 2.6), 2.6, -2.6))
        for _ in range(round(random.uniform(0.2, 3.0) / PERIOD)):
            turn = turn_rate * PERIOD
            at, heading = along(at, heading, speed * PERIOD, (1.0 - slip) * turn)
            heading /= abs(heading)
            places.append(at.conjugate() if mirrored else at)
            shown = places.popleft() + complex(random.gauss(0.0, noise), random.gauss(0.0, noise))
            moved, seen = shown - seen, shown
            check.add(Travel(speed * PERIOD, turn, moved))
            if check.doubt is not None:
                return True
    return False


@given(
    seed=st.integers(0, 2**32),
    delay=st.sampled_from((0.0, 0.1, 0.35)),
    noise=st.sampled_from((0.0, 0.002, 0.005)),
    slip=st.sampled_from((0.0, 0.15, 1.0)),
)
def test_path_with_delay_noise_and_slip_is_not_mirrored(
    seed: int, delay: float, noise: float, slip: float
) -> None:
    assert not judged(Random(seed), delay=delay, noise=noise, slip=slip)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize(("delay", "noise"), [(0.0, 0.0), (0.1, 0.002)])
def test_mirrored_path_is_found(seed: int, delay: float, noise: float) -> None:
    assert judged(Random(seed), delay=delay, noise=noise, mirrored=True)


def test_trust_begins_anew() -> None:
    check = MirrorCheck()
    for number in range(100):
        check.add(Travel(0.01, 0.2, 0.01 * cmath.rect(1.0, -0.2 * (number + 0.5))))
    assert check.state.found
    check.trust()
    check.add(Travel(0.01, 0.2, 0.01))
    assert not check.state.found
