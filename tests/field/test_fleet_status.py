"""`formation deploy status` and `rollback` over real ssh."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from formation.deploy.cli import main
from formation.deploy.fleet.fleet import bundles_in
from formation.deploy.fleet.fleet_status import state
from tests.field.bundles import ROBOTS, Field, result
from tests.field.light import light, release
from tests.field.sshd import Server

pytestmark = pytest.mark.ssh


def test_rollback_names_robots_without_earlier_release(
    field: Field, capsys: pytest.CaptureFixture[str]
) -> None:
    assert field.deploy("push") == 0
    field.bundle("robot1", "r2")
    assert field.deploy("push", "--only", "robot1") == 0
    capsys.readouterr()
    assert field.deploy("rollback") == 1
    output = capsys.readouterr().out
    assert "robot1  r2 -> r1" in output
    assert "robot2  FAILED  there is no release before r1" in output
    assert [field.current(name) for name in ROBOTS] == ["r1", "r1", "r1"]
    assert field.deploy("rollback", "--only", "robot1") == 1  # only one release back
    assert field.deploy("push", "--only", "robot1") == 0
    assert field.current("robot1") == "r2"


def test_status_reports_releases_and_differences_from_bundles(
    field: Field, capsys: pytest.CaptureFixture[str]
) -> None:
    assert field.deploy("status") == 1
    assert capsys.readouterr().out.count("! nothing is installed") == 3
    assert field.deploy("push") == 0
    capsys.readouterr()
    assert field.deploy("status", "--json") == 0
    robot = result(capsys)["robots"]["robot2"]
    assert (robot["ok"], robot["release"], robot["version"]["formation"]) == (True, "r1", "0.1.0")
    assert abs(robot["now"] - robot["since"]) < 60.0

    field.bundle("robot1", "r2")
    (field.prefix("robot2") / "current" / "mission.toml").write_text("edited there", encoding="utf-8")
    assert field.deploy("status", "--host", "robot3=127.0.0.9") == 1
    output = capsys.readouterr().out
    assert "! release differs: r2 is in the bundle" in output
    assert "pair (differs)" in output
    assert "! mission differs from the bundle's" in output
    assert "! unreachable: connection refused" in output
    assert output.splitlines()[-1] == "0 of 3 as in the bundles; not robot1, robot2, robot3"


def test_status_names_configuration_name_and_certificate_that_are_wrong(
    field: Field, capsys: pytest.CaptureFixture[str]
) -> None:
    (field.bundles / "robot1" / "zenoh.json5").write_text("{}", encoding="utf-8")
    field.note("robot3", certificate_until="2020-01-01T00:00:00+00:00")
    assert field.deploy("push", "--only", "robot1", "robot2") == 0
    (field.prefix("robot1") / "current" / "zenoh.json5").write_text("{ }", encoding="utf-8")
    shutil.copytree(field.bundles / "robot3", field.prefix("robot3") / "releases" / "r1")
    (field.prefix("robot3") / "current").symlink_to("releases/r1")
    capsys.readouterr()
    assert field.deploy("status") == 1
    output = capsys.readouterr().out
    assert "! zenoh.json5 was changed on the robot: push restores it" in output
    assert "! by its clock its certificate has expired on 2020-01-01T00:00:00+00:00" in output
    assert output.splitlines()[-1] == "1 of 3 as in the bundles; not robot1, robot3"
    assert field.deploy("status", "--only", "robot2", "--prefix", str(field.prefix("robot1"))) == 1
    assert "! this machine is robot1: is the address right?" in capsys.readouterr().out


def test_unit_that_runs_an_older_release_differs(field: Field) -> None:
    """After a push with --no-restart, or an installation that was interrupted before its last step."""
    unit = {"active": "active", "restarts": 0, "says": "", "runs": ["r0"]}
    bundle = bundles_in(field.bundles)["robot1"]
    answer = {
        "release": "r1", "version": {}, "now": 0.0, "mission_sha256": bundle.mission_sha256,
        "configuration": {"mission.toml": bundle.mission_sha256}, "units": {"formation-agent.service": unit},
    }  # fmt: skip
    (differs,) = state(bundle, answer, "/opt/formation").differs
    assert differs.startswith("formation-agent.service still runs release r0: systemctl restart")


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
    mission = field.bundles / "robot1" / "mission.toml"
    right = mission.read_text()
    mission.write_text(right.replace("127.0.0.1:7461", "no..name:7461"), encoding="utf-8")
    assert field.deploy("push") == 1  # its address cannot be one, so it is none of this machine
    assert "robot1  FAILED  unreachable: its address is unknown" in capsys.readouterr().out
    mission.write_text(right, encoding="utf-8")
    assert field.deploy("push", "--only", "robot1") == 0
    assert field.current("robot1") == "r1"
