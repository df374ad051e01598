"""`formation assign`: slots by start, lists to avoid, what it reads and writes, what it refuses."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import tomllib
from pathlib import Path

import pytest

from formation.deploy.cli import main
from formation.deploy.mission_files.assign import Change, edited
from formation.deploy.mission_files.new import PROFILES
from formation.mission.file import load, read, shipped
from formation.mission.model import Mission
from formation.slots.shapes import SHAPES
from tests.support.examples import slow
from tests.unit.deploy.commands import Capsys, assigned, output_of, refused, shuffled

SPACING = PROFILES["turtlebot3_burger"].spacing


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def distances(mission: Mission) -> list[float]:
    """From each start to the slot, centre to centre [m]."""
    ahead = mission.robots[mission.followers[0]].control_point_offset
    return [
        abs(mission.slot(name) - ahead - mission.robots[name].start.position) for name in mission.followers
    ]


@pytest.mark.parametrize("least", ["total", "longest"])
@pytest.mark.parametrize("shape", SHAPES)
def test_robot_takes_the_slot_near_its_start(shape: str, least: str, capsys: Capsys) -> None:
    mission = shuffled(shape)
    before = sum(distances(load(mission)))
    found = assigned(capsys, mission, "--least", least)
    after = load(mission)
    assert sum(distances(after)) == pytest.approx(found["distance"]["now"]["total"])
    assert before == pytest.approx(found["distance"]["before"]["total"])
    assert max(distances(after)) < SPACING / 3.0 < 0.2 * before
    assert main(["check", mission]) == 0
    text = Path(mission).read_bytes()
    assert "is so already" in output_of(capsys, ["assign", mission])
    assert Path(mission).read_bytes() == text


@pytest.mark.parametrize("robots", [3, 8, *slow(50)])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_new_mission_is_assigned_already(shape: str, robots: int, capsys: Capsys) -> None:
    assert main(["new", shape, "--robots", str(robots), "--out", "mine.toml"]) == 0
    text = Path("mine.toml").read_bytes()
    assigned(capsys, "mine.toml")
    assert Path("mine.toml").read_bytes() == text


def test_comments_order_and_all_other_values_stay(capsys: Capsys) -> None:
    assigned(capsys, "six_robots", "--out", "mine.toml")
    before, after = read("six_robots")[0], Path("mine.toml").read_text(encoding="utf-8")
    differing = {
        line.partition("=")[0].strip() for line in set(before.splitlines()) ^ set(after.splitlines())
    }
    assert differing == {"neighbours", "fallback_neighbours"}
    assert re.findall("#.*", before) == re.findall("#.*", after)
    assert list(load("mine.toml").robots) == list(load("six_robots").robots)


def exchanged(text: str, one: str, other: str) -> None:
    """Write the mission `text`, with the slots of two robots exchanged in its shapes, to mine.toml."""
    swapped = re.sub(
        rf"^({one}|{other}) = \[",
        lambda line: f"{other if line[1] == one else one} = [",
        text,
        flags=re.MULTILINE,
    )
    Path("mine.toml").write_text(swapped, encoding="utf-8")


def test_slot_is_assigned_in_every_shape(capsys: Capsys) -> None:
    exchanged(read("patrol")[0], "robot1", "robot3")
    found = assigned(capsys, "mine.toml")
    assert found["robots"]["robot1"]["takes_slot_of"] == "robot3"
    own, mine = load("patrol"), load("mine.toml")
    assert mine.shapes == own.shapes
    assert mine.graph == own.graph


def test_with_keep_slots_measure_each_other_as_they_did(capsys: Capsys) -> None:
    exchanged(read("two_chains")[0], "left1", "left6")
    assigned(capsys, "mine.toml", "--graph", "keep")
    after = load("mine.toml")
    assert after.slot("left1") == complex(-0.7, 0.4)
    assert after.robots["left1"].neighbours == ("left5",)  # as that slot did
    assert after.robots["left6"].neighbours == ("leader",)


def test_printed_command_can_be_pasted_for_any_filename(capsys: Capsys) -> None:
    out = output_of(capsys, ["assign", "six_robots", "--out", "it's mine.toml"])
    (line,) = [line for line in out.splitlines() if line.startswith("  formation ")]
    assert main(shlex.split(line)[1:]) == 0


def test_a_dry_run_shows_the_ways_and_writes_nothing(capsys: Capsys) -> None:
    mission = shuffled()
    text = Path(mission).read_bytes()
    out = output_of(capsys, ["assign", mission, "--dry-run"])
    rows = [f"\n  {name} " for name in load(mission).followers]
    assert not [part for part in ("nothing was written", "in all", "longest", *rows) if part not in out]
    assert Path(mission).read_bytes() == text


def test_assignment_can_begin_at_given_positions(capsys: Capsys) -> None:
    first = load("turtlebot3_pair")
    slots = first.shapes["triangle"]
    at = {"robot1": [*slots["robot2"]], "robot2": [*slots["robot1"]]}
    Path("now.json").write_text(json.dumps(at), encoding="utf-8")
    found = assigned(capsys, "turtlebot3_pair", "--positions", "now.json", "--out", "mine.toml")
    assert found["robots"]["robot1"]["takes_slot_of"] == "robot2"
    assert found["distance"]["now"]["longest"] == pytest.approx(0.05)  # the control point is that far ahead
    assert load("mine.toml").robots["robot1"].start == first.robots["robot1"].start


def test_a_leader_elsewhere_takes_the_slots_along(capsys: Capsys) -> None:
    first = load("turtlebot3_pair")
    at = {name: [x + 7.0, y - 2.0] for name, (x, y) in first.shapes["triangle"].items()}
    Path("now.json").write_text(json.dumps({**at, "leader": [7.0, -2.0]}), encoding="utf-8")
    found = assigned(capsys, "turtlebot3_pair", "--positions", "now.json", "--dry-run")
    assert found["distance"]["before"]["longest"] == pytest.approx(0.05)


def test_turning_slots_follow_first_heading_of_leader(capsys: Capsys) -> None:
    assert main(["new", "wedge", "--robots", "7", "--out", "mine.toml"]) == 0
    text = Path("mine.toml").read_text(encoding="utf-8")
    Path("mine.toml").write_text(
        text.replace("\nheading_deg = 0\n", "\nheading_deg = 90\n"), encoding="utf-8"
    )
    mission = load("mine.toml")
    at = {name: [-mission.slot(name).imag, mission.slot(name).real - 0.05] for name in mission.followers}
    Path("now.json").write_text(json.dumps(at), encoding="utf-8")
    found = assigned(capsys, "mine.toml", "--positions", "now.json", "--dry-run")
    assert found["distance"]["before"]["longest"] == pytest.approx(0.0, abs=1e-9)


def test_another_shape_can_be_the_one_to_go_into(capsys: Capsys) -> None:
    one = assigned(capsys, "patrol", "--dry-run")
    other = assigned(capsys, "patrol", "--dry-run", "--shape", "line")
    assert one["distance"]["before"]["total"] != other["distance"]["before"]["total"]


def avoiding(mission: Mission) -> set[tuple[complex, complex]]:
    """Which slots avoid which."""
    return {
        (mission.slot(robot), mission.slot(other))
        for robot in mission.followers
        for other in mission.avoided_by(robot)
    }


@pytest.mark.parametrize("graph", ["new", "keep"])
@pytest.mark.parametrize("shape", SHAPES)
def test_slots_keep_avoiding_each_other_after_assignment(shape: str, graph: str, capsys: Capsys) -> None:
    before = load(shuffled(shape, 16, "--avoid"))
    found = assigned(capsys, "mine.toml", "--graph", graph)
    after = load("mine.toml")
    assert any(name != robot["takes_slot_of"] for name, robot in found["robots"].items())
    assert avoiding(before) <= avoiding(after)


def test_slots_measured_before_graph_change_are_avoided_afterwards(capsys: Capsys) -> None:
    own = re.sub('avoid = "all".*', "", read("six_robots")[0])
    Path("mine.toml").write_text(
        own.replace('["robot1"]\n', '["robot1"]\navoid = ["robot6"]\n'), encoding="utf-8"
    )
    before = load("mine.toml")
    assigned(capsys, "mine.toml")
    after = load("mine.toml")
    assert after.graph != before.graph
    assert avoiding(before) <= avoiding(after)


@pytest.mark.parametrize("default", ['"all"', '["robot1", "robot2"]', "[]"])
@pytest.mark.parametrize("own", ['"all"', "'all'", '["robot3"]', "[]"])
def test_avoidance_list_of_robot_moves_with_its_slot(own: str, default: str, capsys: Capsys) -> None:
    text = re.sub(r"avoid = \S+", f"avoid = {default}", read("patrol")[0], count=1)
    text = text.replace("[robots.robot1]\n", f"[robots.robot1]\navoid = {own} # mine\n")
    exchanged(text, "robot1", "robot3")
    before = load("mine.toml")
    found = assigned(capsys, "mine.toml", "--graph", "keep")
    after = load("mine.toml")
    assert found["robots"]["robot1"]["takes_slot_of"] == "robot3"
    assert avoiding(before) == avoiding(after)


def test_line_ends_stay_as_they_are(capsys: Capsys) -> None:
    Path("mine.toml").write_bytes(read("six_robots")[0].replace("\n", "\r\n").encode())
    assigned(capsys, "mine.toml")
    raw = Path("mine.toml").read_bytes()
    assert b"fallback_neighbours" in raw
    assert raw.count(b"\n") == raw.count(b"\r\n")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("nowhere.toml", "no such file"),
        ("six_robots", "--out FILE"),
        ("six_robots --out mine.yaml", "must end in .toml"),
        ("six_robots --out there.toml", "--force"),
        ("six_robots --dry-run --shape star", "hexagon, wedge"),
        ("six_robots --dry-run --least time", "total"),
        ("six_robots --dry-run --positions none.json", "No such file"),
        ("six_robots --dry-run --positions there.toml", "not JSON"),
        ("six_robots --dry-run --positions list.json", "must be an object"),
        ("six_robots --dry-run --positions unknown.json", "unknown robot robot9; known: robot1, robot2"),
        ("six_robots --dry-run --positions point.json", "robot2 = [1, True]: must be [x, y]"),
        ("six_robots --dry-run --positions deep.json", "a thousand deep"),
        ("six_robots --dry-run --positions far.json", "two numbers from -100000 to 100000 in metres"),
        ("six_robots --dry-run --positions farther.json", "robot2 = [1, 10000000000"),
        (f"six_robots --out {'long' * 75}.toml", "long.toml: File name too long"),
    ],
)
def test_what_cannot_be_is_one_line_that_says_what_can(arguments: str, says: str, capsys: Capsys) -> None:
    for name, text in {
        "there.toml": "precious",
        "list.json": "[1, 2]",
        "unknown.json": '{"robot9": [1, 2]}',
        "point.json": '{"robot2": [1, true]}',
        "deep.json": "[" * 100_000,
        "far.json": '{"robot2": [1, -1.7e308]}',
        "farther.json": '{"robot2": [1, 1%s]}' % ("0" * 400),
    }.items():
        Path(name).write_text(text, encoding="utf-8")
    before = {path: path.read_bytes() for path in Path().iterdir()}
    err = refused(capsys, ["assign", *arguments.split()])
    assert says in err.splitlines()[-1]
    assert {path: path.read_bytes() for path in Path().iterdir()} == before


def test_a_shape_in_one_line_is_changed_in_place(capsys: Capsys) -> None:
    inline = read("turtlebot3_pair")[0].replace("[shapes.triangle]", "[shapes]\ntriangle = { #")
    inline = inline.replace("{ # ", "{ robot1 = [-0.433013, -0.25], robot2 = [-0.433013, 0.25] } # ")
    inline = re.sub(r"^robot[12] = .*\n", "", inline, flags=re.MULTILINE)
    Path("mine.toml").write_text(inline, encoding="utf-8")
    assigned(capsys, "mine.toml")
    assert re.findall("#.*", Path("mine.toml").read_text(encoding="utf-8")) == re.findall("#.*", inline)
    assert load("mine.toml").slot("robot1") == load("turtlebot3_pair").slot("robot1")


@pytest.mark.parametrize(
    "command",
    [
        "assign missions/six_robots.toml",
        "assign ../{here}/missions/six_robots.toml --positions now.json",
        "assign link.toml",
        "assign patrol --out missions/six_robots.toml --force",
        "assign patrol --out link.toml --force",
        "new line --robots 4 --out link.toml --force",
    ],
)
def test_shipped_mission_is_never_overwritten(
    command: str, capsys: Capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(shipped()["six_robots"].parent, "missions")
    monkeypatch.setattr("formation.mission.file.files", lambda _: Path())
    Path("link.toml").symlink_to("missions/six_robots.toml")
    Path("now.json").write_text('{"robot2": [-2, -1]}', encoding="utf-8")
    text = Path("link.toml").read_bytes()
    err = refused(capsys, command.format(here=Path.cwd().name).split())
    assert "is shipped, and stays as it is" in err
    assert Path("link.toml").read_bytes() == text


def test_assign_keeps_symbolic_link_and_file_mode(capsys: Capsys) -> None:
    Path(shuffled()).rename("real.toml")
    Path("real.toml").chmod(0o640)
    Path("link.toml").symlink_to("real.toml")
    assigned(capsys, "link.toml")
    assert Path("link.toml").is_symlink()
    assert Path("real.toml").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("name", shipped())
def test_lists_of_shipped_missions_can_be_edited(name: str) -> None:
    text, mission = read(name)[0], load(name)
    lists = (("neighbours", ("a", "b")), ("fallback_neighbours", ("c",)), ("fallback_neighbours", ()))
    for robot in mission.followers:
        for key, value in lists:
            text = edited(text, [Change("robots", robot, key, value)])
            assert tuple(tomllib.loads(text)["robots"][robot].get(key, ())) == value
        for shape in mission.shapes:
            text = edited(text, [Change("shapes", shape, robot, (1.5, -2))])
            assert tomllib.loads(text)["shapes"][shape][robot] == [1.5, -2]


def test_lists_over_several_lines_and_odd_spaces_are_edited_as_well() -> None:
    first, second = "[ robots . a ]  # one\n  neighbours = ", ' # two\n[robots.b]\nneighbours=["a"]'
    text = first + '[\n    "b", # near\n    "c",\n  ]' + second
    changed = edited(text, [Change("robots", "a", "neighbours", ("c",))])
    assert changed == first + '["c"]' + second
    added = edited(text, [Change("robots", "b", "fallback_neighbours", ("c",))])
    assert added.endswith('neighbours=["a"]\nfallback_neighbours = ["c"]')


def test_brackets_in_comments_and_strings_are_no_ends_of_lists() -> None:
    text = '[robots.a]\nneighbours = ["b", # ] here\n"c"] # ] there\n[robots.b] # [robots.c]\nx = "]"\n'
    changed = edited(text, [Change("robots", "a", "neighbours", ("c",))])
    assert changed == '[robots.a]\nneighbours = ["c"] # ] there\n[robots.b] # [robots.c]\nx = "]"\n'


def test_inline_and_dotted_tables_are_edited_as_well() -> None:
    inline = '[robots]\na = { neighbours = ["b"] } # one\nb = {}\n'
    change = Change("robots", "a", "neighbours", ("c",))
    changed = edited(inline, [change, Change("robots", "a", "fallback_neighbours", ("b",))])
    assert tomllib.loads(changed)["robots"]["a"] == {"neighbours": ["c"], "fallback_neighbours": ["b"]}
    assert changed.endswith("} # one\nb = {}\n")
    dotted = '[robots]\na.neighbours = ["b"] # one\nb.start = 1\n'
    assert edited(dotted, [change]) == '[robots]\na.neighbours = ["c"] # one\nb.start = 1\n'


def test_what_is_added_stays_clear_of_the_next_table() -> None:
    text = '[robots.a]\nneighbours = ["b"]\nstart = 1 # here\n\n# about b\n[robots.b]\n'
    added = edited(text, [Change("robots", "a", "fallback_neighbours", ("c",))])
    assert added == text.replace("start", 'fallback_neighbours = ["c"]\nstart')
    assert edited(added, [Change("robots", "a", "fallback_neighbours", ())]) == text


def test_without_neighbours_nothing_is_added() -> None:
    with pytest.raises(ValueError, match=r"robots\.a\.avoid"):
        edited("[robots.a]\nstart = 1\n", [Change("robots", "a", "avoid", "all")])
