"""Keys of a mission for scanners, posts and walls."""

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


def simulated(text: str = "", scan: str = "") -> Scanner:
    """The simulated scanner of a mission's robot2."""
    mission = six(text, f"scan = {{ {scan} }}" if scan else "")
    return mission.simulated_scanner.scanner(mission.robots["robot2"].scan)


def test_simulated_scanner_defaults_to_lds_01() -> None:
    assert simulated() == Scanner() == simulated(scan='model = "lds_01"')
    assert simulated("[simulated_scanner]\nbeams = 720\nlost = 0.1") == Scanner(beams=720, lost=0.1)


def test_scanner_model_sets_values_that_mission_omits() -> None:
    assert simulated(scan='model = "lds_02"') == Scanner(360, 0.16, 8.0, 0.005, 0.015, growth_distance=0.3)
    assert simulated("[simulated_scanner]\nbeams = 230", 'model = "lds_02"').beams == 230
    scan = six(robot='scan = { model = "lds_01", x = -0.032 }').robots["robot2"].scan
    assert (scan.rate, scan.sweep, scan.x) == (5.0, -0.2, -0.032)
    scan = six(robot='scan = { model = "lds_02", rate = 10 }').robots["robot2"].scan
    assert (scan.rate, scan.sweep, scan.signed_sweep(0.1)) == (10.0, None, -0.1)
    assert six(robot='scan = { model = "rplidar_a1", sweep = 0.1 }').robots["robot2"].scan.sweep == 0.1


def test_margin_includes_blind_range_of_model() -> None:
    def margin(scan: str) -> float:
        keys = f'scanner = "required"\nradius = 0.105\nscan = {{ x = -0.032, {scan} }}'
        return six(robot=keys).robots["robot2"].margin

    assert margin("rate = 5") == margin('model = "lds_01"') == 0.05
    assert margin('model = "lds_02"') == pytest.approx(0.087)
    assert margin('model = "lds_02", margin = 0.2') == 0.2
    with pytest.raises(MissionError, match=r"margin = 0.06: must be at least 0.087 m"):
        margin('model = "lds_02", margin = 0.06')


def test_each_robot_may_have_its_own_model() -> None:
    mission = six('[robots.robot2.scan]\nmodel = "rplidar_a1"', 'scan = { model = "lds_02" }')
    assert (mission.robots["robot2"].scan.rate, mission.robots["robot3"].scan.rate) == (5.5, 6.4)
    assert mission.robots["robot3"].scan.noise != mission.robots["robot2"].scan.noise
    assert Mission.model_validate(mission.model_dump()) == mission


def test_scanner_mount_is_configurable_globally_and_per_robot() -> None:
    mission = six(
        "[robots.robot2.scan]\nyaw_deg = 90", robot='scanner = "required"\nscan = { x = -0.032, rate = 10 }'
    )
    robot2, robot3 = mission.robots["robot2"], mission.robots["robot3"]
    assert {robot2.scanner, robot3.scanner} == {"required"}
    assert robot3.scan.mount == (-0.032 + 0j, 1 + 0j)
    assert robot3.scan.rate == 10.0
    assert robot2.scan.mount.heading == pytest.approx(cmath.rect(1.0, cmath.pi / 2))


def test_posts_and_walls_are_read_from_mission() -> None:
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
        (
            "",
            "scan = { z = 1.0 }",
            "robot.scan.z; legal here: model, rate, x, y, yaw_deg, sweep, margin, lag",
        ),
        ("", 'scan = { model = "lds_03" }', "scan.model = 'lds_03': should be 'lds_01', 'lds_02' or"),
        ("", "scan = { model = 2 }", "scan.model = 2: should be 'lds_01', 'lds_02' or 'rplidar_a1'"),
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
def test_error_names_illegal_key_or_value(text: str, robot: str, reason: str) -> None:
    with pytest.raises(MissionError) as refused:
        six(text, robot)
    assert reason in str(refused.value)
