from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.simulated.plant import Plant
from formation.control.unicycle import Command
from formation.simulation.body import PROFILES, Body

BURGER = PROFILES["turtlebot3_burger"]
SPEEDS = st.floats(-1.5, 1.5)


def plant(kind: Body, position: complex = 0j, heading: complex = 1 + 0j, seed: int = 0) -> Plant:
    return Plant(kind, position, heading, np.random.default_rng(seed))


def drive(one: Plant, speed: float, turn_rate: float, seconds: float) -> None:
    one.obey(Command(speed, turn_rate))
    one.advance(seconds)


def pose(one: Plant) -> tuple[complex, complex]:
    return one.position, one.heading


@given(SPEEDS, SPEEDS.filter(lambda w: abs(w) > 1e-3), st.floats(0.0, 20.0), st.floats(-math.pi, math.pi))
def test_plant_without_lag_moves_along_exact_arc(u: float, w: float, t: float, angle: float) -> None:
    one = plant(Body(), 2.0 - 1.0j, cmath.rect(1.0, angle))
    drive(one, u, w, t)
    turned = cmath.rect(1.0, angle + w * t)
    centre = 2.0 - 1.0j + 1j * (u / w) * cmath.rect(1.0, angle)
    assert one.heading == pytest.approx(turned, abs=1e-9)
    assert one.position == pytest.approx(centre - 1j * (u / w) * turned, abs=1e-6)


def test_wheels_follow_a_command_exponentially() -> None:
    one = plant(Body(lag=0.2))
    drive(one, 1.0, -0.5, 0.2)
    assert one.moving.speed == pytest.approx(1.0 - math.exp(-1.0))
    assert one.moving.turn_rate == pytest.approx(-0.5 * (1.0 - math.exp(-1.0)))
    one.advance(20.0)
    assert one.moving == (1.0, -0.5)


def test_pose_integrates_unicycle_while_wheel_speed_changes() -> None:
    one, lag, end, steps = plant(Body(lag=0.15), heading=1j), 0.15, 0.7, 200_000
    drive(one, 1.2, -1.5, end)
    # the same written out: midpoint rule of Eq. (1) on steps a thousand times finer
    t = (np.arange(steps) + 0.5) * (end / steps)
    u, theta = 1.2 * (1.0 - np.exp(-t / lag)), math.pi / 2 - 1.5 * (t - lag * (1.0 - np.exp(-t / lag)))
    assert one.position == pytest.approx(complex((u * np.exp(1j * theta)).sum() * end / steps), abs=2e-6)
    assert cmath.phase(one.heading) == pytest.approx(
        math.pi / 2 - 1.5 * (end - lag * (1 - math.exp(-end / lag)))
    )


@given(st.lists(st.floats(1e-4, 0.3), min_size=1, max_size=40))
def test_motion_does_not_depend_on_step_sizes(pieces: list[float]) -> None:
    in_pieces, at_once = plant(Body(lag=0.1, drift=0.02)), plant(Body(lag=0.1, drift=0.02))
    for one in (in_pieces, at_once):
        one.obey(Command(1.5, 1.5))
    for piece in pieces:
        in_pieces.advance(piece)
    at_once.advance(sum(pieces))
    assert in_pieces.position == pytest.approx(at_once.position, abs=1e-5)
    assert in_pieces.heading == pytest.approx(at_once.heading, abs=1e-9)
    assert in_pieces.odometry()[0] == pytest.approx(at_once.odometry()[0], abs=1e-5)


def test_zero_or_negative_time_moves_nothing() -> None:
    one = plant(BURGER)
    drive(one, 0.2, 1.0, 0.0)
    one.advance(-5.0)
    assert pose(one) == (0j, 1 + 0j)
    assert one.moving == (0.0, 0.0)


@pytest.mark.parametrize(
    ("requested", "done"),
    [(0.058, 0.05), (-0.058, -0.05), (0.0099, 0.0), (-0.0099, 0.0), (0.07, 0.07), (0.2, 0.2)],
)
def test_commands_are_rounded_to_steps_towards_zero(requested: float, done: float) -> None:
    one = plant(BURGER)
    one.obey(Command(requested, requested))
    assert one.command == pytest.approx((done, done))


@given(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0))
def test_obeyed_command_never_exceeds_request_or_limits(speed: float, turn_rate: float) -> None:
    one = plant(BURGER)
    one.obey(Command(speed, turn_rate))
    for done, requested, limit in (
        (one.command.speed, speed, 0.2108),
        (one.command.turn_rate, turn_rate, 2.635),
    ):
        assert abs(done) <= min(abs(requested) + 1e-7, limit)
        assert done * requested >= 0.0
        assert abs(done) == limit or abs(requested - done) <= 0.01 + 1e-7


def test_odometry_of_ideal_robot_is_exact() -> None:
    one = plant(PROFILES["ideal"], 3.0 + 4.0j, 1j)
    drive(one, 0.3, 0.4, 7.0)
    assert one.odometry() == pose(one)


def test_drift_grows_with_path_only() -> None:
    one = plant(Body(drift=0.01))
    for metres in (1.0, 2.0, 3.0):
        drive(one, 1.0, 0.0, 1.0)
        assert one.path == pytest.approx(metres)
        assert abs(one.odometry()[0] - one.position) == pytest.approx(0.01 * metres)
    drive(one, 0.0, 0.0, 3600.0)
    drive(one, 0.0, 1.0, math.pi)
    assert abs(one.odometry()[0] - one.position) == pytest.approx(0.03)
    drive(one, -1.0, 0.0, 1.0)
    assert abs(one.odometry()[0] - one.position) == pytest.approx(0.04)


def test_noise_has_configured_size_and_does_not_accumulate() -> None:
    one = plant(Body(position_noise=0.02, heading_noise=0.01), seed=4)
    samples = [one.odometry() for _ in range(20_000)]
    positions = np.array([position for position, _ in samples])
    angles = np.angle([heading for _, heading in samples])
    assert positions.real.std() == pytest.approx(0.02, rel=0.03)
    assert positions.imag.std() == pytest.approx(0.02, rel=0.03)
    assert angles.std() == pytest.approx(0.01, rel=0.03)
    assert abs(positions.mean()) < 0.001
    assert np.allclose(np.abs([heading for _, heading in samples]), 1.0)


def test_odometry_is_equal_only_for_equal_seeds() -> None:
    def odometry(seed: int) -> list[tuple[complex, complex]]:
        one = plant(BURGER, seed=seed)
        one.obey(Command(0.1, 0.3))
        samples = []
        for _ in range(50):
            one.advance(0.05)
            samples.append(one.odometry())
        return samples

    assert odometry(7) == odometry(7)
    assert odometry(7) != odometry(8)


def test_heading_stays_normalised_over_many_arcs() -> None:
    one = plant(Body())
    one.obey(Command(1.0, 1.5))
    for _ in range(20_000):
        one.advance(0.05)
    assert abs(one.heading) == pytest.approx(1.0, abs=1e-12)
