"""install.sh with systemd: user, units and started services."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from formation.deploy.fleet import units
from tests.field.light import MakeBundle
from tests.support.needs import path_of

pytestmark = pytest.mark.namespaces


class Host:
    """This machine with another /etc, a Python outside home directories, and a systemctl that logs calls."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.units = folder, folder / "etc" / "systemd" / "system"
        shutil.copytree("/etc", folder / "etc", symlinks=True, ignore_dangling_symlinks=True)
        for path in self.units.glob("formation-*"):
            path.unlink()
        (folder / "python").mkdir()
        tools = folder / "tools"
        tools.mkdir()
        self.call_log = folder / "asked"
        self.active = folder / "active"
        systemctl = tools / "systemctl"
        self.broken = folder / "broken"
        systemctl.write_text(
            f'#!/bin/sh\necho "$*" >>{self.call_log}\n'
            f"case $* in *is-active*) test -e {self.active} ;; restart*) ! test -e {self.broken} ;; esac\n"
        )
        systemctl.chmod(0o755)

    def install(self, robot: Path, *flags: str) -> subprocess.CompletedProcess[str]:
        """Run a bundle's install.sh with a private view of the machine, as root."""
        self.call_log.write_text("")
        here = self.folder
        script = (
            f"mount --make-rprivate / && mount --bind {here}/etc /etc"
            f" && mount --bind {sys.base_prefix} {here}/python"
            f" && PATH={here}/tools:{here}/python/bin:$PATH"
            f' && exec sh {robot}/install.sh --prefix {here}/prefix "$@"'
        )
        return subprocess.run(
            [path_of("unshare"), "--mount", "sh", "-c", script, "sh", *flags],
            env={"PATH": os.environ["PATH"] + ":/usr/sbin:/sbin"},
            capture_output=True,
            text=True,
            timeout=250,
            check=False,
        )

    @property
    def calls(self) -> list[str]:
        """Calls of systemctl that change something."""
        return [line for line in self.call_log.read_text().splitlines() if "is-active" not in line]


@pytest.fixture
def host(tmp_path: Path) -> Host:
    return Host(tmp_path / "host")


def test_units_are_installed_and_started_with_own_user(make_bundle: MakeBundle, host: Host) -> None:
    host.active.touch()
    one = make_bundle()
    done = host.install(one)
    assert done.returncode == 0, done.stderr
    names = "formation-agent.service formation-watchdog.service"
    assert host.calls == ["daemon-reload", f"--quiet enable {names}", f"restart {names}"]
    for name in names.split():
        assert stat.S_IMODE((host.units / name).stat().st_mode) == 0o644
        installed = (host.units / name).read_text()
        assert installed == (host.folder / "prefix" / "current" / "units" / name).read_text()
        assert f"ExecStart={host.folder}/prefix/current/venv/bin/formation" in installed
    users = (host.folder / "etc" / "passwd").read_text()
    (entry,) = (line.split(":") for line in users.splitlines() if line.startswith("formation:"))
    assert entry[6] == "/usr/sbin/nologin"
    secrets = host.folder / "prefix" / "current" / "certificates"
    assert {path.stat().st_uid for path in (secrets, *secrets.iterdir())} == {int(entry[2])}
    assert (host.folder / "prefix" / "current").stat().st_uid == 0

    again = host.install(one)
    assert "nothing to do" in again.stdout
    assert host.calls == []

    unit = host.units / "formation-watchdog.service"
    right = unit.read_text()
    unit.write_text("[Service]\n")
    assert "formation-watchdog.service" in host.install(one, "--dry-run").stdout
    assert unit.read_text() == "[Service]\n"
    assert host.install(one).returncode == 0
    assert unit.read_text() == right


def test_units_of_earlier_role_are_ended(make_bundle: MakeBundle, host: Host) -> None:
    """The agent of a machine that has become the leader's ends; that of another prefix stays."""
    host.active.touch()
    assert host.install(make_bundle("one")).returncode == 0
    old, leader = ("formation-agent.service", "formation-watchdog.service"), make_bundle("two", role="leader")
    texts = [(leader / "units" / name).read_text() for name in old]
    (leader / "units" / old[0]).unlink()
    (leader / "units" / old[1]).rename(leader / "units" / "formation-leader.service")
    standby = host.units / "formation-standby.service"
    standby.write_text(texts[0].replace(units.PREFIX, "/opt/another"))
    done = host.install(leader, "--no-restart")
    assert done.returncode == 0, done.stderr
    assert not [call for call in host.calls if "restart" in call]
    assert "running services were left alone" in done.stdout
    assert (host.units / old[0]).exists()
    assert f"would end and remove {' '.join(old)}:" in host.install(leader, "--dry-run").stdout
    assert host.install(leader).returncode == 0
    assert host.calls[0] == f"--quiet disable --now {' '.join(old)}"
    left = {path.name for path in host.units.glob("formation-*")}
    assert left == {"formation-leader.service", standby.name}
    assert "nothing to do" in host.install(leader).stdout


@pytest.mark.parametrize("active", [True, False])
def test_failed_start_is_repeated_by_next_install(
    make_bundle: MakeBundle, host: Host, *, active: bool
) -> None:
    """The release is current by then, but what runs is the one before. Without bringup, no agent starts."""
    if active:
        host.active.touch()
    host.broken.touch()
    one = make_bundle()
    done = host.install(one)
    assert done.returncode == 1
    assert "installed, but not started" in done.stderr
    assert "would start the units" in host.install(one, "--dry-run").stdout
    host.broken.unlink()
    done = host.install(one)
    assert done.returncode == 0, done.stderr
    agent = "formation-agent.service " if active else ""
    assert host.calls[-1] == f"restart {agent}formation-watchdog.service"
    waits = "formation-agent starts with turtlebot3.service, which does not run now"
    assert (waits in done.stdout) is not active
    assert "nothing to do" in host.install(one).stdout


def test_python_in_a_home_directory_is_refused(make_bundle: MakeBundle, host: Host) -> None:
    private = host.folder / "home"
    (private / "me").mkdir(parents=True)
    one = make_bundle()
    script = (
        f"mount --make-rprivate / && mount --bind {sys.base_prefix} {private}/me"
        f" && mount --rbind {private} /home && PATH=/home/me/bin:$PATH"
        f" && exec sh {one}/install.sh --prefix {host.folder}/prefix"
    )
    done = subprocess.run(
        [path_of("unshare"), "--mount", "sh", "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "lies in a user's home, which services do not see" in done.stderr
