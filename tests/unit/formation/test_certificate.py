"""Certificates compared with simulations, and counterexamples to claims of the paper."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from formation.control.controller import Gains, Limits, Measured
from formation.control.laws.paper import CONTROLLER as PAPER
from formation.control.unicycle import advance, body_velocity
from formation.mission.file import load
from formation.mission.model import Mission
from formation.simulation.ensemble import Options
from formation.simulation.simulate import simulate
from formation.stability.analysis import analyse
from formation.stability.certificate import certificate, curve_errors
from tests.support.examples import slow
from tests.support.missions import with_robots
from tests.unit.formation import scenarios
from tests.unit.formation.scenarios import IDEAL, edge_errors

SIX = load("six_robots")
CIRCLE = {"radius": 1.2, "speed": 0.2}
ALONE = Options(avoid=False)


def drawn(seed: int, leader_speed: float = 0.2, route: dict[str, Any] | None = None, **law: Any) -> Mission:
    """A random mission without cycles, of 3 to 8 ideal robots."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 9))
    neighbours = scenarios.random_neighbours(rng, count)
    slots = -0.7 * np.arange(count) + 1j * rng.uniform(-1.0, 1.0, count)
    slots -= slots[0]
    route = route or {"speed": leader_speed, "heading_deg": float(rng.uniform(-180.0, 180.0))}
    return scenarios.build(slots, neighbours, route, law={"leader_orders": "none", **law})


@pytest.mark.parametrize(
    ("mission", "horizon"),
    [
        *((drawn(seed, route=CIRCLE, leader_orders="none"), 60.0) for seed in (0, 1, 2)),
        *((drawn(seed, route=CIRCLE, leader_orders="velocity"), 60.0) for seed in (0, 1, 2)),
        # robots faster than the leader's top speed: they weigh less, and their velocities are cut
        (drawn(3, route=CIRCLE, gain=0.6), 120.0),
    ],
)
def test_error_on_a_circle_is_as_certified(mission: Mission, horizon: float) -> None:
    assert edge_errors(mission, horizon) == pytest.approx(curve_errors(mission), rel=1e-3, abs=1e-6)


def test_error_on_a_circle_of_a_ring_is_as_certified() -> None:
    mission = Mission.model_validate({**scenarios.ring(4).model_dump(), "route": [CIRCLE]})
    assert edge_errors(mission, 120.0) == pytest.approx(curve_errors(mission), rel=1e-4)


@pytest.mark.parametrize(
    "seed", [pytest.param(one, marks=pytest.mark.slow if one > 4 else ()) for one in range(200)]
)
def test_missions_certified_for_every_start_converge(seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    mission = drawn(seed, leader_speed=float(rng.uniform(0.01, 0.14)))
    found = certificate(mission, stable=True)
    assert found.convergence == "every start"
    result = simulate(mission, runs=10, seed=seed, horizon=90.0, step=0.05, options=IDEAL, spread=2.0)
    assert result.converged.all()


@pytest.mark.parametrize(
    ("mission", "says"),
    [
        (SIX.under("paper"), "the law must be `field`"),
        (drawn(1, leader_speed=0.9), "the leader must be slower than robot2: 0.9 m/s, L x max_turn_rate"),
        (drawn(1, gain=30.0), "gain x control period"),
        (drawn(1, gain=19.0), "(gain + leader's speed / L) x control period must be at most 1: robot2"),
        (drawn(1, gain=2.9), "gain x the distance behind robot2 from which it reverses"),
        (drawn(1, route=CIRCLE), "the leader must drive straight"),
        (scenarios.ring(4), "measure each other"),
    ],
)
def test_each_broken_assumption_is_named(mission: Mission, says: str) -> None:
    found = certificate(mission, stable=True)
    assert found.convergence == "near formation"
    assert says in " ".join(found.broken)


@pytest.mark.usefixtures("paper_law_not_simulated")
def test_unstable_mission_has_no_certificate() -> None:
    found = analyse(scenarios.ring(12, k_p=2.0).under("paper"))
    assert not found.stable
    assert found.certificate.convergence == "none"


@pytest.mark.parametrize(("speed", "says"), [(0.05, "near formation"), (0.2165, "none")])
def test_cycle_settles_only_at_certified_speed(speed: float, says: str) -> None:
    """Along the leader's direction the loop is stable at both speeds; across it a robot turns too far."""
    neighbours = [[], [0, 4], [0, 3], [1, 5], [2, 3], [1]]
    slots = -0.7 * np.arange(6) + 1j * np.array([0.0, -0.4, 0.2, 0.0, -0.6, 0.5])
    robot = {"control_point_offset": 0.175, "max_speed": 1.67, "max_turn_rate": 1.55, "rate": 10.0}
    law = {"leader_orders": "none", "gain": 4.6}
    mission = scenarios.build(slots, neighbours, {"speed": speed, "heading_deg": 30.0}, law=law, robot=robot)
    assert analyse(mission).certificate.convergence == says
    result = simulate(mission, runs=4, horizon=60.0, step=0.1, options=IDEAL, starts="random", spread=1e-3)
    assert (result.final_error < 1e-3).all() == (says == "near formation")
    assert (result.final_error > 1e-2).all() == (says == "none")


@pytest.mark.parametrize(("speed", "says"), [(0.36, "near formation"), (0.39, "none")])
def test_short_offset_settles_only_at_certified_speed(speed: float, says: str) -> None:
    """Without a cycle: T (k + v/L) is 1.94 and 2.06. Between two commands the robot drives into its turn."""
    robot = {"control_point_offset": 0.05, "max_speed": 2.0, "max_turn_rate": 2.0, "rate": 5.0}
    route = {"speed": speed, "heading_deg": 30.0}
    mission = scenarios.build(np.array([0.0, -0.8]), [[], [0]], route, law={"gain": 2.5}, robot=robot)
    found = analyse(mission)
    assert found.certificate.convergence == says
    assert ("it turns too far between two commands" in " ".join(found.problems)) == (says == "none")
    result = simulate(mission, runs=4, horizon=120.0, step=0.2, options=IDEAL, starts="random", spread=1e-3)
    assert (result.final_error < 1e-6).all() == (says == "near formation")
    assert (result.final_error > 5e-3).all() == (says == "none")


def test_robots_with_few_commands_are_not_certified_for_every_start() -> None:
    """T (k + v/L) of 1.7 is stable near formation, but one step may turn by 1.6 rad."""
    robot = {"control_point_offset": 0.05, "max_speed": 2.0, "max_turn_rate": 7.8, "rate": 5.0}
    route = {"speed": 0.3, "heading_deg": 30.0}
    slots = np.array([0.0, -0.8, -1.6])
    mission = scenarios.build(slots, [[], [0], [1]], route, law={"gain": 2.5}, robot=robot)
    result = simulate(mission, runs=4, horizon=60.0, step=0.2, options=IDEAL, starts="random", spread=1e-3)
    assert not result.converged.all()
    assert "control period must be at most 1" in " ".join(analyse(mission).certificate.broken)


@pytest.mark.parametrize(("speed", "stable"), [(0.05, False), (0.2, True), (1.0, True)])
def test_paper_law_by_centres_is_stable_only_above_minimum_speed(speed: float, *, stable: bool) -> None:
    offset, gains, dt = 0.2, Gains(2.0, 1.0), 0.01
    assert (speed * gains.k_p > offset * gains.k_i) is stable
    limits, leader = Limits(offset, 10.0, 10.0), 0j
    here, heading, integral, aside = 1e-6j, 1 + 0j, complex(speed / gains.k_i), []
    for _ in range(int(200.0 / dt)):
        seen = Measured(heading.conjugate() * (leader - here), 0j, 1)
        command, integral = PAPER.step(integral, heading, seen, gains, limits, dt)
        here, heading = advance(here, heading, *command, dt)
        leader += speed * dt
        aside.append(abs((leader - here).imag))
    assert (max(aside[-1000:]) < 1e-6) is stable


def paper_command(away: complex, integral: complex, limits: Limits) -> complex:
    """What the law `paper` commands towards a slot `away` for a robot that faces along x [m/s]."""
    command, _ = PAPER.step(integral, 1 + 0j, Measured(away, 0j, 1), Gains(2.0, 1.0), limits, 0.01)
    return body_velocity(*command, limits.offset)


def test_printed_bound_of_lemma_1_lacks_first_position() -> None:
    limits, first, seconds = Limits(0.2, 1.5, 1.5), 3.0, 2.0
    point = first + seconds * paper_command(1e3 + 0j, 0j, limits).real
    printed = seconds * math.hypot(limits.max_speed, limits.offset * limits.max_turn_rate)
    assert printed < point <= first + printed


def test_printed_equation_11_lets_saturation_slow_the_slot() -> None:
    away, integral, leader, limits = 10.0, 0.1, 0.2, Limits(0.2, 1.5, 1.5)
    moved = paper_command(complex(away), complex(integral), limits).real - leader
    gain = 1.5 / (2.0 * away + integral)  # s_u of Eq. (8)
    printed = gain * (2.0 * away + integral - leader)
    mended = gain * (2.0 * away + integral - leader / gain)
    assert moved == pytest.approx(mended)
    assert printed - moved == pytest.approx((1.0 - gain) * leader)


def test_paper_law_falls_behind_leader_above_top_speed() -> None:
    limits, away, integral = Limits(0.2, 1.5, 1.5), 0.0, 0.0
    for _ in range(1000):
        moved = paper_command(complex(away), complex(integral), limits).real
        integral += 0.01 * away
        away += 0.01 * (1.6 - moved)
    assert away > 0.99 * 0.1 * 10.0


def test_leader_at_top_speed_is_refused() -> None:
    with pytest.raises(ValidationError, match="must be below robot2's max_speed of 1 m/s"):
        drawn(3, leader_speed=1.0)


@pytest.mark.parametrize("share", [*slow(0.8), 0.95])
def test_all_runs_converge_behind_fast_leader(share: float) -> None:
    route = [{"speed": share * SIX.robots["robot2"].max_speed, "heading_deg": 30.0}]
    changed = {"route": route, "collisions": {"mode": "off", "lag": 0.0}}
    mission = Mission.model_validate({**SIX.model_dump(), **changed})
    assert simulate(mission, runs=60, seed=1, horizon=200.0, options=ALONE).converged.all()


@pytest.mark.parametrize("ramp", [0.5, 1.0])
@pytest.mark.parametrize("name", ["six_robots", "patrol"])
def test_all_runs_converge_with_slow_ramp(name: str, ramp: float) -> None:
    mission = with_robots(name, ramp=ramp)
    assert simulate(mission, runs=40, horizon=20.0, step=0.05, options=ALONE).converged.all()


def test_all_runs_converge_with_short_control_point_offset() -> None:
    robot = {"control_point_offset": 0.05, "max_speed": 1.0, "max_turn_rate": 2.0, "ramp": 1.0}
    route = {"speed": 0.7, "heading_deg": 0.0}
    mission = scenarios.build(np.array([0.0, -0.8, -1.6]), [[], [0], [1]], route, robot=robot)
    assert simulate(mission, runs=40, horizon=40.0, step=0.05, spread=1.0).converged.all()
