"""Robots that avoid each other, in the simulation that runs what agents run."""

from __future__ import annotations

import math

import numpy as np
import pytest

from formation.control.avoidance import Avoidance, AvoidanceParameters, Obstacle, avoid
from formation.control.controller import Limits
from formation.control.unicycle import advance, control_point, saturate
from formation.mission.model import Mission
from formation.simulation.body import PROFILES
from formation.simulation.ensemble import Options
from formation.simulation.simulate import Result, simulate
from tests.unit.formation import scenarios

SIX = scenarios.six()
PAIR = scenarios.build(np.array([0, -1 + 0.5j, -1 - 0.5j]), ((), (0,), (0,)))
"""Abreast."""
FILE = scenarios.build(np.array([0, -1, -2, -3 + 0j]), ((), (0,), (1,), (2,)))
"""One behind the other."""
ALONE = Options(avoid=False)


def driven(mission: Mission, options: Options | None = None) -> Result:
    return simulate(mission, horizon=60.0, step=0.05, options=options)


@pytest.mark.parametrize("mission", [PAIR, FILE, SIX], ids=["pair", "file", "six"])
def test_robots_in_exchanged_slots_pass_and_form(mission: Mission) -> None:
    crossing = scenarios.exchanged(mission)
    passed = driven(crossing)
    assert passed.nearest[0] > 0.0
    assert passed.converged.all()


def test_without_the_filter_those_in_a_file_go_through_each_other() -> None:
    assert driven(scenarios.exchanged(FILE), ALONE).nearest[0] < -0.1


def test_crossing_starts_cause_no_touch_and_little_delay() -> None:
    mission = scenarios.clearing(SIX)
    apart, through = (simulate(mission, runs=60, step=0.05, options=one) for one in (Options(), ALONE))
    assert (through.nearest < 0.0).mean() > 0.2
    assert apart.nearest.min() > 0.0
    assert apart.converged.all()
    assert np.median(apart.settling_time) < 1.5 * np.median(through.settling_time)


def test_known_wheel_lag_causes_no_touch() -> None:
    crossing = scenarios.exchanged(SIX, lag=0.1)
    lagging = Options(body=PROFILES["ideal"]._replace(lag=0.1))
    assert driven(crossing, lagging).nearest[0] > 0.0


def test_late_samples_cause_no_touch() -> None:
    assert driven(scenarios.exchanged(SIX), Options(delay=0.15)).nearest[0] > 0.0


def test_without_encounters_results_are_identical() -> None:
    mission = scenarios.clearing(SIX)
    both = [simulate(mission, horizon=10.0, options=one) for one in (Options(), ALONE)]
    assert np.array_equal(both[0].error, both[1].error)


@pytest.mark.parametrize("mode", ["warn", "off"])
def test_warn_and_off_modes_avoid_nothing(mode: str) -> None:
    crossing = scenarios.exchanged(SIX, mode=mode)
    assert np.array_equal(driven(crossing).error, driven(crossing, ALONE).error)


def test_printed_law_avoids_no_robot() -> None:
    crossing = scenarios.exchanged(SIX)
    both = [simulate(crossing, law="paper", horizon=10.0, options=one) for one in (Options(), ALONE)]
    assert np.array_equal(both[0].error, both[1].error)


def test_deadlocks_are_counted() -> None:
    crossing = scenarios.exchanged(FILE)
    assert driven(crossing).deadlocks.sum() == driven(crossing).summary()["deadlocks"]
    assert driven(crossing, ALONE).deadlocks.sum() == 0


@pytest.mark.parametrize("aside", [0.0, 0.02, -0.1])
def test_a_post_in_the_way_is_gone_round(aside: float) -> None:
    body, parameters, post, goal = (
        Limits(0.1, 1.0, 1.5),
        AvoidanceParameters(0.1, 0.02, 0.15),
        complex(1.5, aside),
        3.0 + 0j,
    )
    at, heading, avoidance, nearest = 0j, 1.0 + 0j, Avoidance(), math.inf
    for _ in range(400):
        around = [Obstacle(heading.conjugate() * (post - at), 0.2, 0j, first=True)]
        away = heading.conjugate() * (goal - control_point(at, heading, body.offset))
        wanted = saturate(2.0 * away, body.offset, body.max_speed, body.max_turn_rate)
        command, avoidance = avoid(wanted, around, parameters, body, 0j, avoidance, 0.05)
        at, heading = advance(at, heading, command.speed, command.turn_rate, 0.05)
        nearest = min(nearest, abs(at - post))
    assert nearest > 0.3
    assert control_point(at, heading, body.offset) == pytest.approx(goal, abs=0.01)


def test_robot_nearer_to_the_leader_has_right_of_way() -> None:
    assert FILE.has_right_of_way("robot2", "robot3")
    assert not FILE.has_right_of_way("robot4", "robot3")
    assert PAIR.has_right_of_way("robot2", "robot3")


def test_no_robot_avoids_itself_or_the_virtual_leader() -> None:
    mission = scenarios.clearing(SIX)
    for name in mission.followers:
        assert set(mission.avoided_by(name)) == set(mission.followers) - {name}
    assert mission.avoided_by(mission.leader) == ()
    few = scenarios.clearing(SIX, avoid=("robot6",))
    assert few.avoided_by("robot4") == ("robot2", "robot3", "robot6")
    assert few.avoided_by("robot6") == ("robot4", "robot5")
    assert SIX.avoided_by("robot4") == ()
