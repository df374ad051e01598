"""Effect of commands over ssh on a robot's services, with a systemctl that only logs its calls."""

from __future__ import annotations

import json
import mmap
import os
from datetime import UTC, datetime
from pathlib import Path

import pytest

from formation.deploy.fleet import on_robot

AGENT, WATCHDOG = "formation-agent.service", "formation-watchdog.service"


class Robot:
    """A robot with two releases, the second one current, and a fake systemd."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.prefix, self.units, self._log = folder / "formation", folder / "units", folder / "calls"
        self._programs = folder / "bin"
        for place in (self.units, self._programs):
            place.mkdir()
        for release in ("r1", "r2"):
            home = self.prefix / "releases" / release
            (home / "units").mkdir(parents=True)
            result = {"release": release, "bringup": "turtlebot3.service"}
            (home / "VERSION.json").write_text(json.dumps(result), encoding="utf-8")
            for unit in (AGENT, WATCHDOG):
                text = f"ExecStart={self.prefix}/current/venv/bin/formation # of {release}"
                (home / "units" / unit).write_text(text, encoding="utf-8")
                (self.units / unit).write_text(text, encoding="utf-8")
        (self.prefix / "current").symlink_to("releases/r2")
        (self.prefix / "previous").symlink_to("releases/r1")
        monkeypatch.setattr(on_robot, "SYSTEMD", self.units)
        monkeypatch.setenv("PATH", f"{self._programs}:{os.environ['PATH']}")

    def systemctl(self, script: str) -> None:
        for name in ("systemctl", "journalctl"):
            path = self._programs / name
            path.write_text(f'#!/bin/sh\necho "{name} $*" >>{self._log}\n{script}\n', encoding="utf-8")
            path.chmod(0o755)

    @property
    def calls(self) -> list[str]:
        return self._log.read_text(encoding="utf-8").splitlines()

    def ask(self, command: str, capsys: pytest.CaptureFixture[str], **more: object) -> on_robot.Answer:
        on_robot.main(command, json.dumps({"prefix": str(self.prefix), **more}))
        answer: on_robot.Answer = json.loads(capsys.readouterr().out.partition(on_robot.MARK)[2])
        return answer


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Robot:
    return Robot(tmp_path, monkeypatch)


def test_rollback_restores_and_starts_previous_units(
    robot: Robot, capsys: pytest.CaptureFixture[str]
) -> None:
    robot.systemctl("exit 0")
    answer = robot.ask("rollback", capsys, restart=True)
    assert answer == {"left": "r2", "release": "r1", "restart": ""}
    assert all(unit.read_text(encoding="utf-8").endswith("of r1") for unit in robot.units.iterdir())
    assert robot.calls[-2] == "systemctl daemon-reload"
    assert robot.calls[-1] == f"systemctl restart {AGENT} {WATCHDOG}"
    assert not (robot.prefix / "previous").is_symlink()
    assert not (robot.prefix / ".unfinished").exists()


def test_rollback_does_not_start_agent_without_bringup(
    robot: Robot, capsys: pytest.CaptureFixture[str]
) -> None:
    robot.systemctl('[ "$1" != is-active ]')  # restarting the agent would start what it is bound to
    robot.ask("rollback", capsys, restart=True)
    assert robot.calls[-1] == f"systemctl restart {WATCHDOG}"


def test_rollback_changes_role_back(robot: Robot, capsys: pytest.CaptureFixture[str]) -> None:
    """The newer release made this robot's computer the leader's."""
    robot.systemctl("exit 0")
    leader = robot.units / "formation-leader.service"
    (robot.units / AGENT).rename(leader)
    (robot.units / WATCHDOG).unlink()
    foreign = robot.units / "formation-standby.service"
    foreign.write_text("ExecStart=/opt/another/current/venv/bin/formation", encoding="utf-8")
    robot.ask("rollback", capsys, restart=True)
    assert {unit.name for unit in robot.units.iterdir()} == {AGENT, WATCHDOG, foreign.name}
    changed = [call for call in robot.calls if "is-active" not in call]
    assert changed == [
        f"systemctl disable --now {leader.name}",
        "systemctl daemon-reload",
        f"systemctl enable {AGENT} {WATCHDOG}",
        f"systemctl restart {AGENT} {WATCHDOG}",
    ]


def test_rollback_without_restart_calls_no_service(robot: Robot, capsys: pytest.CaptureFixture[str]) -> None:
    robot.systemctl("exit 0")
    assert robot.ask("rollback", capsys, restart=False)["release"] == "r1"
    with pytest.raises(FileNotFoundError):
        _ = robot.calls


def test_rollback_reports_units_that_do_not_start(robot: Robot, capsys: pytest.CaptureFixture[str]) -> None:
    robot.systemctl('[ "$1" != restart ] || { echo "Job failed, see journalctl"; exit 1; }')
    assert robot.ask("rollback", capsys, restart=True)["restart"] == "Job failed, see journalctl"
    assert (robot.prefix / ".unfinished").exists(), "the next push starts them"


def test_status_reports_systemd_and_journal_of_units(
    robot: Robot, capsys: pytest.CaptureFixture[str]
) -> None:
    robot.systemctl(
        'case "$*" in\n'
        f"*journalctl*|*-n\\ 1*) echo '12:00:00 robot1: hold: no leader' ;;\n"
        f"*{AGENT}*) printf 'LoadState=loaded\\nActiveState=active\\nSubState=running\\nNRestarts=3\\n' ;;\n"
        f"*{WATCHDOG}*) printf 'LoadState=not-found\\nActiveState=inactive\\n' ;;\n"
        "esac"
    )
    units = robot.ask("status", capsys)["units"]
    says = "12:00:00 robot1: hold: no leader"
    facts = {"active": "active", "detail": "running", "restarts": 3, "says": says, "runs": []}
    assert units[AGENT] == facts
    assert units[WATCHDOG]["active"] == "not loaded"


def test_status_reports_release_that_a_process_runs(robot: Robot, capsys: pytest.CaptureFixture[str]) -> None:
    """It was not started again since the last installation; the library is the release's before."""
    library = robot.prefix / "releases" / "r1" / "venv" / "zenoh.so"
    library.parent.mkdir()
    library.write_bytes(bytes(4096))
    robot.systemctl(f"printf 'LoadState=loaded\\nActiveState=active\\nMainPID={os.getpid()}\\n'")
    with library.open("rb") as file, mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ):
        assert robot.ask("status", capsys)["units"][AGENT]["runs"] == ["r1"]
    assert robot.ask("status", capsys)["units"][AGENT]["runs"] == []


@pytest.mark.parametrize(
    ("facts", "why"),
    [
        ({"robot": "robot2"}, "the release before is robot2's, not robot1's: push its bundle instead"),
        ({"certificate_until": "2026-06-01T12:00:00+00:00"}, "has expired on 2026-06-01T12:00:00+00:00"),
    ],
)
def test_unfit_previous_release_prevents_rollback(
    robot: Robot, capsys: pytest.CaptureFixture[str], facts: dict[str, str], why: str
) -> None:
    version = robot.prefix / "releases" / "r1" / "VERSION.json"
    version.write_text(json.dumps({"release": "r1", "robot": "robot1", **facts}), encoding="utf-8")
    now = datetime(2026, 6, 1, 12, tzinfo=UTC).timestamp()
    answer = robot.ask("rollback", capsys, restart=True, robot="robot1", now=now)
    assert why in answer["error"]
    assert (robot.prefix / "current").readlink().name == "r2"


def test_incomplete_previous_release_prevents_rollback(
    robot: Robot, capsys: pytest.CaptureFixture[str]
) -> None:
    (robot.prefix / "releases" / "r1" / "VERSION.json").unlink()  # as after an interrupted installation
    assert robot.ask("rollback", capsys, restart=True) == {"error": "there is no release before r2"}
    assert (robot.prefix / "current").readlink().name == "r2"
