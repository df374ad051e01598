"""Doubtful range scans: late, frozen, empty, blind at short range, or placed by wrong odometry."""

from __future__ import annotations

import cmath
import dataclasses
import math
from collections.abc import Callable, Iterable
from typing import Any

import pytest

from formation.agent.safety.scanner import LONGEST_SWEEP, Scanner
from formation.control.unicycle import AT_REST, Command
from formation.protocol.reasons import Code, Reason
from formation.ros2.messages import LaserScan, Odometry, decode, encode
from formation.sensing.raycast import Scanner as Device
from formation.topics import ODOM, SCAN
from formation.wire import Sample
from tests.support.examples import slow
from tests.support.fleet import Fleet, at
from tests.support.meddling import altered, on
from tests.support.missions import team
from tests.unit.agent.scanned import Robot, mission, post, scan, scanner_after
from tests.unit.agent.test_scanning import ACROSS, ALONE, among, least_gap, with_mode

WALL = [(2.0 - 30j, 2.0 + 30j)]
KEY, OWN = SCAN.key("robot1"), ODOM.key("robot1")


def before_a_wall(scanner: str, seconds: float) -> Fleet:
    """A robot that drives at a wall without collision filter: only its protective zone can stop it."""
    return Fleet.under_way(with_mode(among(team(ALONE, None, scanner=scanner), ACROSS), "off"), seconds)


def once_wrong(speed: float, lost: int) -> Callable[[Sample], Iterable[Sample]]:
    """Put that speed [m/s] into one odometry message, and lose the next `lost` scans."""
    left = {OWN: 1, KEY: lost}

    def meddle(sample: Sample) -> Iterable[Sample]:
        if not left.get(sample.key) or (sample.key == KEY and left[OWN]):
            return (sample,)
        left[sample.key] -= 1
        if sample.key == KEY:
            return ()
        wrong = dataclasses.replace(decode(Odometry, sample.payload), speed=speed)
        return (sample._replace(payload=encode(wrong)),)

    return meddle


@pytest.mark.parametrize(
    ("scanner", "lost"),
    [
        ("required", 0),
        ("optional", 2),
        *slow(("required", 1), ("required", 2), ("optional", 0), ("optional", 1)),
    ],
)
@pytest.mark.parametrize("speed", [6.0, -6.0, 20.0])
def test_impossible_odometry_speed_does_not_hide_wall(speed: float, lost: int, scanner: str) -> None:
    fleet = before_a_wall(scanner, 14.0)
    fleet.meddle = once_wrong(speed, lost)
    assert least_gap(fleet, 4.0) > 0.0


def test_impossible_odometry_speed_holds_robot_that_requires_scan() -> None:
    fleet = Fleet(team(ALONE, scanner="required")).after(6.0)
    fleet.meddle = once_wrong(6.0, 1)
    fleet.run(0.1)
    assert fleet.commands["robot1"][-1][1:] == AT_REST
    assert str(fleet.agents["robot1"].decision.reason) == (
        "range scan cannot be placed by odometry that said 6 m/s, 0 rad/s"
    )
    fleet.run(6.0)  # the speed contradicts the positions as well: the robot probes before it resumes
    assert fleet.status("robot1").state == "run"


def test_impossible_turn_rate_does_not_move_scan_points() -> None:
    scanner = scanner_after(post(1.0))
    scanner.moved(0.05, Command(0.0, 60.0))
    (circle,) = scanner.strangers(at(0.1), [])
    assert circle.at == pytest.approx(1.0)
    assert scanner.doubt == Reason.of(Code.SCAN_UNPLACED, speed=0.0, turn_rate=60.0)


@pytest.mark.parametrize("speed", [1.5, *slow(0.5, 1.0)])
@pytest.mark.parametrize(("rate", "missing"), [(0.5, 2), (0.5, 3), (0.6, 3), (1.0, 4)])
def test_lost_scan_of_slow_scanner_causes_no_collision(speed: float, rate: float, missing: int) -> None:
    for distance in (3.5, 5.0, 6.5):
        robot = Robot(
            walls=[(distance - 30j, distance + 30j)], rate=rate, missing=[missing - 1], range_max=8.0
        )
        robot.drive(Command(speed, 0.0), 20.0)
        assert robot.nearest > 0.0


def test_motion_history_is_limited_to_needed_duration() -> None:
    for rate in (0.5, 5.0):
        scanner = Scanner(mission(scan=f", rate = {rate}"), "robot2")
        for tick in range(2000):
            scanner.moved(0.05 * tick, Command(0.1, 0.0))
        longest = scanner.stream.limit + scanner.stream.longest_delay + LONGEST_SWEEP
        assert 0.0 <= len(scanner.state.moves) - longest / 0.05 <= 3.0


@pytest.mark.parametrize("scanner", ["required", "optional"])
@pytest.mark.parametrize("way", [0.5, 0.7, *slow(1.0)])
def test_late_scans_never_let_robot_touch_wall(way: float, scanner: str) -> None:
    fleet = before_a_wall(scanner, 0.0)
    fleet.meddle = on(KEY, lambda sample: (sample._replace(arrived=sample.arrived + way),))
    assert least_gap(fleet, 14.0) > 0.0
    result = fleet.status("robot1")
    if scanner == "optional":
        assert (result.state, result.scan_fault is not None) == ("run", way > 0.6)
    elif way > 0.6:
        assert result.state == "hold"
        assert str(result.reason) == f"range scan stamped {way:.2f} s before it came, must be 0.6 s at most"
        assert result.clock["scan"] == pytest.approx(way, abs=0.05)
        assert "stamps of scan not believed" in fleet.message("robot1")


def test_scan_stamped_in_the_future_is_doubted() -> None:
    scanner = Scanner(mission(), "robot2")
    scanner.process_scan(scan(1.05, post(1.0)), 1.0, at(1.0))
    assert scanner.doubt is None
    scanner.process_scan(scan(1.5, post(1.0)), 1.2, at(1.2))
    assert str(scanner.doubt) == "range scan stamped 0.30 s after it came, must be 0.1 s at most"


@pytest.mark.parametrize("speed", [0.2, 0.5])
def test_obstacle_inside_scanner_blind_range_is_not_hit(speed: float) -> None:
    for ahead in (0.45, 1.2):
        robot = Robot([(ahead + 0j, 0.1)], range_min=0.5, too_near=-math.inf)
        robot.drive(Command(speed, 0.0), 12.0)
        assert robot.nearest > 0.0


@pytest.mark.parametrize("seed", range(4))
def test_thin_post_behind_burger_is_not_hit(seed: int) -> None:
    """An LDS-01 behind the axle cannot measure nearer than the margin of a robot of 0.1 m."""
    robot = Robot([(-0.8 + 0j, 0.01)], behind=0.032, lost=0.1)
    robot.rng.seed(seed)
    robot.drive(Command(-0.2, 0.0), 30.0)
    assert robot.nearest > 0.05


@pytest.mark.parametrize(
    ("range_min", "where", "blind"),
    [(0.12, "", False), (0.15, "", False), (0.16, "", True), (0.12, ", x = -0.032", False), (0.5, "", True)],
)
def test_scanner_blind_beyond_body_and_margin_is_doubted(range_min: float, where: str, blind: bool) -> None:
    scanner = Scanner(mission(scan=where), "robot2")
    result = scan(0.0, post(1.0), device=Device(range_min=range_min))
    scanner.process_scan(decode(LaserScan, encode(result)), 0.0, at(0.0))
    wants = f"range scan has range_min {range_min:g} m: this robot needs at most 0.15 m"
    assert str(scanner.doubt) == (wants if blind else "None")


@pytest.mark.parametrize(("scanner", "state"), [("required", "hold"), ("optional", "run")])
def test_blind_scanner_holds_if_required_and_warns_otherwise(scanner: str, state: str) -> None:
    fleet = Fleet(team(ALONE, scanner=scanner))
    fleet.meddle = altered(KEY, LaserScan, lambda seen: dataclasses.replace(seen, range_min=0.5))
    fleet.run(3.0)
    assert fleet.status("robot1").state == state
    message = fleet.message("robot1")
    assert message.count("range scan has range_min 0.5 m: this robot needs at most 0.15 m") == 1


@pytest.mark.parametrize("turn", [1.0, -1.0])
@pytest.mark.parametrize("newest_first", [False, True])
@pytest.mark.parametrize("stamped", ["first", "last"])
def test_sweep_is_compensated_for_any_stamp_and_direction(
    stamped: str, newest_first: bool, turn: float
) -> None:
    """The robot turns on the spot, and the scanner sees a post with a single beam."""
    sweep = 0.2
    for beam in range(0, 360, 15):
        scanner = Scanner(mission(scan=f", sweep = {-sweep if newest_first else sweep}"), "robot2")
        for tick in range(13):
            scanner.moved(0.05 * tick, Command(0.0, turn))
        ranges = [math.inf] * 360
        ranges[beam] = 1.0
        done, seen = 0.6, 0.6 - sweep * (beam / 359 if newest_first else 1.0 - beam / 359)
        stamp = done - sweep if stamped == "first" else done
        scanner.process_scan(scan(stamp, ranges), done + 0.002, at(done + 0.002))
        (circle,) = scanner.strangers(at(0.65), [])
        there = cmath.rect(1.0, math.radians(beam) - turn * (0.65 - seen))
        assert abs(cmath.phase(circle.at / there)) < 0.03


def repeat(
    scanner: Scanner, ranges: list[float], seconds: float, moving: Command, since: float = 0.0
) -> None:
    """Give the scanner the same scan repeatedly while the robot moves."""
    for number in range(round(5.0 * seconds)):
        moment = since + 0.2 * number
        scanner.moved(moment, moving)
        scanner.process_scan(scan(moment, ranges), moment, at(moment))


FEW, MANY = [1.0, 1.01, 1.02] + [math.inf] * 357, [1.0 + 0.01 * n for n in range(40)] + [math.inf] * 320


@pytest.mark.parametrize("moving", [Command(0.2, 0.0), Command(0.0, 0.5), Command(-0.2, 0.1)])
def test_repeated_scan_is_doubted_while_robot_moves(moving: Command) -> None:
    scanner = Scanner(mission(), "robot2")
    repeat(scanner, MANY, 0.4, moving)
    assert str(scanner.doubt).startswith("range scan frozen: the same for 0.2 s, while the robot moved")
    assert not scanner.fresh(at(0.2))
    scanner.process_scan(scan(0.4, [1.2, *MANY[1:]]), 0.4, at(0.4))
    assert scanner.doubt is None
    assert scanner.fresh(at(0.4))


@pytest.mark.parametrize(
    ("ranges", "moving"),
    [(MANY, AT_REST), (MANY, Command(0.002, 0.0)), ([math.inf] * 360, Command(0.2, 0.3))],
)
def test_repeated_scan_is_believed_at_rest_and_without_hits(ranges: list[float], moving: Command) -> None:
    scanner = Scanner(mission(), "robot2")
    repeat(scanner, ranges, 2.0, moving)
    assert scanner.doubt is None


def test_few_equal_beams_are_doubted_after_more_scans() -> None:
    scanner = Scanner(mission(), "robot2")
    repeat(scanner, FEW, 0.6, Command(0.2, 0.0))
    assert scanner.doubt is None
    repeat(scanner, FEW, 0.2, Command(0.2, 0.0), since=0.6)
    assert scanner.doubt is not None


def test_scan_published_twice_is_no_fault() -> None:
    scanner = Scanner(mission(), "robot2")
    for number in range(20):
        moment = 0.1 * number
        scanner.moved(moment, Command(0.5, 0.0))
        scanner.process_scan(scan(moment, [5.0 - 0.1 * (number // 2)] * 40), moment, at(moment))
        assert scanner.doubt is None


def test_late_scan_counts_as_old_despite_fast_clock() -> None:
    scanner = Scanner(mission(), "robot2")
    scanner.process_scan(scan(1.4, post(1.0)), 1.0, at(1.0))
    scanner.process_scan(scan(1.6, post(1.0)), 1.5, at(1.5))
    assert scanner.state.ended == pytest.approx(1.2, abs=1e-3)


@pytest.mark.parametrize("count", [2, 5])
def test_cycle_of_old_scans_is_doubted(count: int) -> None:
    scanner = Scanner(mission(), "robot2")
    for number in range(3 * count):
        moment = 0.2 * number
        scanner.moved(moment, Command(0.2, 0.0))
        scanner.process_scan(scan(moment, [1.0 + 0.1 * (number % count)] * 40), moment, at(moment))
        assert (scanner.doubt is None) == (number < count)


def seeing(robot: str = "required", **changes: Any) -> Scanner:
    """A scanner after a scan of one post, with these changes."""
    scanner, one = Scanner(mission(robot), "robot2"), scan(0.0, post(1.0))
    scanner.process_scan(decode(LaserScan, encode(dataclasses.replace(one, **changes))), 0.0, at(0.0))
    return scanner


def test_required_scan_must_reach_stopping_distance() -> None:
    assert str(seeing(range_max=1.4).doubt) == (
        "range scan has range_max 1.4 m: this robot needs at least 1.42 m to stop from its max_speed"
    )
    assert seeing(range_max=1.5).doubt is seeing("optional", range_max=1.4).doubt is None


def sector(first: float, last: float) -> dict[str, Any]:
    """The changes of a scan that covers the directions from `first` to `last` [°]."""
    return {"angle_min": math.radians(first), "ranges": (0.0,) * round(last - first)}


@pytest.mark.parametrize(("first", "last"), [(90.0, 270.0), (180.0, 181.0), (-20.0, 20.0), (-30.0, 90.0)])
def test_required_scan_must_cover_direction_ahead(first: float, last: float) -> None:
    assert str(seeing(**sector(first, last)).doubt).startswith("range scan does not show what is ahead")
    assert seeing("optional", **sector(first, last)).doubt is None


@pytest.mark.parametrize("view", [90.0, 135.0, 180.0])
@pytest.mark.parametrize("speed", [0.3, -0.3])
def test_robot_drives_only_in_directions_scanner_covers(view: float, speed: float) -> None:
    robot = Robot([(math.copysign(2.0, speed) + 0j, 0.01)])
    look = robot.look

    def partial() -> LaserScan:
        whole = look()
        ranges = tuple(whole.ranges[number % 360] for number in range(-round(view), round(view)))
        return dataclasses.replace(whole, angle_min=-math.radians(view), ranges=ranges)

    robot.look = partial  # type: ignore[method-assign]
    robot.drive(Command(speed, 0.0), 15.0)
    assert robot.scanner.doubt is None
    assert robot.nearest > 0.0
    assert (abs(robot.position) > 1.5) == (speed > 0.0 or view == 180.0)
    if robot.position == 0j:  # it can turn on the spot
        robot.drive(Command(speed, 0.5), 1.0)
        assert cmath.phase(robot.heading) > 0.3


def test_scan_without_valid_beams_is_doubted() -> None:
    doubt = seeing(ranges=(math.nan,) * 360).doubt
    assert str(doubt).startswith("no beam of the range scan has come back for 0.0 s; check")
    assert seeing(ranges=(*[math.nan] * 359, math.inf)).doubt is None  # free space


@pytest.mark.parametrize(("seen", "empty"), [({"seen.radius": 0.035}, True), ({}, False)])
def test_empty_scan_beside_another_robot_is_doubted(seen: dict[str, Any], empty: bool) -> None:
    """Without any beam, an LDS-01 in an open hall looks like a covered one."""
    fleet = Fleet(team(ALONE | {"robot2": ("robot1",)}, scanner="required", **seen))
    fleet.meddle = altered(
        SCAN.key("robot2"), LaserScan, lambda one: dataclasses.replace(one, ranges=(0.0,) * 360)
    )
    fleet.run(8.0)
    reason = fleet.status("robot2").reason
    assert (reason.code is Code.SCAN_EMPTY) == empty
    assert fleet.status("robot1").state == "run"
    if empty:
        assert "robot1 should be in sight; check that the scanner turns" in str(reason)
        # robot1 is out of sight by now; robot2 resumes when a beam returns
        fleet.meddle = altered(
            SCAN.key("robot2"), LaserScan, lambda one: dataclasses.replace(one, ranges=tuple(post(3.0)))
        )
        fleet.run(1.0)
        assert fleet.status("robot2").scan_fault is None
