"""Checks of the room between slots for the filter's margin, and of robots that could meet."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.avoidance import AvoidanceParameters, Moving, Obstacle, brake, give_way
from formation.control.unicycle import Command
from formation.mission.file import load, shipped
from formation.mission.model import Mission
from formation.simulation.simulate import simulate
from formation.stability import crowding
from formation.stability.analysis import analyse
from formation.stability.crowding import (
    Segment,
    between,
    could_meet,
    problems,
    rooms_of,
    rows,
    unavoided,
    warnings,
)  # fmt: skip
from tests.unit.formation import scenarios
from tests.unit.formation.planar import vectors

SIX = load("six_robots")


FILE = scenarios.build(np.array([0, -1, -2, -3 + 0j]), ((), (0,), (1,), (2,)))
"""Three followers, one behind the other; each measures the one before it."""
ALONE = scenarios.build(np.array([0, -1, -2, -3 + 0j]), ((), (0,), (0,), (0,)))
"""The same slots; all followers measure only the leader."""


@pytest.mark.parametrize(
    "mission",
    [
        *(scenarios.clearing(SIX, margin=margin) for margin in (0.74339, 0.7433, 0.02)),
        *(scenarios.clearing(SIX, margin=5.0, mode=mode) for mode in ("off", "warn")),
        scenarios.clearing(ALONE, avoid=(), margin=5.0),
    ],
)
def test_margin_below_slot_room_or_unused_is_accepted(mission: Mission) -> None:
    assert list(problems(mission)) == []


def test_margin_is_checked_where_only_one_robot_avoids() -> None:
    assert list(problems(scenarios.clearing(FILE, avoid=(), margin=0.8))) != []


@pytest.mark.usefixtures("paper_law_not_simulated")
@pytest.mark.parametrize(
    ("margin", "others"), [(0.75, " (and 3 other pairs)"), (0.9, " (and 10 other pairs)")]
)
def test_problem_of_margin_beyond_room_names_greatest_allowed(margin: float, others: str) -> None:
    crowded = scenarios.clearing(SIX, margin=margin)
    (result,) = problems(crowded)
    assert result == (
        f"collisions.margin = {margin:g} m: too much for the slots of robot2 and robot3 in wedge{others}, "
        "0.943 m apart; must be below 0.7433 m"
    )
    assert result in analyse(crowded).problems
    assert result not in analyse(crowded.under("paper")).problems


def test_margin_equal_to_slot_room_is_refused() -> None:
    for side in np.arange(0.3, 2.0, 0.01).round(3).tolist():
        slots = np.array([0, -side + 0.1j, -side + 0.1j + side * 1j])
        apart = scenarios.build(slots, ((), (0,), (1,)))
        (result,) = problems(scenarios.clearing(apart, margin=round(side - 0.2, 3)))
        assert result.endswith(f"must be below {round(side - 0.2, 3):g} m")
        assert list(problems(scenarios.clearing(apart, margin=round(side - 0.201, 3)))) == []


@pytest.mark.parametrize("name", shipped())
def test_filter_passes_straight_motion_exactly_up_to_room(name: str) -> None:
    mission = load(name)
    for shape in mission.shapes:
        for room in rooms_of(mission, shape):
            pair = shape, room.first, room.second
            assert keeps_command(mission, *pair, room.margin - 1e-6)
            assert not keeps_command(mission, *pair, room.margin + 1e-6)


def keeps_command(mission: Mission, shape: str, name: str, other: str, margin: float) -> bool:
    """Whether the filter keeps the command that follows the leader, beside one other robot."""
    me, spec, speed = mission.robots[name], mission.robots[other], max(leg.speed for leg in mission.route)
    turn = 1.0 if mission.turning else mission.leader_heading.conjugate()
    away, radius = turn * (mission.slot(other, shape) - mission.slot(name, shape)), spec.radius
    late = mission.collisions.delay
    if me.measurement == "local":
        away, radius, late = away + me.control_point_offset, radius + spec.control_point_offset, 0.0
    there = [Obstacle(away, radius, speed + 0j, mission.has_right_of_way(other, name), age=late)]
    hold, lag = me.longest_command, mission.collisions.lag
    parameters = AvoidanceParameters(me.radius, margin, hold, lag=lag)
    wanted, moving = Command(speed, 0.0), Moving(speed, speed)
    given = give_way(wanted, there, parameters, me.limits)
    return given == wanted == brake(wanted, there, parameters, moving)


@pytest.mark.slow
@pytest.mark.parametrize(("margin", "well"), [(0.55, True), (0.65, False)])
def test_robots_converge_exactly_if_margin_causes_no_warning(margin: float, *, well: bool) -> None:
    hexagon = SIX.changed(shapes={"hexagon": SIX.shapes["hexagon"]})
    mission = scenarios.clearing(hexagon, margin=margin, lag=0.05, delay=0.0)
    assert list(problems(mission)) == []
    assert (list(warnings(mission)) == []) is well
    assert simulate(scenarios.ramped(mission, 0.0), runs=100).converged.mean() == (1.0 if well else 0.0)
    # with a ramp, robots in a crowd make room more slowly
    with_ramp = simulate(mission, runs=100).converged.mean()
    assert with_ramp > 0.95 if well else with_ramp == 0.0


def crowded(margin: float, delay: float = 0.0) -> Mission:
    return scenarios.clearing(SIX, margin=margin, lag=0.05, delay=delay)


def test_warning_names_robot_slot_and_greatest_margin() -> None:
    (result,) = warnings(crowded(0.6))
    assert result == (
        "collisions.margin = 0.6 m: the filter keeps robot5 off its slot in wedge, 0.943 m from robot6's, "
        "behind a leader at 0.2 m/s; "
        "should be at most 0.5184 m"
    )
    assert result in analyse(crowded(0.6)).warnings
    tight = scenarios.build(np.array([0, -0.3, -0.6, -0.9 + 0j]), ((), (0,), (1,), (2,)))
    (result,) = warnings(scenarios.clearing(tight))
    assert result.endswith("place slots further apart, or slow the leader")


def test_warning_counts_stated_delay_and_noise() -> None:
    assert list(warnings(crowded(0.45))) == []
    assert list(warnings(crowded(0.45, delay=0.5))) != []
    tight = scenarios.build(np.array([0, -0.25, -0.5 + 0j]), ((), (0,), (1,)))
    (result,) = problems(scenarios.clearing(tight, noise=0.02))
    assert result.startswith("collisions.noise = 0.02 m, which takes a margin of 0.113 m")


segments = st.builds(Segment, vectors, vectors)


@given(segments, segments, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_between_never_exceeds_distance_of_two_points(
    one: Segment, other: Segment, here: float, there: float
) -> None:
    first = one.begin + here * (one.end - one.begin)
    second = other.begin + there * (other.end - other.begin)
    assert between(one, other) <= abs(first - second) + 1e-9


@pytest.mark.parametrize(
    ("one", "other", "distance"),
    [
        (Segment(-1 + 0j, 1 + 0j), Segment(-1j, 1j), 0.0),
        (Segment(0j, 1 + 0j), Segment(2 + 1j, 2 - 1j), 1.0),
        (Segment(0j, 1 + 0j), Segment(0.5j, 1 + 0.5j), 0.5),
        (Segment(0j, 0j), Segment(3 + 4j, 3 + 4j), 5.0),
    ],
)
def test_between_returns_distance_of_two_segments(one: Segment, other: Segment, distance: float) -> None:
    assert between(one, other) == pytest.approx(distance)


@pytest.mark.usefixtures("paper_law_not_simulated")
def test_check_warns_of_crossing_paths_without_avoidance() -> None:
    crossing = scenarios.exchanged(FILE, avoid=())
    assert unavoided(crossing) == (("robot2", "robot3"), ("robot2", "robot4"), ("robot3", "robot4"))
    (result,) = could_meet(crossing)
    assert result.startswith("robot2 and robot3 (and 2 other pairs) could meet")
    assert result in analyse(crossing).warnings
    assert result not in analyse(crossing.under("paper")).warnings


@pytest.mark.parametrize(
    "mission",
    [
        scenarios.exchanged(FILE),
        scenarios.exchanged(FILE, avoid=(), mode="off"),
        scenarios.clearing(FILE, avoid=()),  # robots stay at their starts
    ],
    ids=["avoiding", "off", "in slots"],
)
def test_robots_that_avoid_or_cannot_meet_cause_no_warning(mission: Mission) -> None:
    assert unavoided(mission) == ()


@pytest.mark.usefixtures("paper_law_not_simulated")
def test_analysis_warns_that_paper_law_has_no_filter() -> None:
    result = "the paper law has no collision filter: robots do not avoid each other"
    assert result in analyse(SIX.under("paper")).warnings
    assert result not in analyse(SIX).warnings
    assert scenarios.six().collisions.mode == "off"
    assert result not in analyse(scenarios.six().under("paper")).warnings


SCANNING = {"control_point_offset": 0.1, "scanner": "required", "scan": {"margin": 0.05}}


@pytest.mark.parametrize(
    ("robot", "avoid", "needed"), [({"control_point_offset": 0.2}, "all", 0.64), (SCANNING, (), 0.76)]
)
def test_check_warns_of_rows_too_narrow_to_pass(robot: dict[str, Any], avoid: object, needed: float) -> None:
    """Bodies of 0.1 m with the front 0.1 m ahead keep margins of 2 cm.

    Scanners keep 5 cm, and their circles around hits reach up to 3 cm too far.
    """

    def row(spacing: float, **collisions: Any) -> Mission:
        slots = np.array([0, *(-1 + spacing * k * 1j for k in range(4))])
        return scenarios.clearing(scenarios.build(slots, ((), *[(0,)] * 4), robot=robot), avoid, **collisions)

    narrow = row(needed - 0.001)
    (warning,) = rows(narrow)
    assert f"{needed - 0.001:g} m apart" in warning
    assert f"at least {needed:g} m apart" in warning
    assert warning in analyse(narrow).warnings
    assert list(rows(row(needed + 0.001))) == list(rows(row(needed - 0.001, mode="off"))) == []


def test_only_slots_within_reach_are_searched_for_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each pair of 200 slots, for each robot, took six minutes."""
    slots = np.array([0, *(-1 + 1j * k for k in range(30))])
    mission = scenarios.build(slots, ((), *[(0,)] * 30), robot=SCANNING)
    widths = 0

    def counted(*arguments: Any) -> float:
        nonlocal widths
        widths += 1
        return width(*arguments)

    width = crowding._width
    monkeypatch.setattr(crowding, "_width", counted)
    assert list(rows(scenarios.clearing(mission, ()))) == []
    assert widths <= 2 * 30


ABREAST = scenarios.clearing(scenarios.build(np.array([0, -1, -1 + 0.5j]), ((), (0,), (0,))))
"""Two slots without a third robot."""


@pytest.mark.parametrize("mission", [ABREAST, *map(load, shipped())], ids=["abreast", *shipped()])
def test_wide_enough_missions_cause_no_row_warning(mission: Mission) -> None:
    assert list(rows(mission)) == []
