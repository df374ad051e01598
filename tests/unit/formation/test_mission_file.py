"""A mission file is read, or refused in one line that names file, key, value and legal values."""

from __future__ import annotations

import os
from itertools import combinations
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from formation.mission.file import (
    MAX_KEY_PARTS,
    MAX_MISSION_BYTES,
    MissionError,
    TomlError,
    load,
    loads,
    parse,
    read,
    shipped,
)
from formation.mission.route import Straight
from formation.mission.rules import too_close
from tests.support.missions import edited
from tests.unit.formation.planar import vectors

SIX = read("six_robots")[0]

ROBOTS = 'choose from robot2, robot3, robot4, robot5, robot6, or avoid = "all"'


def refusal(text: str) -> str:
    with pytest.raises(MissionError) as caught:
        parse(text, "six.toml")
    return str(caught.value)


def error_of(old: str, new: str) -> str:
    assert old in SIX
    return refusal(SIX.replace(old, new, 1))


@pytest.mark.parametrize("name", shipped())
def test_every_shipped_mission_is_legal(name: str) -> None:
    assert load(name).name == name.replace("_", "-")


def test_default_mission_is_section_4_of_the_paper() -> None:
    mission = load("six_robots")
    followers = [mission.robots[f"robot{i}"] for i in range(2, 7)]
    assert (mission.law.kind, mission.law.k_p, mission.law.k_i) == ("field", 2.0, 1.0)
    assert [(one.control_point_offset, one.max_speed) for one in followers] == [(0.2, 1.5)] * 5
    assert [one.start.heading_deg for one in followers] == [90.0, 60.0, 120.0, -30.0, 60.0]
    assert mission.route == (Straight(speed=0.2, heading_deg=30.0),)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("k_p = 2.0", "kp = 2.0", ["unknown key law.kp", "legal here", "k_p"]),
        ("k_p = 2.0", "k_p = nan", ["law.k_p = nan", "finite"]),
        ("k_p = 2.0", "k_p = inf", ["law.k_p = inf", "finite"]),
        ("k_p = 2.0", "k_p = -1", ["law.k_p = -1", "greater than 0"]),
        ("k_p = 2.0", 'k_p = "2"', ["law.k_p = '2': should be a number, without quotes and without a unit"]),
        (
            "k_p = 2.0",
            "takeover = 2",
            ["law.takeover: takeover belongs to the whole mission, above the first"],
        ),
        (
            "k_p = 2.0",
            "bounds = {x = [0, 1]}",
            ["unknown key law.bounds: a table of its own, [bounds]; legal"],
        ),
        ("[[route]] ", "[[law.route]] ", ["unknown key law.route: tables of their own, [[route]]; legal"]),
        ("[law] ", "[law]\nkind = 'fild'", ["law.kind = 'fild'", "'field', 'paper' or 'proportional'"]),
        ("k_p = 2.0", "k_p = 1e308", ["law.k_p = 1e+308", "less than or equal to 1000000000"]),
        ("max_turn_rate = 1.5", "max_turn_rate = 1e4", ["max_turn_rate = 10000.0", "or equal to 1000"]),
        ("[[route]] ", "[[route]]\nradius = 1e-320 #", ["route.0.radius", "greater than or equal to 0.001"]),
        ("[[route]] ", "[route] ", ["route: should be [[route]] in double brackets"]),
        ("max_speed = 1.5", "max_spede = 1.5", ["unknown key robot.max_spede", "max_speed"]),
        ("rate = 20", "rate = 0", ["robot.rate = 0", "greater than or equal to 1"]),
        ('["robot1"]', '["robot9"]', ["robots.robot2.neighbours", "'robot9'", "unknown robot", "robot1"]),
        ('["robot1"]', '["robot2"]', ["robots.robot2.neighbours", "'robot2'", "own neighbour"]),
        ('["robot1", "robot2"]', '["robot1", "robot1"]', ["robots.robot3.neighbours", "'robot1'", "twice"]),
        ('["robot1"]', '"robot1"', ["robots.robot2.neighbours = 'robot1'", "list"]),
        ("rate = 20 ", 'avoid = "some"\nrate = 20 ', ["robot.avoid = 'some'", '"all" or a list of robots']),
        ("rate = 20 ", 'avoid = ["robot9"]\nrate = 20 ', ["robot.avoid = 'robot9': unknown robot; ", ROBOTS]),
        ("rate = 20 ", 'avoid = ["robot1"]\nrate = 20 ', ["robot.avoid = 'robot1': has no body", ROBOTS]),
        ("rate = 20 ", 'avoid = ["all"]\nrate = 20 ', ["robot.avoid = 'all'", 'or avoid = "all"']),
        (
            "[robots.robot3]",
            '[robots.robot3]\navoid = ["robot9"]',
            ["robots.robot3.avoid = 'robot9'", 'from robot2, robot4, robot5, robot6, or avoid = "all"'],
        ),
        ("[collisions]", "[[collisions]]", ["collisions = [{'lag'", "should be a table"]),
        ("lag = 0.05 ", "margn = 1 #", ["unknown key collisions.margn", "mode, margin, lag"]),
        ("speed = 0.2 ", "speed = 1.5 ", ["route.0.speed = 1.5", "below", "max_speed of 1.5"]),
        ("speed = 0.2 ", "sped = 0.2 ", ["unknown key route.0.sped", "speed, heading_deg, duration"]),
        ("x = -3.0, y = 1.5", "x = -1.5, y = 2.1", ["robots.robot3.start", "both radii", "robot2", "0.1 m"]),
        ('leader = "robot1"', 'leader = "robo"', ["leader = 'robo'", "must be one of the robots", "robot1"]),
        ('leader = "robot1"', 'leader = "robot1"\nleader = "robot2"', ["not valid TOML", "line 5"]),
        ("robot2 = [-0.5, 0.866025]", "", ["shapes.hexagon", "no slot for robot2"]),
        ("robot2 = [-0.5, 0.866025]", "robot2 = [-0.5]", ["shapes.hexagon.robot2 = [-0.5]", "two numbers"]),
        ("-1.5, y = 2.0", "-1.5, z = 2.0", ["unknown key robots.robot2.start.z", "x, y, heading_deg"]),
        ("[simulation]", '[simulation]\nstep = "fast"', ["simulation.step = 'fast'", "number"]),
        (
            "[simulation]",
            "[[route]]\nspeed = 0.1\nheading_deg = 0\n[simulation]",
            ["route.0.duration = nothing: only the last leg"],
        ),
        ("[robots.robot2]", "[robots.Robot2]", ["should be a small letter, and then small"]),
    ],
)
def test_error_names_file_key_value_and_legal_values(old: str, new: str, says: list[str]) -> None:
    error = error_of(old, new)
    assert error.startswith("six.toml: ")
    assert "\n" not in error
    assert "instance" not in error
    for words in says:
        assert words in error


def test_error_names_robots_without_path_to_the_leader() -> None:
    text = SIX.replace('["robot2", "robot3"]', '["robot5"]').replace('["robot3", "robot4"]', '["robot4"]')
    with pytest.raises(MissionError, match="from robot4, robot5, robot6 to the leader 'robot1'") as caught:
        parse(text.replace('["robot4", "robot5"]', '["robot5"]'), "six.toml")
    assert "robots.robot4.neighbours = ['robot5']" in str(caught.value)


def test_mistake_in_robot_defaults_is_reported_once() -> None:
    assert error_of("rate = 20", "rate = 0") == (
        "six.toml: robot.rate = 0: should be greater than or equal to 1"
    )


def test_several_mistakes_are_named_in_one_line() -> None:
    assert error_of("rate = 20", 'rate = 0\nradius = "wide"') == (
        "six.toml: robot.radius = 'wide': should be a number, without quotes and without a unit; also:"
        " robot.rate = 0: should be greater than or equal to 1"
    )
    keys = ["first", "second", "third", "fourth", "fifth", "sixth"]
    legal, _, others = error_of("rate = 20", "\n".join(f"{key} = 1" for key in keys)).partition("; also: ")
    assert legal.startswith("six.toml: unknown key robot.first; legal here: control_point_offset, ")
    named = [f"unknown key robot.{key}" for key in keys[1:4]]
    assert others == "; ".join([*named, "and 2 more"])


def test_endpoint_shared_by_two_processes_is_refused() -> None:
    one = 'endpoint = "tcp/h:1"'
    text = edited(SIX, "robots.robot4", one)
    with pytest.raises(
        MissionError, match=r"robots\.robot4\.endpoint = 'tcp/h:1': .*own; robot2 has the same"
    ):
        parse(edited(text, "robots.robot2", one))
    with pytest.raises(MissionError, match=r"standbys\.two\.endpoint = 'tcp/h:1': .*own; robot4 has"):
        parse(f"{text}\n[standbys.two]\n{one}\n")


@pytest.mark.parametrize(
    "endpoint",
    ["192.168.1.12:7460", "tls/192.168.1.12", "tls/192.168.1.12:0", "tls/192.168.1.12:74600",
     "tls/192.168.1.300:7460", "http/192.168.1.12:80", "tls/ 192.168.1.12:7460", ""],
)  # fmt: skip
def test_refusal_of_invalid_endpoint_gives_an_example(endpoint: str) -> None:
    for above, key in (
        ("rate = 20", "robot.robot_endpoint"),
        ("[robots.robot2]\n", "robots.robot2.endpoint"),
    ):
        error = error_of(above, f'{above}\n{key.rpartition(".")[2]} = "{endpoint}"\n')
        assert f"{key} = {endpoint!r}: should be tcp, tls" in error
        assert "port from 1 to 65535, such as 'tls/192.168.1.12:7460'" in error


@pytest.mark.parametrize("endpoint", ["tls/192.168.1.12:7460", "tcp/[::1]:7447", "tls/robot_1.local:1"])
def test_endpoint_with_address_or_host_name_is_accepted(endpoint: str) -> None:
    mission = parse(edited(SIX, "robots.robot2", f'endpoint = "{endpoint}"'))
    assert mission.robots["robot2"].endpoint == endpoint


def test_error_for_unknown_mission_names_shipped_missions() -> None:
    with pytest.raises(MissionError, match=r"nowhere: no such file.*six_robots"):
        load("nowhere")


def test_empty_name_is_not_the_present_folder() -> None:
    with pytest.raises(MissionError, match=r"^'': names no mission; name a TOML file"):
        load("")


def test_folder_binary_file_and_pipe_are_refused(tmp_path: Path) -> None:
    binary, pipe = tmp_path / "mission.toml", tmp_path / "pipe.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    os.mkfifo(pipe)  # load does not wait for it
    for path, reason in ((tmp_path, "cannot be read"), (binary, "UTF-8"), (pipe, "is a pipe or a device")):
        with pytest.raises(MissionError, match=reason):
            load(path)


def test_deeply_nested_mission_is_refused_in_one_line() -> None:
    with pytest.raises(MissionError, match=r"^deep\.toml: not a mission: .* deep$"):
        parse("name = " + "[" * 20_000 + "]" * 20_000, "deep.toml")


@pytest.mark.parametrize(
    ("tables", "says"),
    [
        ("[standbys.robot2]", ["standbys.robot2", "a robot's name"]),
        ("[standbys.robot1]", ["standbys.robot1", "a robot's name"]),
        ("[standbys.monitor]", ["standbys.monitor", "another name", "the monitor"]),
        ("[standbys.operator]", ["standbys.operator", "another name", "the operator"]),
        ("[standbys.Two]", ["standbys.Two", "small letter"]),
        ("[standbys.two]\nport = 3", ["unknown key standbys.two.port", "endpoint"]),
        (
            '[standbys.one]\nendpoint = "tcp/h:1"\n[standbys.two]\nendpoint = "tcp/h:1"',
            ["standbys.two.endpoint = 'tcp/h:1'", "the standby's own", "one has the same"],
        ),
        pytest.param("".join(f"[standbys.s{i}]\n" for i in range(64)), ["at most 63"], id="64 standbys"),
        pytest.param(
            "".join(f"[robots.r{i}]\nstart = {{x = {i}.0, y = 0.0}}\n" for i in range(600)),
            ["at most 500 items"],
            id="600 robots",
        ),
    ],
)
def test_error_names_impossible_standby(tables: str, says: list[str]) -> None:
    error = refusal(f"{SIX}\n{tables}\n")
    assert all(words in error for words in says), error


def test_takeover_too_short_for_follower_rate_is_refused() -> None:
    text = SIX.replace("rate = 20 ", "rate = 3 ")
    assert parse(text).takeover == 1.0
    with pytest.raises(MissionError, match=r"takeover = 1\.0: must be at least 1\.33 s, in which"):
        parse(f"{text}[standbys.one]\n")
    assert parse(text.replace("rate = 3 ", "rate = 4 ") + "[standbys.one]\n").standbys


def test_mission_with_63_standbys_is_accepted() -> None:
    mission = parse(SIX + "".join(f"[standbys.s{i}]\n" for i in range(63)))
    assert mission.candidates == ("robot1", *(f"s{i}" for i in range(63)))


@pytest.mark.parametrize(
    ("robot", "keys", "says"),
    [
        ("robot6", 'fallback_neighbours = ["robot9"]', ["'robot9'", "unknown robot"]),
        ("robot6", 'fallback_neighbours = ["robot6"]', ["'robot6'", "own neighbour"]),
        ("robot6", 'fallback_neighbours = ["robot4"]', ["'robot4'", "is a neighbour already"]),
        ("robot6", 'fallback_neighbours = ["robot2", "robot2"]', ["'robot2'", "listed twice"]),
        ("robot1", 'fallback_neighbours = ["robot2"]', ["['robot2']", "must be empty: the leader"]),
    ],
)
def test_error_names_impossible_fallback_neighbour(robot: str, keys: str, says: list[str]) -> None:
    error = refusal(edited(SIX, f"robots.{robot}", keys))
    assert all(words in error for words in (f"robots.{robot}.fallback_neighbours", *says)), error


def test_fallback_neighbours_do_not_count_as_path_to_leader() -> None:
    text = edited(SIX, "robots.robot2", 'neighbours = []\nfallback_neighbours = ["robot1"]')
    with pytest.raises(MissionError, match="no path of neighbours leads from robot2"):
        parse(text)


DIGITS = "9" * 5000


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("k_p = 2.0", f"k_p = {DIGITS}", "a number of over 4300 digits"),
        ("k_p = 2.0", f"k_p = 0x{'f' * 5000}", "law.k_p = a number of over 4300 digits: should be"),
        ("k_p = 2.0", f"k_p = {'[' * 5000}", "lists or tables a thousand deep"),
        ("[law]", f"a{'.a' * 50_000} = 1\n[law]", f"a key of over {MAX_KEY_PARTS} parts"),
        ("[law]", "'=' . '#' . " * 50 + "a = 1\n[law]", "a key of over"),
        ("[law]", '"\\u001b[2J\\n" = 1\n[law]', "unknown key \\x1b[2J\\n; legal here"),
        ("[law]", "#" * MAX_MISSION_BYTES + "\n[law]", f"is longer than {MAX_MISSION_BYTES} bytes"),
        (
            "[simulation]",
            "[simulation]\nstep = 1e-300",
            "step = 1e-300: should be greater than or equal to 0.001",
        ),
        ("[simulation]", "[simulation]\nhorizon = 1e9 #", "less than or equal to 3600"),
    ],
)
def test_hostile_toml_is_refused_in_one_line(old: str, new: str, says: str) -> None:
    text = SIX.replace("horizon", "# horizon") if "horizon" in new else SIX
    assert old in text
    error = refusal(text.replace(old, new, 1))
    assert says in error
    assert error.startswith("six.toml: ")
    assert error.isprintable()


def test_only_dots_in_keys_count_as_key_parts() -> None:
    prose, numbers, lines = "x." * 200, "1.5, " * 200, "y.\n" * 200
    text = f'# {"." * 200}\na = "{prose}"\nb = [{numbers}]\nc = """{lines}"""\n'
    assert loads(text)["b"] == [1.5] * 200
    key = ".".join("abcdefgh" * 4)
    assert loads(f"{key} = 1")
    with pytest.raises(TomlError):
        loads(f"{key}.a = 1")


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null"])
def test_device_file_is_refused(path: str) -> None:
    with pytest.raises(MissionError, match=f"^{path}: must be a file, is a pipe or a device$"):
        load(path)


def test_load_refuses_file_above_max_mission_bytes(tmp_path: Path) -> None:
    file = tmp_path / "huge.toml"
    file.touch()
    os.truncate(file, 50 * 10**9)
    with pytest.raises(MissionError, match=f"is longer than {MAX_MISSION_BYTES} bytes"):
        load(file)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("a\0b", "cannot be read"),
        ("\ud800.toml", "cannot be read"),
        (".", "is a folder without bundles; name a TOML file, a shipped mission or a folder"),
    ],
)
def test_path_that_is_no_file_is_refused(name: str, why: str) -> None:
    with pytest.raises(MissionError, match=why):
        load(name)


@given(st.lists(st.tuples(vectors, st.floats(0.0, 3.0)), max_size=12))
@example([(0j, 1.0), (2.0 + 0j, 1.0), (4.5 + 0j, 1.0)])  # the first two just touch
def test_too_close_equals_comparing_all_pairs(discs: list[tuple[complex, float]]) -> None:
    pairs = combinations(enumerate(discs), 2)
    apart = {(i, j): (abs(one[0] - other[0]), one[1] + other[1]) for (i, one), (j, other) in pairs}
    found = list(too_close([centre for centre, _ in discs], [radius for _, radius in discs]))
    assert len(found) == len({(i, j) for i, j, _ in found})
    assert {(i, j): distance for i, j, distance in found} == pytest.approx(
        {pair: distance for pair, (distance, reach) in apart.items() if distance <= reach}
    )
