"""`formation assign`: slots by start position, avoidance lists, files and refusals."""

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
def _in_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def distances(mission: Mission) -> list[float]:
    """Distance from each start to the slot, centre to centre [m]."""
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
    assert "unchanged" in output_of(capsys, ["assign", mission])
    assert Path(mission).read_bytes() == text


def test_copy_without_changes_is_reported_as_written(capsys: Capsys) -> None:
    text = output_of(capsys, ["assign", "turtlebot3_pair", "--out", "new/copy.toml"])
    assert "\nnew/copy.toml: written, nothing changed\n" in text
    assert load("new/copy.toml") == load("turtlebot3_pair")
    assert "\nsix.toml: written\n" in output_of(capsys, ["assign", "six_robots", "--out", "six.toml"])


@pytest.mark.parametrize("robots", [3, 8, *slow(50)])
@pytest.mark.parametrize("shape", SHAPES)
def test_assign_leaves_new_mission_unchanged(shape: str, robots: int, capsys: Capsys) -> None:
    assert main(["new", shape, "--robots", str(robots), "--out", "mine.toml"]) == 0
    text = Path("mine.toml").read_bytes()
    assigned(capsys, "mine.toml")
    assert Path("mine.toml").read_bytes() == text


def test_assign_keeps_comments_order_and_other_values(capsys: Capsys) -> None:
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


def test_graph_keep_preserves_edges_between_slots(capsys: Capsys) -> None:
    exchanged(read("two_chains")[0], "left1", "left6")
    assigned(capsys, "mine.toml", "--graph", "keep")
    after = load("mine.toml")
    assert after.slot("left1") == complex(-0.7, 0.4)
    assert after.robots["left1"].neighbours == ("left5",)  # as the robot in that slot did before
    assert after.robots["left6"].neighbours == ("leader",)


def test_printed_command_can_be_pasted_for_any_filename(capsys: Capsys) -> None:
    out = output_of(capsys, ["assign", "six_robots", "--out", "it's mine.toml"])
    (line,) = [line for line in out.splitlines() if line.startswith("  formation ")]
    assert main(shlex.split(line)[1:]) == 0


def test_dry_run_prints_distances_and_writes_nothing(capsys: Capsys) -> None:
    mission = shuffled()
    text = Path(mission).read_bytes()
    out = output_of(capsys, ["assign", mission, "--dry-run"])
    rows = [f"\n  {name} " for name in load(mission).followers]
    assert not [part for part in ("nothing was written", "in all", "longest", *rows) if part not in out]
    assert Path(mission).read_bytes() == text


def test_positions_file_replaces_mission_starts(capsys: Capsys) -> None:
    first = load("turtlebot3_pair")
    slots = first.shapes["triangle"]
    at = {"robot1": [*slots["robot2"]], "robot2": [*slots["robot1"]]}
    Path("now.json").write_text(json.dumps(at), encoding="utf-8")
    found = assigned(capsys, "turtlebot3_pair", "--positions", "now.json", "--out", "mine.toml")
    assert found["robots"]["robot1"]["takes_slot_of"] == "robot2"
    assert found["distance"]["now"]["longest"] == pytest.approx(0.05)  # the control point is that far ahead
    assert load("mine.toml").robots["robot1"].start == first.robots["robot1"].start


def test_slots_move_with_leader_position_of_positions_file(capsys: Capsys) -> None:
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


def test_shape_flag_selects_shape_of_assignment(capsys: Capsys) -> None:
    one = assigned(capsys, "patrol", "--dry-run")
    other = assigned(capsys, "patrol", "--dry-run", "--shape", "line")
    assert one["distance"]["before"]["total"] != other["distance"]["before"]["total"]


def avoiding(mission: Mission) -> set[tuple[complex, complex]]:
    """Pairs of slots of which the first avoids the second."""
    return {
        (mission.slot(robot), mission.slot(other))
        for robot in mission.followers
        for other in mission.avoided_by(robot)
    }


@pytest.mark.parametrize("graph", ["new", "keep"])
@pytest.mark.parametrize("shape", ["grid", *slow(*(one for one in SHAPES if one != "grid"))])
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


def test_assign_keeps_line_ends(capsys: Capsys) -> None:
    Path("mine.toml").write_bytes(read("six_robots")[0].replace("\n", "\r\n").encode())
    assigned(capsys, "mine.toml")
    raw = Path("mine.toml").read_bytes()
    assert b"fallback_neighbours" in raw
    assert raw.count(b"\n") == raw.count(b"\r\n")


@pytest.mark.parametrize(
    ("arguments", "message"),
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
        ("six_robots --dry-run --positions twice.json", "robot2 is given twice"),
        ("six_robots --dry-run --positions point.json", "robot2 = [1, True]: must be [x, y]"),
        ("six_robots --dry-run --positions deep.json", "nested too deeply"),
        ("six_robots --dry-run --positions far.json", "two numbers from -100000 to 100000 in metres"),
        ("six_robots --dry-run --positions farther.json", "robot2 = [1, 10000000000"),
        (f"six_robots --out {'long' * 75}.toml", "long.toml: File name too long"),
    ],
)
def test_illegal_arguments_are_refused_and_change_no_file(
    arguments: str, message: str, capsys: Capsys
) -> None:
    for name, text in {
        "there.toml": "precious",
        "list.json": "[1, 2]",
        "unknown.json": '{"robot9": [1, 2]}',
        "twice.json": '{"robot2": [1, 2], "robot2": [3, 4]}',
        "point.json": '{"robot2": [1, true]}',
        "deep.json": "[" * 100_000,
        "far.json": '{"robot2": [1, -1.7e308]}',
        "farther.json": '{"robot2": [1, 1%s]}' % ("0" * 400),
    }.items():
        Path(name).write_text(text, encoding="utf-8")
    before = {path: path.read_bytes() for path in Path().iterdir()}
    err = refused(capsys, ["assign", *arguments.split()])
    assert message in err.splitlines()[-1]
    assert {path: path.read_bytes() for path in Path().iterdir()} == before


def test_inline_shape_table_is_edited_in_place(capsys: Capsys) -> None:
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
    assert "is shipped, and is not changed" in err
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


def test_edited_handles_multiline_lists_and_odd_spaces() -> None:
    first, second = "[ robots . a ]  # one\n  neighbours = ", ' # two\n[robots.b]\nneighbours=["a"]'
    text = first + '[\n    "b", # near\n    "c",\n  ]' + second
    changed = edited(text, [Change("robots", "a", "neighbours", ("c",))])
    assert changed == first + '["c"]' + second
    added = edited(text, [Change("robots", "b", "fallback_neighbours", ("c",))])
    assert added.endswith('neighbours=["a"]\nfallback_neighbours = ["c"]')


def test_edited_ignores_brackets_in_comments_and_strings() -> None:
    text = '[robots.a]\nneighbours = ["b", # ] here\n"c"] # ] there\n[robots.b] # [robots.c]\nx = "]"\n'
    changed = edited(text, [Change("robots", "a", "neighbours", ("c",))])
    assert changed == '[robots.a]\nneighbours = ["c"] # ] there\n[robots.b] # [robots.c]\nx = "]"\n'


def test_edited_handles_inline_and_dotted_tables() -> None:
    inline = '[robots]\na = { neighbours = ["b"] } # one\nb = {}\n'
    change = Change("robots", "a", "neighbours", ("c",))
    changed = edited(inline, [change, Change("robots", "a", "fallback_neighbours", ("b",))])
    assert tomllib.loads(changed)["robots"]["a"] == {"neighbours": ["c"], "fallback_neighbours": ["b"]}
    assert changed.endswith("} # one\nb = {}\n")
    dotted = '[robots]\na.neighbours = ["b"] # one\nb.start = 1\n'
    assert edited(dotted, [change]) == '[robots]\na.neighbours = ["c"] # one\nb.start = 1\n'


def test_edited_adds_key_within_its_own_table() -> None:
    text = '[robots.a]\nneighbours = ["b"]\nstart = 1 # here\n\n# about b\n[robots.b]\n'
    added = edited(text, [Change("robots", "a", "fallback_neighbours", ("c",))])
    assert added == text.replace("start", 'fallback_neighbours = ["c"]\nstart')
    assert edited(added, [Change("robots", "a", "fallback_neighbours", ())]) == text


def test_edited_refuses_to_add_key_without_neighbours() -> None:
    with pytest.raises(ValueError, match=r"robots\.a\.avoid"):
        edited("[robots.a]\nstart = 1\n", [Change("robots", "a", "avoid", "all")])
