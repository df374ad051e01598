"""`formation deploy push` over real ssh: each robot is a prefix behind one server on loopback."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from formation.deploy.cli import main
from formation.deploy.fleet import fleet as fleets
from formation.deploy.fleet import on_robot
from formation.deploy.fleet.push import ProgressLines, flags, manifest, push, send
from formation.deploy.fleet.remote import RemoteError, Robot, Ssh
from tests.field.bundles import BROKEN, INSTALL, ROBOTS, WHEEL, Field, result
from tests.field.sshd import Server, sshd

pytestmark = pytest.mark.ssh


def test_push_installs_every_bundle_and_second_push_changes_nothing(
    field: Field, capsys: pytest.CaptureFixture[str]
) -> None:
    (field.bundles / "robot1" / "mission.toml").chmod(0o664)
    assert field.deploy("push", "--json") == 0
    robots = result(capsys)["robots"]
    for name in ROBOTS:
        there, here = field.prefix(name) / "current", field.bundles / name
        assert manifest(there) == manifest(here)
        assert robots[name]["files"] == len(manifest(here)) == 5
        assert robots[name]["bytes"] == sum(path.stat().st_size for path in here.rglob("*") if path.is_file())
    for folder in ("current", "incoming"):
        assert mode(field.prefix("robot1") / folder / "robot.key") == 0o600
        assert mode(field.prefix("robot1") / folder / "mission.toml") == 0o644
    assert mode(field.prefix("robot1") / "incoming") == 0o700

    before = {path: path.lstat().st_ctime_ns for path in field.prefix("robot1").rglob("*")}
    assert field.deploy("push") == 0
    assert capsys.readouterr().out.count("up to date, not touched") == 3
    after = {path: path.lstat().st_ctime_ns for path in field.prefix("robot1").rglob("*")}
    assert after.keys() == before.keys()
    assert {path for path in after if after[path] != before[path]} <= {field.prefix("robot1") / "incoming"}


def test_key_stays_private_while_it_arrives(field: Field, tmp_path: Path) -> None:
    bundle = fleets.bundles_in(field.bundles)["robot1"]
    (bundle.folder / "robot.key").write_bytes(bytes(2_000_000))
    files = manifest(bundle.folder)
    requested = {"prefix": str(tmp_path / "p"), "files": files, "install": []}
    words = [sys.executable, on_robot.__file__, "receive", json.dumps(requested)]
    modes: set[int] = set()
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL) as robot:
        assert robot.stdin is not None

        class Watch(ProgressLines):
            def sent(self, robot: str, count: int) -> None:  # noqa: ARG002
                for path in (tmp_path / "p").rglob(".robot.key.part"):
                    with suppress(FileNotFoundError):  # renamed already: it is complete
                        modes.add(mode(path))

        send(bundle, files, ["robot.key"], Watch(), robot.stdin)
        robot.stdin.close()
    assert modes == {0o600}


def test_push_sends_only_what_changed_here_or_on_robot(
    field: Field, capsys: pytest.CaptureFixture[str]
) -> None:
    assert field.deploy("push") == 0
    (field.prefix("robot1") / "incoming" / "mission.toml").write_text("tampered", encoding="utf-8")
    (field.prefix("robot1") / "incoming" / "extra").write_text("tampered", encoding="utf-8")
    folder = field.bundle("robot2", "r2")
    (folder / "robot.key").unlink()
    (field.prefix("robot3") / "current" / "mission.toml").write_text("edited there", encoding="utf-8")
    capsys.readouterr()
    assert field.deploy("push", "--json") == 0
    robots = result(capsys)["robots"]

    assert robots["robot1"]["files"] == 1
    assert manifest(field.prefix("robot1") / "incoming") == manifest(field.bundles / "robot1")

    changed = sum((folder / name).stat().st_size for name in ("VERSION.json", "mission.toml"))
    assert (robots["robot2"]["files"], robots["robot2"]["bytes"]) == (2, changed)
    assert robots["robot2"]["installed"] is True
    assert field.current("robot2") == "r2"
    assert manifest(field.prefix("robot2") / "current") == manifest(folder)
    assert (field.prefix("robot2") / "current" / "wheels" / "numpy.whl").read_bytes() == WHEEL

    assert (robots["robot3"]["installed"], robots["robot3"]["restored"]) == (True, ["mission.toml"])
    assert field.deploy("status") == 0


def test_configuration_that_install_leaves_is_no_success(
    field: Field, capsys: pytest.CaptureFixture[str]
) -> None:
    field.bundle("robot1", "r1", install=INSTALL + "echo '# another' >>$prefix/current/mission.toml\n")
    assert field.deploy("push", "--only", "robot1") == 1
    assert "FAILED  installed, but mission.toml on the robot is not as" in capsys.readouterr().out


def test_push_of_an_older_bundle_is_noted(field: Field, capsys: pytest.CaptureFixture[str]) -> None:
    """Another desk has pushed meanwhile."""
    made = "2026-06-01T12:00:00+00:00", "2026-06-01T13:00:00+00:00"
    field.note("robot1", made=made[1])
    assert field.deploy("push", "--only", "robot1") == 0
    field.bundle("robot1", "r0")
    field.note("robot1", made=made[0])
    capsys.readouterr()
    assert field.deploy("push", "--only", "robot1") == 0
    output = capsys.readouterr().out
    assert "robot1  r0  installed (was r1); " in output
    assert f"NOTE: the replaced release is newer, made {made[1]}" in output
    field.bundle("robot1", "r2")
    field.note("robot1", made=made[1])
    assert field.deploy("push", "--only", "robot1", "--json") == 0
    robot = result(capsys)["robots"]["robot1"]
    assert (robot["replaced"], robot["newer"]) == ("r0", None)


def test_machine_of_another_robot_needs_rename(field: Field, capsys: pytest.CaptureFixture[str]) -> None:
    """Two addresses are mixed up: else two machines would be robot2, and none robot1."""
    there = ["--prefix", str(field.prefix("robot1")), "--only", "robot2"]
    assert field.deploy("push", "--only", "robot1") == 0
    assert field.deploy("push", *there) == 1
    assert "FAILED  this machine is robot1, not robot2: correct its address" in capsys.readouterr().out
    version = field.prefix("robot1") / "current" / "VERSION.json"
    assert json.loads(version.read_text())["robot"] == "robot1"
    field.bundle("robot2", "r2")
    assert field.deploy("push", *there, "--rename") == 0
    assert json.loads(version.read_text())["robot"] == "robot2"
    assert field.deploy("rollback", *there) == 1
    assert "the release before is robot1's, not robot2's" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("facts", "why"),
    [
        ({"robot": "robot2"}, "is the bundle of robot2, not of robot1"),
        (
            {"certificate_until": "2020-01-01T00:00:00+00:00"},
            "certificate of robot1 has expired on 2020-01-01",
        ),
        ({"mission_sha256": "0" * 64}, "mission.toml: was changed after the bundles were made"),
    ],
)
def test_unfit_bundle_is_refused_before_anything_is_sent(
    field: Field, facts: dict[str, str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    field.note("robot1", **facts)
    assert field.deploy("push") == 2
    assert why in capsys.readouterr().err
    assert [field.current(name) for name in ROBOTS] == [None, None, None]


def test_push_names_certificate_that_expires_soon(field: Field, capsys: pytest.CaptureFixture[str]) -> None:
    now = datetime.now(UTC)
    soon, late = [(now + timedelta(days=days)).isoformat() for days in (4.5, 20.5)]
    for robot, until in (("robot1", soon), ("robot2", late)):
        begun = now - timedelta(days=25)
        field.note(robot, certificate_since=begun.isoformat(), certificate_until=until)
    expected = f"its certificate expires on {soon[:10]}, in 4 days: formation deploy certificates MISSION"
    assert field.deploy("push") == 0
    output = capsys.readouterr().out
    assert f"robot1: {expected}" in output
    assert output.count("expires") == 1
    assert field.deploy("status") == 0
    output = capsys.readouterr().out
    assert f"! {expected}" in output
    assert output.count("expires") == 1


def test_robot_missing_from_bundles_is_named(field: Field, capsys: pytest.CaptureFixture[str]) -> None:
    """`formation deploy bundle` was killed while it replaced the folders."""
    listed = {"folders": [*ROBOTS, "robot4", "desk"]}
    (field.bundles / "BUNDLE.json").write_text(json.dumps(listed), encoding="utf-8")
    assert field.deploy("push") == 2
    assert "robot4, desk missing" in capsys.readouterr().err


def test_mirror_stays_while_an_installation_reads_it(
    field: Field, capsys: pytest.CaptureFixture[str]
) -> None:
    """The robot's side of an earlier push was killed, and its install.sh lives on."""
    assert field.deploy("push", "--only", "robot1") == 0
    before = manifest(field.prefix("robot1") / "incoming")
    field.bundle("robot1", "r2")
    with (field.prefix("robot1") / ".install.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert field.deploy("push", "--only", "robot1") == 1
    assert "another installation is running on this robot" in capsys.readouterr().out
    assert manifest(field.prefix("robot1") / "incoming") == before


def test_mirror_with_links_and_damaged_files_is_repaired(field: Field) -> None:
    """A file system that was repaired after a power cut, or a hand in it."""
    assert field.deploy("push", "--only", "robot1") == 0
    mirror = field.prefix("robot1") / "incoming"
    shutil.rmtree(mirror / "wheels")
    (mirror / "wheels").write_text("a file where a folder belongs", encoding="utf-8")
    (mirror / "robot.key").unlink()
    (mirror / "robot.key").symlink_to("nowhere")
    (mirror / "units").symlink_to("/etc")
    os.mkfifo(mirror / "pipe")
    (field.prefix("robot1") / ".installed").write_bytes(b"\xff\xfe")
    assert field.deploy("push", "--only", "robot1") == 0
    assert manifest(mirror) == manifest(field.bundles / "robot1")
    assert not [path for path in mirror.rglob("*") if path.is_symlink() or path.is_fifo()]


def test_bundle_that_vanishes_fails_its_robot_alone(
    field: Field, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def vanishing(bundle: fleets.Bundle, *rest: Any) -> None:
        if bundle.robot == "robot2":
            (bundle.folder / "mission.toml").unlink()
        send(bundle, *rest)

    monkeypatch.setattr("formation.deploy.fleet.push.send", vanishing)
    assert field.deploy("push") == 1
    output = capsys.readouterr().out
    assert (
        f"robot2  FAILED  {field.bundles / 'robot2' / 'mission.toml'} cannot be sent: No such file" in output
    )
    assert [field.current(name) for name in ROBOTS] == ["r1", None, "r1"]


def test_answer_of_something_else_is_no_traceback(
    field: Field, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other").mkdir()
    with sshd(tmp_path / "other", f"ForceCommand echo '{on_robot.MARK}{{}}'") as other:
        field.server = other
        assert field.deploy("push") == 1
        assert field.deploy("status") == 1
    assert capsys.readouterr().out.count("its answer cannot be used: KeyError(") == 6


@pytest.mark.usefixtures("in_a_terminal")
def test_interrupted_push_names_robots_that_are_done(
    field: Field, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = fleets.read(flags().parse_args(field.words()), sudo=False)
    stopped, main_thread = threading.Event(), threading.get_ident()

    class Stopped(Ssh):
        def stop(self) -> None:
            stopped.set()

    def one(robot: Robot) -> str:
        if robot.name != "robot1":
            if robot.name == "robot3":
                # a true signal: `_thread.interrupt_main` does not wake a main thread that waits already
                signal.pthread_kill(main_thread, signal.SIGINT)
            assert stopped.wait(20.0)
            raise RemoteError("interrupted")
        return "done"

    with pytest.raises(KeyboardInterrupt):
        fleets.on_all(fleet._replace(ssh=Stopped(None, [], sudo=False)), one)
    assert "done on robot1; not on robot2, robot3, or not known" in capsys.readouterr().err


def test_unreachable_robot_is_named_and_others_are_installed(
    field: Field, capsys: pytest.CaptureFixture[str]
) -> None:
    assert field.deploy("push", "--host", "robot2=127.0.0.9") == 1  # the server listens on 127.0.0.1 only
    output = capsys.readouterr().out
    assert "robot2  FAILED  unreachable: connection refused" in output
    assert output.splitlines()[-1] == "2 of 3 robots; FAILED: robot2"
    assert [field.current(name) for name in ROBOTS] == ["r1", None, "r1"]


def test_refused_key_and_unknown_host_key_are_named(
    field: Field, server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = [str(field.bundles), "--prefix", str(tmp_path / "{robot}"), "--no-systemd"]
    for right, wrong, why in (
        ("/client", "/stranger", "key refused"),
        ("/known_hosts", "/none", "host key unknown"),
    ):
        options = [option.replace(right, wrong) for option in server.options]
        assert main(["deploy", "push", *where, *options]) == 1
        assert capsys.readouterr().out.count(f"FAILED  {why}") == 3


def test_failed_installation_shows_output_and_keeps_running_release(
    field: Field, capsys: pytest.CaptureFixture[str]
) -> None:
    assert field.deploy("push") == 0
    field.bundle("robot2", "r2", install=BROKEN)
    field.bundle("robot3", "r2")
    capsys.readouterr()
    assert field.deploy("push") == 1
    output = capsys.readouterr().out
    assert "robot2  FAILED  install failed (exit code 3)" in output
    assert "| no wheel fits this Python" in output
    assert [field.current(name) for name in ROBOTS] == ["r1", "r1", "r2"]
    field.bundle("robot2", "r2")
    assert field.deploy("push", "--only", "robot2") == 0
    assert field.current("robot2") == "r2"


def test_install_that_failed_after_switch_is_repeated(field: Field) -> None:
    field.bundle("robot1", "r2", install=INSTALL + "[ -e ../mended ] || exit 1\n")
    assert field.deploy("push", "--only", "robot1") == 1
    assert field.current("robot1") == "r2"
    (field.prefix("robot1") / "mended").touch()
    assert field.deploy("push", "--only", "robot1") == 0


def test_full_disk_is_reported(
    field: Field, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    field.bundle("robot1", "r2", install="echo 'pip: [Errno 28] No space left on device'; exit 1\n")
    assert field.deploy("push", "--only", "robot1") == 1
    assert "FAILED  disk full" in capsys.readouterr().out

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", "/opt/formation/incoming/numpy.whl")

    monkeypatch.setattr(on_robot, "_receive_files", full)
    requested = {"prefix": str(field.prefix("robot1")), "files": {}, "install": []}
    assert on_robot.main("receive", json.dumps(requested)) == 1
    assert '"disk full (/opt/formation/incoming/numpy.whl)"' in capsys.readouterr().out


class Stopping(ProgressLines):
    """Breaks the connection off while files are sent or at an installation's line, like an unplugged cable.

    Not before 4 MB are sent: ssh and pipes hold 2 MB, so by then the robot's side reads, and has its lock.
    """

    def __init__(self, ssh: Ssh, when: str) -> None:
        super().__init__()
        self._ssh, self._when, self._bytes = ssh, when, 0
        self.happened = threading.Event()

    def sent(self, robot: str, count: int) -> None:  # noqa: ARG002 - as `ProgressLines`
        self._bytes += count
        if self._bytes > 4_000_000:
            self._maybe("sent")

    def line(self, robot: str, text: str) -> None:  # noqa: ARG002 - as `ProgressLines`
        self._maybe("line")

    def _maybe(self, what: str) -> None:
        if what == self._when:
            self.happened.set()
            self._ssh.stop()


@pytest.mark.parametrize("when", ["sent", "line"])
def test_interrupted_push_keeps_release_and_can_be_repeated(field: Field, when: str) -> None:
    assert field.deploy("push", "--only", "robot1") == 0
    folder = field.bundle("robot1", "r2", install="sleep 600 & wait; " + INSTALL)
    if when == "line":
        (folder / "install.sh").write_text("echo begin\nsleep 600\n" + INSTALL, encoding="utf-8")
    (folder / "wheels" / "scipy.whl").write_bytes(os.urandom(8_000_000))
    fleet = fleets.read(flags().parse_args(field.words("--only", "robot1")), sudo=False)
    view = Stopping(fleet.ssh, when)
    with pytest.raises(RemoteError, match="interrupted"):
        push(fleet, fleet.robots["robot1"], ["--no-systemd"], view)
    assert view.happened.is_set()
    assert field.current("robot1") == "r1"
    field.bundle("robot1", "r2")
    until_unlocked(field.prefix("robot1"))
    assert field.deploy("push", "--only", "robot1") == 0
    assert manifest(field.prefix("robot1") / "current") == manifest(folder)


def test_push_survives_login_output_and_reports_missing_python(
    field: Field, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    with sshd(tmp_path / "a", 'ForceCommand echo "Welcome {}"; eval "$SSH_ORIGINAL_COMMAND"') as chatty:
        field.server = chatty
        assert field.deploy("push") == 0
    capsys.readouterr()
    with sshd(tmp_path / "b", 'ForceCommand PATH=/nowhere; eval "$SSH_ORIGINAL_COMMAND"') as bare:
        field.server = bare
        assert field.deploy("push") == 1
    assert capsys.readouterr().out.count("FAILED  no Python: python3 was not found") == 3


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--host", "robot9=1.2.3.4"], "--host 'robot9=1.2.3.4': must be ROBOT=ADDRESS with one of robot1"),
        (["--host", "robot1"], "--host 'robot1': must be ROBOT=ADDRESS with one of robot1"),
        (["--host", "robot1=-oProxyCommand=x"], "is no address"),
        (
            ["--host", "robot1=10.0.0.1", "--host", "robot1=10.0.0.2"],
            "--host: robot1 has two addresses, 10.0.0.1 and 10.0.0.2",
        ),
        (["--only", "robot9"], "--only 'robot9': must be one of robot1, robot2, robot3"),
        (["--only", "robot1", "--only", "robot9"], "--only 'robot9': must be one of robot1, robot2, robot3"),
        (["--user", "ubuntu", "--user", "pi"], "--user: is given twice, and takes one value"),
        (["--prefix", "/opt/$(x)"], "--prefix '/opt/$(x)': must be an absolute path"),
        (["--prefix", "/opt/same"], "another robot is to be installed at 127.0.0.1:/opt/same"),
    ],
)
def test_illegal_flags_are_refused_before_anything_is_sent(
    field: Field, words: Sequence[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert field.deploy("push", *words) == 2
    assert why in capsys.readouterr().err


def test_only_may_be_given_for_each_robot(field: Field) -> None:
    words = field.words("--only", "robot1", "--only", "robot3")
    assert list(fleets.read(flags().parse_args(words), sudo=False).robots) == ["robot1", "robot3"]


def test_sudo_is_used_only_with_sudo_option(tmp_path: Path) -> None:
    shim = tmp_path / "bin"
    shim.mkdir()
    # a machine where this user is not root, and sudo needs a password
    for name, text in (("id", "echo 1000"), ("sudo", 'echo "sudo: a password is required ($*)" >&2; exit 1')):
        (shim / name).write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
        (shim / name).chmod(0o755)
    (tmp_path / "ssh").mkdir()
    command = f'ForceCommand PATH={shim}:$PATH; eval "$SSH_ORIGINAL_COMMAND"'
    with sshd(tmp_path / "ssh", command) as other:
        options = [text for text in other.options if text != "--ssh-option"][2:]
        ssh = Ssh(other.options[1], options, sudo=True)
        with pytest.raises(RemoteError, match="sudo asks for a password"):
            ssh.call(
                Robot("robot1", "127.0.0.1", str(tmp_path / "p")),
                "look",
                {"robot": "robot1", "rename": False},
            )
        plain = Ssh(other.options[1], options, sudo=False)
        assert (
            plain.call(
                Robot("robot1", "127.0.0.1", str(tmp_path / "p")),
                "look",
                {"robot": "robot1", "rename": False},
            )["files"]
            == {}
        )


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def until_unlocked(prefix: Path) -> None:
    """Wait until the robot's side of an interrupted push has ended."""
    with (prefix / ".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
