"""What a mission may say of scanners and of what they see."""

from __future__ import annotations

import cmath

import pytest

from formation.mission.file import MissionError, parse, read
from formation.mission.model import Mission
from formation.sensing.raycast import Scanner


def six(text: str = "", robot: str = "") -> Mission:
    whole, name = read("six_robots")
    return parse(whole.replace("[robot]", f"[robot]\n{robot}") + "\n" + text, name)


def test_default_mission_has_no_scanners_and_empty_world() -> None:
    mission = six()
    assert {robot.scanner for robot in mission.robots.values()} == {"none"}
    assert mission.simulation.posts == ()
    assert mission.simulation.walls == ()


def test_simulated_scanner_defaults_to_lds_01() -> None:
    assert six().simulated_scanner.scanner == Scanner()
    other = six("[simulated_scanner]\nbeams = 720\nlost = 0.1").simulated_scanner.scanner
    assert other == Scanner()._replace(beams=720, lost=0.1)


def test_scanner_mount_is_configurable_globally_and_per_robot() -> None:
    mission = six(
        "[robots.robot2.scan]\nyaw_deg = 90", robot='scanner = "required"\nscan = { x = -0.032, rate = 10 }'
    )
    robot2, robot3 = mission.robots["robot2"], mission.robots["robot3"]
    assert {robot2.scanner, robot3.scanner} == {"required"}
    assert robot3.scan.mount == (-0.032 + 0j, 1 + 0j)
    assert robot3.scan.rate == 10.0
    assert robot2.scan.mount.heading == pytest.approx(cmath.rect(1.0, cmath.pi / 2))


def test_posts_and_walls_stand_where_the_mission_says() -> None:
    mission = six(
        "[[simulation.posts]]\nx = 1.0\ny = -2.0\nradius = 0.1\n"
        "[[simulation.walls]]\nbegin = [0, 1]\nend = [3.5, 1]"
    )
    assert [post.disc for post in mission.simulation.posts] == [(1 - 2j, 0.1)]
    assert [wall.line for wall in mission.simulation.walls] == [(1j, 3.5 + 1j)]


@pytest.mark.parametrize(
    ("text", "robot", "reason"),
    [
        ("", 'scanner = "must"', "scanner = 'must': should be 'none', 'optional' or 'required'"),
        ("", "scan = { z = 1.0 }", "robot.scan.z; legal here: rate, x, y, yaw_deg, sweep, margin, lag"),
        ("", "scan = { rate = 0.0 }", "scan.rate = 0.0"),
        ("", "scan = { margin = -0.1 }", "scan.margin = -0.1"),
        ("", "scan = { sweep = -1.5 }", "scan.sweep = -1.5"),
        ("[[simulation.posts]]\nx = 0.0\ny = 0.0", "", "posts.0.radius is missing; legal here: x, y, radius"),
        ("[[simulation.posts]]\nx = 0.0\ny = 0.0\nradius = 0.0", "", "radius = 0.0"),
        ("[[simulation.walls]]\nbegin = [0, 1]", "", "walls.0.end is missing; legal here: begin, end"),
        ("[[simulation.walls]]\nbegin = [0, 1]\nend = [1]", "", "two numbers in metres"),
        ("[simulated_scanner]\nlost = 1.5", "", "lost = 1.5"),
        ("[simulated_scanner]\nbeams = 5000", "", "beams = 5000"),
        (
            "[simulated_scanner]\nrange_min = 4.0",
            "",
            "range_min = 4.0: must be less than its range_max of 3.5 m",
        ),
        ("[simulated_scanner]\nwide = 1", "", "unknown key simulated_scanner.wide; legal here: beams"),
    ],
)
def test_what_is_not_legal_is_said_with_what_is(text: str, robot: str, reason: str) -> None:
    with pytest.raises(MissionError) as refused:
        six(text, robot)
    assert reason in str(refused.value)
