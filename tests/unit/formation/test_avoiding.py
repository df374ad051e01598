"""Robots that avoid each other, in simulations with the agents' control step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from formation.control.laws import LAWS
from formation.mission.model import Mission
from formation.simulation.body import PROFILES, Body
from formation.simulation.ensemble import Ensemble, Options, Starts, random_starts
from formation.simulation.simulate import Result, simulate
from formation.stability.analysis import analyse
from tests.support.missions import with_robots
from tests.unit.formation import scenarios

SIX = scenarios.six()
PAIR = scenarios.build(np.array([0, -1 + 0.5j, -1 - 0.5j]), ((), (0,), (0,)))
"""Two followers abreast."""
FILE = scenarios.build(np.array([0, -1, -2, -3 + 0j]), ((), (0,), (1,), (2,)))
"""Three followers, one behind the other."""
ALONE = Options(avoid=False)


def driven(mission: Mission, options: Options | None = None) -> Result:
    return simulate(mission, horizon=60.0, step=0.05, options=options)


@pytest.mark.parametrize("mission", [PAIR, FILE, SIX], ids=["pair", "file", "six"])
def test_robots_in_exchanged_slots_pass_and_converge(mission: Mission) -> None:
    crossing = scenarios.exchanged(mission)
    passed = driven(crossing)
    assert passed.nearest[0] > 0.0
    assert passed.converged.all()


def test_crossing_starts_cause_no_touch_and_little_delay() -> None:
    mission = scenarios.clearing(SIX)
    apart, through = (simulate(mission, runs=60, step=0.05, options=one) for one in (Options(), ALONE))
    assert (through.nearest < 0.0).mean() > 0.2
    assert apart.nearest.min() > 0.0
    assert apart.converged.all()
    assert np.median(apart.settling_time) < 1.5 * np.median(through.settling_time)


@pytest.mark.parametrize(
    ("known", "options"),
    [
        ({"lag": 0.1}, Options(body=PROFILES["ideal"]._replace(lag=0.1))),
        ({}, Options(delay=0.15)),
    ],
    ids=["lag", "delay"],
)
def test_lagging_wheels_and_late_samples_cause_no_touch(known: dict[str, float], options: Options) -> None:
    assert driven(scenarios.exchanged(SIX, **known), options).nearest[0] > 0.0


def test_filter_changes_nothing_without_encounters() -> None:
    mission = scenarios.clearing(SIX)
    filtered, through = (simulate(mission, horizon=10.0, options=one) for one in (Options(), ALONE))
    assert np.array_equal(filtered.error, through.error)


@pytest.mark.parametrize("mode", ["warn", "off"])
def test_warn_and_off_modes_avoid_nothing(mode: str) -> None:
    crossing = scenarios.exchanged(SIX, mode=mode)
    assert np.array_equal(driven(crossing).error, driven(crossing, ALONE).error)


@pytest.mark.slow
def test_paper_law_avoids_no_robot() -> None:
    crossing = scenarios.exchanged(SIX)
    one, other = (simulate(crossing, law="paper", horizon=10.0, options=by) for by in (Options(), ALONE))
    assert np.array_equal(one.error, other.error)


def test_summary_adds_up_deadlocks_of_runs() -> None:
    result = driven(scenarios.exchanged(FILE), ALONE)
    assert result.summary()["deadlocks"] == 0
    assert replace(result, deadlocks=np.array([2, 1])).summary()["deadlocks"] == 3


def test_robot_nearer_to_the_leader_has_right_of_way() -> None:
    assert FILE.has_right_of_way("robot2", "robot3")
    assert not FILE.has_right_of_way("robot4", "robot3")
    assert PAIR.has_right_of_way("robot2", "robot3")


def test_avoided_by_excludes_itself_and_virtual_leader() -> None:
    mission = scenarios.clearing(SIX)
    for name in mission.followers:
        assert set(mission.avoided_by(name)) == set(mission.followers) - {name}
    assert mission.avoided_by(mission.leader) == ()
    few = scenarios.clearing(SIX, avoid=("robot6",))
    assert few.avoided_by("robot4") == ("robot2", "robot3", "robot6")
    assert few.avoided_by("robot6") == ("robot4", "robot5")
    assert SIX.avoided_by("robot4") == ()


def test_avoided_robots_are_found_once() -> None:
    """`formation check` asks for them some hundred times for each pair of 200 robots."""
    mission = scenarios.clearing(SIX)
    assert mission.avoided_by("robot4") is mission.avoided_by("robot4")


HORIZON, STEP = 60.0, 0.02
"""[s]"""
LATE, SHAKEN = (9, 83, 206, 298, 349, 383), (9, 37, 74, 83, 98, 157)
"""Starts of 400 from which a robot did not arrive: with 100 ms of delay; with 2 mm of noise besides."""


@pytest.mark.parametrize(("noise", "delay", "chosen"), [(0.0, 0.1, LATE), (0.002, 0.1, SHAKEN)])
def test_all_robots_arrive_from_starts_that_once_failed(
    noise: float, delay: float, chosen: tuple[int, ...]
) -> None:
    mission = with_robots("six_robots", avoid="all")
    starts = random_starts(mission, 400, mission.simulation.spread, _draw(0))
    some = Starts(starts.position[list(chosen)], starts.heading[list(chosen)])
    assert_all_arrive(mission, some, noise, delay)


@pytest.mark.parametrize("robots", [3, 4, 6, 8])
@pytest.mark.parametrize("delay", [0.0, 0.1, 0.2])
def test_robots_that_start_opposite_to_their_slots_all_arrive(robots: int, delay: float) -> None:
    mission = scenarios.opposite(robots)
    for noise in (0.0, 0.002):
        options = Options(delay=delay, body=Body.of(mission.simulated_robot)._replace(position_noise=noise))
        result = simulate(mission, runs=3, step=0.05, horizon=75.0, options=options, starts="mission")
        assert result.converged.all()
        assert result.nearest.min() > 0.0


SWINGING = (24, 148, 151, 163)
"""Starts of 1000 from which a robot goes to and fro behind one that is in its slot already."""


def test_robot_swinging_behind_another_takes_detour_within_ten_seconds() -> None:
    route = ({"speed": 0.5, "heading_deg": 30.0},)
    mission = Mission.model_validate({**with_robots("six_robots").model_dump(), "route": route})
    starts = random_starts(mission, 1000, mission.simulation.spread, _draw(0))
    some = Starts(starts.position[list(SWINGING)], starts.heading[list(SWINGING)])
    steps = round(25.0 / STEP)
    runs = Ensemble(mission, LAWS["field"], Options(), some, STEP, _draw(1), steps, steps)
    runs.run_on(steps)
    assert runs.error.max() < mission.settled


def test_two_robots_starting_1_cm_apart_reach_slots() -> None:
    """With 1 cm between their bodies; with 4 mm they block each other, and `check` warns of it."""
    mission = scenarios.ramped(close_by(0.01), 0.0)
    places = [mission.robots[name].start for name in mission.followers]
    starts = Starts(np.array([[one.position for one in places]]), np.array([[one.heading for one in places]]))
    assert_all_arrive(mission, starts, 1e-4, 0.05)


@pytest.mark.parametrize(("gap", "warned"), [(0.004, True), (0.2, False)])
def test_check_warns_of_starts_too_close(gap: float, warned: bool) -> None:
    result = [one for one in analyse(close_by(gap)).warnings if "between their bodies" in one]
    assert len(result) == warned


def close_by(gap: float) -> Mission:
    """The TurtleBot pair side by side, with `gap` [m] between their bodies."""
    result = with_robots("turtlebot3_pair", avoid="all").model_dump()
    for name, side in (("robot1", 1.0), ("robot2", -1.0)):
        result["robots"][name]["start"] = {"x": -0.8, "y": side * (0.105 + 0.5 * gap), "heading_deg": 0.0}
    return Mission.model_validate(result)


def assert_all_arrive(mission: Mission, starts: Starts, noise: float, delay: float) -> None:
    """Assert that in every run all robots arrive and no bodies touch."""
    step = mission.simulation.step
    steps = round(HORIZON / step)
    options = Options(delay=delay, body=Body.of(mission.simulated_robot)._replace(position_noise=noise))
    runs = Ensemble(mission, LAWS["field"], options, starts, step, _draw(1), steps, steps)
    runs.run_on(steps)
    assert runs.error.max() < 1.0
    assert runs.nearest.min() > 0.0


def _draw(child: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(0).spawn(2)[child])
