"""The command line `formation`: forwarded arguments, refusals and exit codes."""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from formation.agent.core import Agent
from formation.agent.watchdog import __main__ as watchdog
from formation.control import laws
from formation.deploy import cli
from formation.deploy.arguments import as_json, number, read_mission
from formation.deploy.refusal import Refusal
from formation.mission import model
from formation.mission.file import read, shipped
from formation.transport.runtime.command_line import EXTRAS, Parser
from tests.unit.deploy.commands import Capsys, output_of, refused


def stand_in(monkeypatch: pytest.MonkeyPatch, behaviour: object) -> list[Sequence[str]]:
    """Replace every subcommand's module; return the list of arguments of its calls."""
    calls: list[Sequence[str]] = []

    def called(arguments: Sequence[str]) -> int:
        calls.append(arguments)
        if isinstance(behaviour, BaseException):
            raise behaviour
        assert isinstance(behaviour, int)
        return behaviour

    monkeypatch.setattr(
        cli, "import_module", lambda _: SimpleNamespace(main=called, stop=called, deploy=called)
    )
    return calls


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_command_receives_its_arguments_unchanged(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = stand_in(monkeypatch, 1)
    typed = ["six_robots", "-e", "tcp/127.0.0.1:7447", "--cfg", "mode:peer", "--", "-x"]
    assert cli.main([command, *typed]) == 1
    assert list(calls[0])[: len(typed) - 2] == typed[:-2]


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_command_has_help_with_its_own_name(command: str, capsys: Capsys) -> None:
    assert f"usage: formation {command}" in output_of(capsys, [command, "--help"])


def test_help_names_every_command(capsys: Capsys) -> None:
    text = output_of(capsys, ["--help"])
    assert all(f"  {name} " in text for name in cli.COMMANDS)
    assert "examples:" in text


def test_missing_command_prints_usage_and_exits_with_2(capsys: Capsys) -> None:
    assert cli.main([]) == 2
    assert "usage: formation" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["rnu"], ["--nonsense"], ["run", "--nonsense"], ["run", "--law", "x"]])
def test_unknown_command_or_flag_exits_with_2(arguments: list[str], capsys: Capsys) -> None:
    assert cli.main(arguments) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("formation: ")
    assert err.endswith("--help\n")


@pytest.mark.parametrize(
    ("arguments", "flag"),
    [
        (["agent", "six_robots", "--robot", "robot2", "--robot", "robot3"], "--robot"),
        (["leader", "patrol", "--standby", "deputy", "--standby", "reserve"], "--standby"),
        (["order", "six_robots", "-c", "a.json5", "hold", "--config=b.json5"], "-c/--config"),
        (["run", "--record", "a.mcap", "--record", "a.mcap"], "--record"),
        (["replay", "a.mcap", "--verify", "--mission", "patrol", "--mission", "posts"], "--mission"),
    ],
)
def test_flag_with_one_value_is_refused_if_given_twice(
    arguments: list[str], flag: str, capsys: Capsys
) -> None:
    err = refused(capsys, arguments)
    assert err.startswith(f"formation: {flag}: is given twice, and takes one value; see formation ")


@pytest.mark.parametrize("command", ["agent", "watchdog"])
@pytest.mark.parametrize(
    ("robot", "way_on"),
    [
        ("robot9", ""),
        ("leader", "; leader leads: formation leader patrol"),
        ("deputy", "; deputy is a standby: formation leader patrol --standby deputy"),
    ],
)
def test_robot_that_is_no_follower_is_refused_with_the_way_on(
    command: str, robot: str, way_on: str, capsys: Capsys
) -> None:
    legal = "must be a follower of patrol: robot1, robot2, robot3, robot4, robot5"
    err = refused(capsys, [command, "patrol", "--robot", robot])
    assert err.endswith(f"{robot}: --robot {robot!r}: {legal}{way_on}\n")


def test_agent_checks_its_folder_before_it_opens_a_link(tmp_path: Path, capsys: Capsys) -> None:
    (tmp_path / "file").touch()
    err = refused(capsys, ["agent", "six_robots", "--robot", "robot2", "--state", str(tmp_path / "file")])
    assert err == f"robot2: --state {tmp_path}/file: must be a folder that can be written to: File exists\n"


def test_watchdog_says_that_no_robot_listened(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(watchdog, "Process", lambda *_: nullcontext())
    monkeypatch.setattr(watchdog, "park", lambda *_: False)
    assert cli.main(["watchdog", "six_robots", "--robot", "robot2", "--once"]) == 1
    assert "NOT STOPPED: robot2 did not listen to zero velocity; use its own switch" in caplog.text


def test_seed_of_simulated_robots_is_a_whole_number(capsys: Capsys) -> None:
    err = refused(capsys, ["robot", "six_robots", "--seed", "x"])
    assert err.startswith("formation: --seed: 'x': must be a whole number of at least 0; see ")


def test_parser_can_be_used_twice() -> None:
    parser = Parser("formation", "", "")
    parser.add_argument("--robot")
    for robot in ("robot2", "robot3"):
        assert parser.parse_args(["--robot", robot]).robot == robot


def test_version_flag_prints_version(capsys: Capsys) -> None:
    assert output_of(capsys, ["--version"]).startswith("formation 0.")


def test_refusal_prints_one_line_to_stderr(monkeypatch: pytest.MonkeyPatch, capsys: Capsys) -> None:
    stand_in(monkeypatch, Refusal("no such thing"))
    assert cli.main(["run"]) == 2
    assert capsys.readouterr() == ("", "formation: no such thing\n")


@pytest.mark.parametrize(("package", "extra"), EXTRAS.items())
def test_missing_extra_prints_pip_install_line(
    package: str, extra: str, monkeypatch: pytest.MonkeyPatch, capsys: Capsys
) -> None:
    stand_in(monkeypatch, ModuleNotFoundError("none", name=f"{package}.sub"))
    assert cli.main(["monitor"]) == 2
    assert f"pip install '.[{extra}]' in a clone" in capsys.readouterr().err


def test_wrong_file_of_a_law_keeps_no_operator_from_stopping_robots(
    monkeypatch: pytest.MonkeyPatch, capsys: Capsys, tmp_path: Path
) -> None:
    why = "mine.py cannot be used: SyntaxError: invalid syntax (mine.py, line 3)"
    for module in (laws, model):
        monkeypatch.setattr(module, "UNUSABLE", {"mine": why})
    mission = tmp_path / "mission.toml"
    mission.write_text(read("patrol")[0].replace("[law]", '[law]\nkind = "mine"'), encoding="utf-8")
    assert read_mission(str(mission)).law.kind == "mine"  # as `formation stop` reads it
    for command in ("check", "simulate", "run", "rehearse"):
        assert cli.main([command, str(mission)]) == 2
        assert why in capsys.readouterr().err
        assert cli.main([command, "patrol", "--law", "mine"]) == 2
        assert why in capsys.readouterr().err
    with pytest.raises(ValueError, match="cannot be used"):
        Agent(read_mission(str(mission)), "robot1")


def test_missing_formation_module_raises_module_not_found_error(monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, ModuleNotFoundError("none", name="formation.lost"))
    with pytest.raises(ModuleNotFoundError):
        cli.main(["monitor"])


def test_ctrl_c_exits_with_130(monkeypatch: pytest.MonkeyPatch, capsys: Capsys) -> None:
    stand_in(monkeypatch, KeyboardInterrupt())
    assert cli.main(["simulate"]) == 130
    assert "interrupted" in capsys.readouterr().err


def test_missions_command_lists_shipped_missions(capsys: Capsys) -> None:
    listed = output_of(capsys, ["missions"])
    assert all(name in listed for name in shipped())
    assert cli.main(["missions", "--json"]) == 0
    listing = json.loads(capsys.readouterr().out)
    assert set(listing["missions"]) == set(shipped())
    six = listing["missions"]["six_robots"]
    assert (six["title"], six["robots"], six["shapes"]) == ("six-robots", 6, ["hexagon", "wedge"])
    assert six["what"].startswith("Six robots in a hexagon of 1 m sides, after section 4 of the paper")
    assert all(one["what"] in " ".join(listed.split()) for one in listing["missions"].values())
    assert "formation run NAME" in listed


@pytest.mark.parametrize("command", ["run", "check", "simulate"])
def test_illegal_mission_prints_one_line_and_exits_with_2(
    command: str, tmp_path: Path, capsys: Capsys
) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text('name = "bad"\nleader = "nobody"\n')
    err = refused(capsys, [command, str(bad)])
    assert err.count("\n") == 1
    assert str(bad) in err


@pytest.mark.parametrize(
    ("words", "right"),
    [
        (["stop", "six_robots"], "six_robots stop"),
        (["rotate", "six_robots", "-30"], "six_robots rotate -30"),
        (["hold"], "MISSION hold"),
    ],
)
def test_order_before_its_mission_is_refused_with_the_right_line(
    words: list[str], right: str, capsys: Capsys
) -> None:
    line = f"formation: {words[0]} is an order, and MISSION comes first: formation order {right}\n"
    assert refused(capsys, ["order", *words]) == line


def test_law_flag_overrides_law_of_mission() -> None:
    assert read_mission("six_robots").law.kind == "field"
    assert read_mission("six_robots", "paper").law.kind == "paper"


@pytest.mark.parametrize("text", ["nan", "inf", "-1", "0", "1e999"])
def test_number_refuses_nonpositive_and_nonfinite_values(text: str) -> None:
    with pytest.raises(Exception, match=f"{text}: must be above 0 m and finite"):
        number(0.0, unit="m", open_below=True)(text)


@pytest.mark.parametrize("text", ["-1", "1s"])
def test_order_timeout_is_refused_with_its_legal_range(text: str, capsys: Capsys) -> None:
    said = refused(capsys, ["order", "six_robots", "stop", "--timeout", text])
    shown, must = (text, "be") if text == "-1" else (repr(text), "be a number without a unit,")
    assert said.startswith(f"formation: --timeout: {shown}: must {must} above 0 and at most 600 s;")


@pytest.mark.parametrize("command", ["push", "status", "rollback"])
def test_file_in_place_of_bundles_is_called_a_file(command: str, capsys: Capsys) -> None:
    wanted = "DIR is the folder that `formation deploy bundle` made"
    assert refused(capsys, ["deploy", command, __file__]) == f"formation: {__file__}: is a file; {wanted}\n"


def test_json_output_writes_nonfinite_numbers_as_null() -> None:
    text = as_json({"a": float("nan"), "b": [1.5, float("inf")], "c": {"d": None}})
    assert json.loads(text) == {"a": None, "b": [1.5, None], "c": {"d": None}}
    assert os.linesep not in text


@pytest.mark.parametrize(
    ("number", "code", "printed"),
    [
        (errno.EPIPE, 1, ""),
        (errno.ENOSPC, 2, "formation: the output cannot be written: full\n"),
    ],
)
def test_output_that_cannot_be_written_ends_the_command(
    number: int, code: int, printed: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    stand_in(monkeypatch, OSError(number, "full"))
    assert cli.main(["check"]) == code
    assert capfd.readouterr().err == printed


@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_command_works_with_a_closed_stream(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, name, None)
    try:
        assert cli.main(["missions"]) == 0
        assert cli.main(["run", "nosuch"]) == 2
    finally:
        getattr(sys, name).close()


def test_file_error_of_a_command_is_not_taken_for_the_output(monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, OSError(errno.ENOSPC, "No space left on device", "run.mcap"))
    with pytest.raises(OSError, match=r"run\.mcap"):
        cli.main(["check"])
