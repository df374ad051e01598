"""`formation deploy status` and `rollback` over real ssh."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from formation.deploy.cli import main
from tests.field.bundles import ROBOTS, Field, result
from tests.field.light import light, release
from tests.field.sshd import Server

pytestmark = pytest.mark.ssh


def test_rollback_names_robots_without_earlier_release(
    field: Field, capsys: pytest.CaptureFixture[str]
) -> None:
    assert field.deploy("push") == 0
    field.bundle("robot1", "r2")
    assert field.deploy("push") == 0
    capsys.readouterr()
    assert field.deploy("rollback") == 1
    output = capsys.readouterr().out
    assert "robot1  r2 -> r1" in output
    assert "robot2  FAILED  there is no release before r1" in output
    assert [field.current(name) for name in ROBOTS] == ["r1", "r1", "r1"]
    assert field.deploy("rollback", "--only", "robot1") == 1  # only one release back
    assert field.deploy("push", "--only", "robot1") == 0
    assert field.current("robot1") == "r2"


def test_status_reports_installed_release_and_time(field: Field, capsys: pytest.CaptureFixture[str]) -> None:
    assert field.deploy("status") == 1
    assert capsys.readouterr().out.count("! nothing is installed") == 3
    assert field.deploy("push") == 0
    capsys.readouterr()
    assert field.deploy("status", "--json") == 0
    robot = result(capsys)["robots"]["robot2"]
    assert (robot["ok"], robot["release"], robot["version"]["formation"]) == (True, "r1", "0.1.0")
    assert abs(robot["now"] - robot["since"]) < 60.0


def test_status_names_differences_from_bundles(field: Field, capsys: pytest.CaptureFixture[str]) -> None:
    assert field.deploy("push") == 0
    field.bundle("robot1", "r2")
    (field.prefix("robot2") / "current" / "mission.toml").write_text("edited there", encoding="utf-8")
    capsys.readouterr()
    assert field.deploy("status", "--host", "robot3=127.0.0.9") == 1
    output = capsys.readouterr().out
    assert "! release differs: r2 is in the bundle" in output
    assert "pair (differs)" in output
    assert "! mission differs from the bundle's" in output
    assert "! unreachable: connection refused" in output
    assert output.splitlines()[-1] == "0 of 3 as in the bundles; not robot1, robot2, robot3"


def test_bundle_can_be_pushed_rolled_back_and_pushed_again(
    bundles: Path, tmp_path: Path, server: Server, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the real install.sh and real releases."""
    folder = tmp_path / "field"
    words = [str(folder), "--prefix", str(tmp_path / "formation"), "--no-systemd", *server.options, "--json"]
    words += ["--host", "robot1=127.0.0.1"]

    def deploy(command: str) -> dict[str, Any]:
        main(["deploy", command, *words])
        output: dict[str, Any] = result(capsys)["robots"]["robot1"]
        return output

    first = release(light(bundles / "robot1", folder / "robot1", {"zenoh.py": "# one\n"}))
    assert (deploy("push")["installed"], deploy("push")["installed"]) == (True, False)
    shutil.rmtree(folder)
    second = release(light(bundles / "robot1", folder / "robot1", {"zenoh.py": "# two\n"}))
    pushed = deploy("push")
    assert (pushed["release"], pushed["files"]) == (second, 3)  # VERSION.json, one wheel, the list of wheels
    assert deploy("status")["ok"] is True
    assert (deploy("rollback")["release"], deploy("status")["release"]) == (first, first)
    assert deploy("status")["differs"] == [f"release differs: {second} is in the bundle; push it"]
    again = deploy("push")
    assert (again["release"], again["files"], again["installed"]) == (second, 0, True)


def test_push_skips_local_leader_unless_named(field: Field, capsys: pytest.CaptureFixture[str]) -> None:
    for name, role in (("robot1", "leader"), ("robot2", "agent")):  # both are on this machine
        path = field.bundles / name / "VERSION.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), "role": role}), encoding="utf-8")
    assert field.deploy("push") == 0
    assert [field.current(name) for name in ROBOTS] == [None, "r1", "r1"]
    assert "robot1: leads from this machine, left out" in capsys.readouterr().err
    assert field.deploy("push", "--only", "robot1") == 0
    assert field.current("robot1") == "r1"
