"""Scans that are not what they seem: late, blind to what is near, placed by odometry that is wrong."""

from __future__ import annotations

import pytest

from agent.scanner import LONGEST_SWEEP, Scanner
from formation.topics import ODOM, SCAN
from formation.unicycle import Command
from tests.agent.fleet import Fleet
from tests.agent.missions import team
from tests.agent.scanned import Robot, mission
from tests.agent.test_scanning import ACROSS, ALONE, among, with_mode

WALL = [(2.0 - 30j, 2.0 + 30j)]
KEY, OWN = SCAN.key("robot1"), ODOM.key("robot1")


def before_a_wall(scanner: str) -> Fleet:
    """A robot that nothing but its protective zone keeps from a wall."""
    return Fleet(with_mode(among(team(ALONE, None, scanner=scanner), ACROSS), "off"))


def said_of(fleet: Fleet, *names: str) -> str:
    return " ".join(fleet.status("robot1").get(name, "") for name in names)


# Scanners that are slow, whose scans count for long


@pytest.mark.parametrize("speed", [0.5, 1.0, 1.5])
@pytest.mark.parametrize(("rate", "missing"), [(0.5, 2), (0.5, 3), (0.6, 3), (1.0, 4)])
def test_a_slow_scanner_may_lose_a_scan_before_a_wall(speed: float, rate: float, missing: int) -> None:
    for distance in (3.5, 5.0, 6.5):
        robot = Robot(
            walls=[(distance - 30j, distance + 30j)], rate=rate, missing=[missing - 1], range_max=8.0
        )
        robot.drive(Command(speed, 0.0), 20.0)
        assert robot.nearest > 0.0


def test_of_how_the_robot_moved_no_more_is_remembered_than_a_scan_may_ask_for() -> None:
    for rate in (0.5, 5.0):
        scanner = Scanner(mission(scan=f", rate = {rate}"), "robot2")
        for tick in range(2000):
            scanner.moved(0.05 * tick, Command(0.1, 0.0))
        longest = scanner.stream.limit + scanner.stream.longest_way + LONGEST_SWEEP
        assert 0.0 <= len(scanner._moves) - longest / 0.05 <= 3.0
