"""Robots with `measurement = "scan"`: production agents on a virtual clock, with odometry that drifts."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from functools import cache
from typing import Any

import pytest

from formation.agent.perception.perception import MAX_RECKONING_TIME
from formation.mission.file import MissionError, parse, read
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState, Sight
from formation.ros2.messages import LaserScan, Odometry, decode, encode
from formation.topics import ODOM, SCAN
from formation.wire import Sample
from tests.support.fleet import Fleet, Link
from tests.support.meddling import Meddle, altered
from tests.support.missions import with_keys
from tests.support.seeing import (
    STRAIGHT,
    TRIANGLE,
    Errors,
    believed_error,
    blind,
    carry,
    fleet_of,
    hexagon,
    shape_error,
)

DRIFT = "drift = 0.02"
STANDS = "[[route]]\nspeed = 0.0\nheading_deg = 0"


def worst(fleet: Fleet, seconds: float) -> float:
    """Greatest error of the shape in that time [m]."""
    return max(shape_error(one) for one in fleet.every(0.5, seconds))


def triangle(route: str = STRAIGHT, errors: Errors = Errors(), **keys: Any) -> Fleet:  # noqa: B008 - a constant
    """Three robots: an anchor, one that sees it, and one that sees both."""
    return fleet_of(hexagon(route, errors, robots=TRIANGLE, **keys), errors)


@cache
def _driving_triangle(scanner: str) -> Fleet:
    return triangle(scanner=scanner).after(8.0)


def driving_triangle(scanner: str = "required") -> Fleet:
    """Three robots after 8 s of driving."""
    return _driving_triangle(scanner).copy()


def holds(fleet: Fleet, robot: str, code: Code) -> bool:
    """Whether a robot holds for this reason."""
    decision = fleet.agents[robot].decision
    return decision.state is AgentState.HOLD and decision.reason.code is code


@pytest.mark.parametrize("robots", [TRIANGLE, pytest.param((), marks=pytest.mark.slow)], ids=["three", "six"])
def test_seeing_robots_keep_true_relative_positions(robots: tuple[str, ...]) -> None:
    seeing = fleet_of(hexagon(simulated=DRIFT, robots=robots)).after(20.0)
    assert worst(seeing, 5.0) < 0.03
    assert seeing.states == {AgentState.RUN}


def test_robots_hold_until_scans_show_neighbours() -> None:
    fleet = triangle(errors=Errors(lost=1.0)).after(5.0)
    for robot in ("robot3", "robot7"):
        assert holds(fleet, robot, Code.SIGHT_SEARCHING)
        assert fleet.status(robot).sight is Sight.SEARCHING
        assert set(fleet.commands_since(robot, 0.0)) == {(0.0, 0.0)}
    assert fleet.status("robot2").sight is None  # its only neighbour has no body
    assert "its range scans do not show robot2 yet: 0 of 5 scans" in fleet.message("robot3")


def test_status_reports_sight_of_neighbours() -> None:
    fleet = triangle(STANDS).after(6.0)
    status = fleet.status("robot7")
    assert status.sight is Sight.LOCKED
    assert status.sight_lost == ()
    assert set(status.sight_age) == set(status.sight_deviation) == {"robot2", "robot3"}
    assert max(status.sight_age.values()) < 1.0
    assert 0.0 < max(status.sight_deviation.values()) < 0.05


@pytest.mark.slow
def test_blinded_robot_holds_after_max_reckoning_time() -> None:
    fleet = driving_triangle()
    blind(fleet, "robot7")
    fleet.run(10.0)
    assert fleet.agents["robot7"].decision.state is AgentState.RUN
    assert fleet.status("robot7").sight is Sight.RECKONING
    assert "does not see robot2, robot3: goes on by odometry" in fleet.message("robot7")
    assert shape_error(fleet) < 0.03
    fleet.run(MAX_RECKONING_TIME - 9.0)
    assert holds(fleet, "robot7", Code.SIGHT_LOST)
    assert fleet.last_command("robot7") == (0.0, 0.0)


def test_carried_robot_holds_until_it_finds_neighbours() -> None:
    fleet = driving_triangle()
    carry(fleet, "robot7", 0.15 - 0.4j)
    fleet.run(2.5)
    assert holds(fleet, "robot7", Code.SIGHT_CONTRADICTED)
    while fleet.agents["robot7"].decision.state is not AgentState.RUN:
        assert fleet.driven("robot7", 0.1) < 0.02
        assert fleet.now < 60.0
    assert believed_error(fleet) < 0.03  # it has found its neighbours


def assert_contradicted(fleet: Fleet, robot: str) -> None:
    """Assert that a robot holds within 4 s, stays so, and that its position is not usable."""
    fleet.run(4.0)
    assert holds(fleet, robot, Code.SIGHT_CONTRADICTED)
    assert not fleet.agents[robot].perception.placed(fleet.moment)  # type: ignore[union-attr]
    fleet.run(5.0)
    assert holds(fleet, robot, Code.SIGHT_CONTRADICTED)


def test_robot_carried_far_in_open_hall_holds() -> None:
    fleet = driving_triangle()
    carry(fleet, "robot7", -1.0j)
    assert_contradicted(fleet, "robot7")


def test_carried_robot_that_is_put_back_goes_on() -> None:
    fleet = driving_triangle()
    carry(fleet, "robot7", -1.0j)
    fleet.run(4.0)
    assert "put the robot back in its place" in fleet.message("robot7")
    assert "check the places of robot2" in fleet.message("robot7")
    carry(fleet, "robot7", 1.0j)
    fleet.run(8.0)
    assert fleet.agents["robot7"].decision.state is AgentState.RUN


def test_robot_that_changed_places_with_neighbour_holds() -> None:
    fleet = driving_triangle()
    way = fleet.plant("robot3").position - fleet.plant("robot2").position
    carry(fleet, "robot2", way)
    carry(fleet, "robot3", -way)
    assert_contradicted(fleet, "robot3")


@pytest.mark.slow
def test_robot_with_wrong_odometry_heading_waits_for_operator() -> None:
    """Odometry's heading is 45° off its path for good: each lock is wrong again after half a metre."""
    fleet, robot = driving_triangle(), "robot7"
    turn, key = cmath.rect(1.0, math.radians(45.0)), ODOM.key(robot)
    fleet.meddle = altered(key, Odometry, lambda one: replace(one, heading=one.heading * turn))
    assert fleet.driven(robot, 45.0) < 3.0
    assert holds(fleet, robot, Code.SIGHT_UNRELIABLE)
    assert "check the places of robot2, robot3 too" in fleet.message(robot)
    assert fleet.driven(robot, 10.0) < 0.001
    fleet.meddle = lambda sample: (sample,)
    assert fleet.driven(robot, 10.0) < 0.001
    fleet.ask(robot, "hold")
    fleet.run(1.0)
    fleet.ask(robot, "run")
    assert fleet.driven(robot, 20.0) > 0.5
    assert fleet.agents[robot].decision.state is AgentState.RUN


def turning_odometry(fleet: Fleet, robot: str, rate: float) -> None:
    """From now on heading and path by a robot's odometry turn by `rate` [rad/s] more than they should."""
    last: list[tuple[float, complex, complex]] = []

    def turned(one: Odometry) -> Odometry:
        began, before, placed = last[0] if last else (one.stamp, one.position, one.position)
        turn = cmath.rect(1.0, rate * (one.stamp - began))
        placed += turn * (one.position - before)
        last[:] = [(began, one.position, placed)]
        return replace(one, position=placed, heading=one.heading * turn, turn_rate=one.turn_rate + rate)

    fleet.meddle = altered(ODOM.key(robot), Odometry, turned)


@pytest.mark.slow
def test_contradicted_robot_publishes_no_motion_while_it_stands() -> None:
    """Else it seems to keep up with the one neighbour that it sees, and the others leave it behind."""
    fleet, robot = driving_triangle(), "robot7"
    turning_odometry(fleet, robot, 0.05)
    fleet.run(14.0)
    assert holds(fleet, robot, Code.SIGHT_CONTRADICTED)
    before = fleet.agents[robot].here.state.position
    fleet.run(8.0)
    assert abs(fleet.agents[robot].here.state.position - before) < 0.1
    assert fleet.driven("robot2", 4.0) < 0.2


@pytest.mark.slow
def test_robot_that_takes_neighbour_for_another_holds() -> None:
    """It sees robot2 where robot3 should be, and nothing where robot2 should be."""
    fleet = driving_triangle()
    carry(fleet, "robot7", 1.0 + 0.0j)
    fleet.run(7.0)
    assert holds(fleet, "robot7", Code.SIGHT_CONTRADICTED)
    assert "do not show robot2 where" in fleet.message("robot7")
    assert fleet.driven("robot7", 15.0) < 0.02
    assert not fleet.agents["robot7"].perception.placed(fleet.moment)  # type: ignore[union-attr]


@pytest.mark.slow
def test_robot_with_slow_scanner_soon_holds_beside_another_robot() -> None:
    """One scan a second shows robot2 where robot3 should be, and nothing where robot2 should be."""
    fleet = triangle(scan="rate = 1").after(12.0)
    carry(fleet, "robot7", 1.0 + 0.0j)
    assert fleet.driven("robot7", 9.0) < 1.5
    assert holds(fleet, "robot7", Code.SIGHT_CONTRADICTED)


@pytest.mark.slow
def test_robot_does_not_lock_while_neighbour_is_missing() -> None:
    fleet = triangle(STANDS)
    carry(fleet, "robot7", 1.0 + 0.0j)
    fleet.run(20.0)
    assert holds(fleet, "robot7", Code.SIGHT_CONTRADICTED)
    assert fleet.plant("robot7").path < 0.02


def test_robot_with_blocked_view_continues_by_odometry() -> None:
    fleet = triangle(STANDS).after(6.0)
    ranging = fleet.world._hosted["robot7"].ranging
    assert ranging is not None
    ahead = fleet.plant("robot7").position + 0.4j
    ranging._walls = ((ahead - 0.4, ahead + 0.4),)
    fleet.run(10.0)
    assert fleet.agents["robot7"].decision.state is AgentState.RUN
    assert fleet.status("robot7").sight is Sight.RECKONING


def test_robot_without_sight_soon_stops_being_landmark() -> None:
    fleet = driving_triangle()
    blind(fleet, "robot3")
    fleet.run(0.5)
    assert not fleet.agents["robot7"].neighbours.each["robot3"].state.searching
    fleet.run(3.0)
    assert fleet.status("robot3").sight is Sight.RECKONING
    assert fleet.agents["robot7"].neighbours.each["robot3"].state.searching


def test_carried_robot_is_no_landmark_before_it_holds() -> None:
    fleet = driving_triangle()
    carry(fleet, "robot3", 0.3j)
    fleet.run(0.8)
    assert fleet.agents["robot3"].decision.state is AgentState.RUN
    assert fleet.agents["robot7"].neighbours.each["robot3"].state.searching


def test_slightly_displaced_robot_corrects_its_pose() -> None:
    fleet = driving_triangle()
    carry(fleet, "robot7", 0.03 + 0.05j)
    assert worst(fleet.after(8.0), 2.0) < 0.02


def test_frozen_scan_shows_no_neighbour() -> None:
    fleet = driving_triangle("optional")
    ranging = fleet.world._hosted["robot7"].ranging
    assert ranging is not None
    newest = ranging.scan(0.0)
    ranging.scan = lambda *_: newest  # type: ignore[method-assign]
    fleet.run(5.0)
    assert fleet.status("robot7").scan_fault is not None
    assert fleet.status("robot7").sight is Sight.RECKONING


def test_scans_that_move_pose_far_end_lock() -> None:
    """Odometry's heading is 20° off its path: scans move the pose by 34 cm a metre."""
    fleet, robot = driving_triangle(), "robot7"
    turn, key = cmath.rect(1.0, math.radians(20.0)), ODOM.key(robot)
    fleet.meddle = altered(key, Odometry, lambda one: replace(one, heading=one.heading * turn))
    fleet.run(8.0)
    assert fleet.agents[robot].perception.lost_locks  # type: ignore[union-attr]


@pytest.mark.slow
def test_robot_with_turned_scanner_waits_for_operator() -> None:
    fleet, robot = driving_triangle(), "robot7"
    fleet.meddle = scans_turned(robot, 15.0)
    assert fleet.driven(robot, 40.0) < 3.5
    assert holds(fleet, robot, Code.SIGHT_UNRELIABLE)
    assert "how the scanner is mounted, and that no other robot's scans come" in fleet.message(robot)


@pytest.mark.slow
def test_robots_from_bad_starts_keep_their_locks() -> None:
    errors = Errors(start=0.05, start_deg=3.0)
    fleet = fleet_of(hexagon(errors=errors), errors, seed=1).after(30.0)
    assert fleet.states == {AgentState.RUN}
    assert not any(one.perception.lost_locks for one in fleet.agents.values() if one.perception)


@pytest.mark.slow
def test_posts_of_tower_size_do_not_mislead_pose() -> None:
    posts = "\n".join(
        f"[[simulation.posts]]\nx = {x}\ny = {y}\nradius = 0.035"
        for x, y in ((-0.35, 0.6), (-1.35, 0.55), (-1.0, 1.5), (-0.6, -0.3))
    )
    fleet = triangle(STANDS, tables=posts).after(6.0)
    assert max(believed_error(one) for one in fleet.every(0.5, 10.0)) < 0.03
    assert fleet.status("robot7").sight is Sight.LOCKED


def test_robot_with_late_odometry_and_fast_scanner_locks() -> None:
    fleet = triangle(STANDS, scan="rate = 10")
    fleet.sensors["robot7"] = Link(0.0, (0.15, 0.15))
    fleet.run(8.0)
    assert fleet.status("robot7").sight is Sight.LOCKED
    assert believed_error(fleet) < 0.03


def scans_turned(robot: str, degrees: float) -> Meddle:
    """The scanner of a robot is mounted at another angle than its mission says."""
    turn = math.radians(degrees)
    return altered(SCAN.key(robot), LaserScan, lambda one: replace(one, angle_min=one.angle_min + turn))


def repeat_newest_scan(fleet: Fleet, robot: str) -> None:
    """From now on the scanner of a robot sends its next scan again and again, with new stamps."""
    sent: list[LaserScan] = []

    def repeated(sample: Sample) -> list[Sample]:
        if sample.key != SCAN.key(robot):
            return [sample]
        scan = decode(LaserScan, sample.payload)
        sent.append(scan)
        return [sample._replace(payload=encode(replace(sent[0], stamp=scan.stamp)))]

    fleet.meddle = repeated


@pytest.mark.slow
def test_repeated_scan_is_no_sight_while_robot_stands() -> None:
    fleet = driving_triangle()
    fleet.ask("led", "hold")
    fleet.run(3.0)
    repeat_newest_scan(fleet, "robot7")
    fleet.run(1.0)
    carry(fleet, "robot7", 0.4 + 0.5j)
    fleet.run(3.0)
    assert fleet.status("robot7").sight is Sight.RECKONING
    fleet.run(MAX_RECKONING_TIME)
    fleet.ask("led", "run")
    fleet.run(1.0)
    assert holds(fleet, "robot7", Code.SIGHT_LOST)
    assert "check that the scanner sends new scans" in fleet.message("robot7")


def test_message_names_neighbours_without_position() -> None:
    fleet = triangle()
    blind(fleet, "robot3")
    blind(fleet, "robot7")
    fleet.run(4.0)
    assert "no position to rely on from robot3, see to them first" in fleet.message("robot7")
    assert "no position" not in fleet.message("robot3")


def test_message_names_only_neighbours_out_of_sight() -> None:
    fleet = triangle(STANDS)
    ranging = fleet.world._hosted["robot7"].ranging
    assert ranging is not None
    ranging._walls = ((-1.45 + 0.43j, -1.25 + 0.43j),)  # before robot3
    fleet.run(5.0)
    assert holds(fleet, "robot7", Code.SIGHT_SEARCHING)
    assert "its range scans do not show robot3 yet" in fleet.message("robot7")


def test_landmarks_are_followers_measured_by_scan() -> None:
    mission = hexagon()
    assert mission.landmarks_of("robot2") == ()
    assert mission.landmarks_of("robot3") == ("robot2",)
    assert mission.landmarks_of("robot6") == ("robot4", "robot5")
    assert hexagon(measurement="network").landmarks_of("robot6") == ()


def test_robot_that_searches_is_no_landmark() -> None:
    fleet = driving_triangle()
    blind(fleet, "robot3")
    fleet.agents["robot3"].perception.state.locked = False  # type: ignore[union-attr]
    fleet.run(4.0)
    assert fleet.agents["robot7"].neighbours.each["robot3"].state.searching
    assert fleet.status("robot7").sight_lost == ("robot3",)


@pytest.mark.parametrize("keys", [{}, {"scanner": "optional", "localisation": "external"}])
def test_mission_without_scanner_or_odometry_is_refused(keys: dict[str, str]) -> None:
    with pytest.raises(MissionError, match="measurement"):
        parse(with_keys(read("six_robots")[0], measurement="scan", **keys))
