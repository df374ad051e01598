"""Whether slots leave room for the margin that the collision filter keeps, as `formation check` says it."""

from __future__ import annotations

import numpy as np
import pytest

from formation.avoidance import LAG, Manners, Obstacle, brake, give_way
from formation.mission import Mission
from formation.mission_file import load, shipped
from formation.simulation.simulate import simulate
from formation.stability.analysis import analyse
from formation.stability.crowding import problems, rooms_of, warnings
from formation.unicycle import Command
from tests.formation import scenarios

SIX = load("six_robots")


@pytest.mark.parametrize("margin", [0.74339, 0.7433, 0.02])
def test_slots_have_room_for_a_margin_that_is_less_than_what_they_leave(margin: float) -> None:
    assert list(problems(scenarios.clearing(SIX, margin=margin))) == []


@pytest.mark.parametrize(
    ("margin", "others"), [(0.75, " (and 3 other pairs)"), (0.9, " (and 10 other pairs)")]
)
def test_a_margin_that_slots_have_no_room_for_is_a_problem_that_names_the_greatest(
    margin: float, others: str
) -> None:
    crowded = scenarios.clearing(SIX, margin=margin)
    (said,) = problems(crowded)
    assert said == (
        f"collisions.margin = {margin:g} m: too much for the slots of robot2 and robot3 in wedge{others}, "
        "0.943 m apart; must be below 0.7433 m"
    )
    assert said in analyse(crowded).problems
    assert said not in analyse(crowded, "paper").problems


def test_a_margin_that_is_just_what_slots_leave_is_too_much_however_they_are_rounded() -> None:
    for side in np.arange(0.3, 2.0, 0.01).round(3).tolist():
        slots = np.array([0, -side + 0.1j, -side + 0.1j + side * 1j])
        apart = scenarios.build(slots, ((), (0,), (1,)))
        (said,) = problems(scenarios.clearing(apart, margin=round(side - 0.2, 3)))
        assert said.endswith(f"must be below {round(side - 0.2, 3):g} m")
        assert list(problems(scenarios.clearing(apart, margin=round(side - 0.201, 3)))) == []


@pytest.mark.parametrize("mode", ["off", "warn"])
def test_a_margin_that_nobody_keeps_needs_no_room(mode: str) -> None:
    assert list(problems(scenarios.clearing(SIX, margin=5.0, mode=mode))) == []


def test_a_margin_needs_no_room_where_neither_minds_the_other() -> None:
    alone = scenarios.build(np.array([0, -1, -2, -3 + 0j]), ((), (0,), (0,), (0,)))
    assert list(problems(scenarios.clearing(alone, mind=(), margin=5.0))) == []
    chain = scenarios.build(np.array([0, -1, -2, -3 + 0j]), ((), (0,), (1,), (2,)))
    assert list(problems(scenarios.clearing(chain, mind=(), margin=0.8))) != []


@pytest.mark.parametrize("name", shipped())
def test_up_to_the_room_that_is_said_the_filter_lets_each_go_straight_on_and_beyond_it_does_not(
    name: str,
) -> None:
    mission = load(name)
    for shape in mission.shapes:
        for room in rooms_of(mission, shape):
            pair = shape, room.first, room.second
            assert goes_straight_on(mission, *pair, room.margin - 1e-6)
            assert not goes_straight_on(mission, *pair, room.margin + 1e-6)


def goes_straight_on(mission: Mission, shape: str, name: str, other: str, margin: float) -> bool:
    """Whether the filter leaves a command alone that follows the leader, beside one other robot."""
    me, spec, speed = mission.robots[name], mission.robots[other], max(leg.speed for leg in mission.route)
    turn = 1.0 if mission.turning else mission.leader_heading.conjugate()
    away = turn * (mission.slot(other, shape) - mission.slot(name, shape))
    radius = spec.radius
    if me.measurement == "local":
        away, radius = away + me.control_point_offset, radius + spec.control_point_offset
    late = 0.0 if me.measurement == "local" else mission.collisions.delay
    there = [Obstacle(away, radius, speed + 0j, mission.has_right_of_way(other, name), age=late)]
    manners = Manners(me.radius, margin, me.longest_command + LAG * mission.collisions.lag)
    wanted = Command(speed, 0.0)
    return give_way(wanted, there, manners, me.limits) == wanted == brake(wanted, there, manners)


@pytest.mark.parametrize(("margin", "well"), [(0.55, True), (0.65, False)])
def test_whom_the_filter_keeps_off_a_slot_is_warned_of_and_the_formation_never_forms(
    margin: float, *, well: bool
) -> None:
    hexagon = {**SIX.model_dump(), "shapes": {"hexagon": SIX.model_dump()["shapes"]["hexagon"]}}
    mission = scenarios.clearing(Mission.model_validate(hexagon), margin=margin, lag=0.05, delay=0.0)
    assert list(problems(mission)) == []
    assert (list(warnings(mission)) == []) is well
    assert simulate(mission, runs=100).converged.mean() == (1.0 if well else 0.0)


def test_such_a_warning_names_the_robot_its_slot_and_the_greatest_margin() -> None:
    (said,) = warnings(scenarios.clearing(SIX, margin=0.6, lag=0.05, delay=0.0))
    assert said == (
        "collisions.margin = 0.6 m: the filter keeps robot5 off its slot in wedge, 0.943 m from robot6's; "
        "should be at most 0.5184 m"
    )
    assert said in analyse(scenarios.clearing(SIX, margin=0.6, lag=0.05, delay=0.0)).warnings
    tight = scenarios.build(np.array([0, -0.3, -0.6, -0.9 + 0j]), ((), (0,), (1,), (2,)))
    (said,) = warnings(scenarios.clearing(tight))
    assert said.endswith("slots should be further apart")


def test_warning_counts_stated_delay_and_noise() -> None:
    assert list(warnings(scenarios.clearing(SIX, margin=0.45, lag=0.05, delay=0.0))) == []
    assert list(warnings(scenarios.clearing(SIX, margin=0.45, lag=0.05, delay=0.5))) != []
    (said,) = problems(
        scenarios.clearing(scenarios.build(np.array([0, -0.25, -0.5 + 0j]), ((), (0,), (1,))), noise=0.02)
    )
    assert said.startswith("collisions.noise = 0.02 m, which takes a margin of 0.113 m")
