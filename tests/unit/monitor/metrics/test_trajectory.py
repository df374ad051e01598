from __future__ import annotations

import cmath
import math

import pytest

from formation.monitor.metrics.trajectory import Placed, Trajectory
from formation.wire import BadMessage


def along(*samples: tuple[float, complex, float], widest: float = 0.3) -> Trajectory:
    """Samples of moment, point and angle."""
    trajectory = Trajectory(100, widest)
    for moment, point, angle in samples:
        trajectory.add(Placed(moment, point, cmath.rect(1.0, angle)))
    return trajectory


def test_a_turning_robot_is_interpolated_along_the_arc_of_its_heading() -> None:
    placed = along((0.0, 0j, 3.0), (0.1, 1 + 2j, 3.4)).at(0.025)
    assert placed is not None
    assert placed.point == pytest.approx(0.25 + 0.5j)
    # through ±π, and of length one
    assert placed.heading == pytest.approx(cmath.rect(1.0, 3.1))


def test_trajectory_is_exact_at_samples_and_unknown_outside() -> None:
    trajectory = along((0.0, 0j, 0.0), (0.1, 1j, 0.0))
    assert trajectory.at(0.1) == Placed(0.1, 1j, 1 + 0j)
    assert trajectory.at(0.0) == Placed(0.0, 0j, 1 + 0j)
    assert trajectory.at(0.1 + 1e-9) is None
    assert trajectory.at(-1e-9) is None
    assert along().at(0.0) is None
    assert along().latest == -math.inf


def test_distant_samples_are_not_interpolated() -> None:
    assert along((0.0, 0j, 0.0), (0.3, 1j, 0.0)).at(0.1) is not None
    assert along((0.0, 0j, 0.0), (0.31, 1j, 0.0)).at(0.1) is None


def test_only_later_samples_are_taken() -> None:
    trajectory = along((0.0, 0j, 0.0), (0.1, 1j, 0.0))
    for moment in (0.1, 0.05):
        with pytest.raises(BadMessage, match="not later"):
            trajectory.add(Placed(moment, 9j, 1 + 0j))
    assert trajectory.at(0.1) == Placed(0.1, 1j, 1 + 0j)


def test_memory_is_bounded() -> None:
    trajectory = Trajectory(10, 1.0)
    for i in range(1000):
        trajectory.add(Placed(i / 10, complex(i), 1 + 0j))
    assert trajectory.at(98.9) is None
    assert trajectory.at(99.0) is not None
