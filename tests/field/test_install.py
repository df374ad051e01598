"""install.sh, which installs a bundle on a robot."""

from __future__ import annotations

import fcntl
import json
import mmap
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from formation.deploy.fleet import bundle, units, wheels
from formation.deploy.fleet.on_robot import VERSION
from tests.field.deployed import HERE, Installed, commands, install
from tests.field.light import MakeBundle, light, release
from tests.support.namespaces import until
from tests.support.needs import path_of

SCRIPT = Path(bundle.__file__).with_name("install.sh")
ROOM = 145e6
"""Largest size of a robot's installation [bytes]."""


@pytest.fixture(scope="module")
def whole(installed: Installed) -> Path:
    """A prefix with a whole installation; do not change it."""
    return installed.prefixes("robot1")["robot1"]


def current(prefix: Path) -> str:
    """The release in use; empty if there is none."""
    link = prefix / "current"
    return link.readlink().name if link.is_symlink() else ""


def state(folder: Path) -> dict[str, tuple[int, int]]:
    """Every file of a folder, with its mode and the time of its last change."""
    paths = (path.lstat() for path in folder.rglob("*"))
    named = zip((str(path) for path in folder.rglob("*")), paths, strict=True)
    return {name: (found.st_mode, found.st_mtime_ns) for name, found in named}


def test_installation_runs_and_takes_under_145_mb(whole: Path) -> None:
    formation = whole / "current" / "venv" / "bin" / "formation"
    done = subprocess.run(
        [formation, "check", whole / "current" / "mission.toml", "--json"],
        env={"PATH": os.defpath},
        cwd=whole,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    files = [path for path in whole.rglob("*") if path.is_file() and not path.is_symlink()]
    assert sum(path.stat().st_size for path in files) < ROOM


def test_installed_files_name_their_own_prefix(whole: Path) -> None:
    here = whole / "current"
    settings = (here / "zenoh.json5").read_text()
    assert str(here / "certificates" / "key.pem") in settings
    assert units.PREFIX not in settings
    for unit in (here / "units").iterdir():
        text = unit.read_text()
        assert units.PREFIX not in text
        for command in commands(text):
            assert Path(command[0]).is_file()
            assert all(Path(word).is_file() for word in command if word.startswith("/"))


def test_keys_are_private_and_other_files_readable(whole: Path) -> None:
    here = whole / "current"
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in (here / "certificates").iterdir()}
    assert modes == {"ca.pem": 0o600, "certificate.pem": 0o600, "key.pem": 0o600}
    assert stat.S_IMODE((here / "certificates").stat().st_mode) == 0o700
    for name in ("mission.toml", "zenoh.json5", "VERSION.json"):
        assert stat.S_IMODE((here / name).stat().st_mode) == 0o644
    others = [path for path in here.rglob("*") if not path.is_symlink() and path.stat().st_mode & 0o022]
    assert not others, "others may write"


def test_second_install_changes_nothing(bundles: Path, whole: Path) -> None:
    before = state(whole)
    done = install(bundles / "robot1", whole, "--no-systemd")
    assert (done.returncode, done.stderr) == (0, "")
    assert "already: nothing to do" in done.stdout
    assert state(whole) == before


def test_dry_run_prints_plan_and_changes_nothing(make_bundle: MakeBundle, tmp_path: Path) -> None:
    one = make_bundle()
    done = install(one, tmp_path / "prefix", "--no-systemd", "--dry-run")
    assert done.returncode == 0
    assert f"would install release {release(one)}" in done.stdout
    assert not (tmp_path / "prefix").exists()


def test_install_keeps_three_releases_and_any_that_runs(make_bundle: MakeBundle, tmp_path: Path) -> None:
    """One runs as after several installations with --no-restart: its process may import more."""
    prefix = tmp_path / "prefix"
    bundles = [make_bundle(name) for name in ("one", "two", "three", "four", "five")]
    names = [release(one) for one in bundles]
    assert len(set(names)) == 5

    def switch(number: int) -> set[str]:
        """Install a bundle; return the releases that are kept."""
        before = current(prefix)
        done = install(bundles[number], prefix, "--no-systemd")
        assert done.returncode == 0, done.stderr
        assert "this machine was" not in done.stdout
        assert current(prefix) == names[number]
        if before:
            assert (prefix / "previous").readlink().name == before
        time.sleep(0.01)  # releases are kept by when they were used
        return {path.name for path in (prefix / "releases").iterdir()}

    switch(0)
    library = prefix / "releases" / names[0] / "mission.toml"
    with library.open("rb") as file, mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ):
        switch(1)
        switch(2)
        assert switch(3) == set(names[:4])
    assert switch(4) == set(names[2:])
    assert switch(2) == set(names[2:])  # back to a release that was kept


def test_broken_or_interrupted_install_is_not_used(make_bundle: MakeBundle, tmp_path: Path) -> None:
    """Later the interrupted one is repeated."""
    prefix, one, may_end = tmp_path / "prefix", make_bundle("one"), tmp_path / "may end"
    waits = f"import os, time\nwhile not os.path.exists({str(may_end)!r}): time.sleep(0.05)\n"
    two = make_bundle("two", zenoh=waits)  # so that its installation does not end before it is interrupted
    assert install(one, prefix, "--no-systemd").returncode == 0
    broken = make_bundle("broken", zenoh="raise ImportError('GLIBC_2.99 not found')")
    done = install(broken, prefix, "--no-systemd")
    assert done.returncode == 1
    assert "GLIBC_2.99 not found" in done.stderr
    assert "does not run here" in done.stderr
    assert current(prefix) == release(one)
    why = "from formation.control import laws\nlaws.why_unusable = '{}.py cannot be used: no scipy'.format"
    done = install(make_bundle("lawless", zenoh=why), prefix, "--no-systemd")
    assert done.returncode == 1
    assert "field.py cannot be used: no scipy" in done.stderr
    assert current(prefix) == release(one)

    half = prefix / "releases" / release(two)
    with subprocess.Popen(
        ["/bin/sh", two / "install.sh", "--prefix", prefix, "--no-systemd"],
        env={"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as process:
        until((half / "venv" / "bin" / "python").is_symlink)
        os.killpg(process.pid, signal.SIGKILL)
    assert half.exists()
    assert not (half / "VERSION.json").exists()
    assert current(prefix) == release(one)
    (half / "left over").touch()
    may_end.touch()
    assert install(two, prefix, "--no-systemd").returncode == 0
    assert current(prefix) == release(two)
    assert not (half / "left over").exists()


def test_configuration_changed_on_robot_is_restored(make_bundle: MakeBundle, tmp_path: Path) -> None:
    prefix, one = tmp_path / "prefix", make_bundle()
    assert install(one, prefix, "--no-systemd").returncode == 0
    here = prefix / "current"
    right = {name: (here / name).read_bytes() for name in ("mission.toml", "zenoh.json5")}
    (here / "mission.toml").write_text("edited by hand")
    (here / "zenoh.json5").unlink()
    (here / "certificates" / "key.pem").write_text("another key")
    dry = install(one, prefix, "--no-systemd", "--dry-run")
    assert "would restore mission.toml zenoh.json5 certificates/key.pem in" in dry.stdout
    done = install(one, prefix, "--no-systemd")
    assert done.returncode == 0, done.stderr
    assert "where it had been changed: mission.toml zenoh.json5 certificates/key.pem" in done.stdout
    assert right == {name: (here / name).read_bytes() for name in right}
    key = here / "certificates" / "key.pem"
    assert key.read_bytes() == (one / "certificates" / "key.pem").read_bytes()
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    assert "nothing to do" in install(one, prefix, "--no-systemd").stdout


def test_wheel_with_wrong_hash_is_not_installed(make_bundle: MakeBundle, tmp_path: Path) -> None:
    prefix, one = tmp_path / "prefix", make_bundle()
    (wheel,) = (one / "wheels").glob("zenoh_formation-*.whl")
    wheel.write_bytes(wheel.read_bytes() + b"\0")
    done = install(one, prefix, "--no-systemd")
    assert done.returncode == 1
    assert "packages cannot be installed" in done.stderr
    assert current(prefix) == ""


def test_package_missing_from_bundle_is_not_fetched(make_bundle: MakeBundle, tmp_path: Path) -> None:
    one = make_bundle()
    with (one / "wheels" / "requirements.txt").open("a") as file:
        file.write(f"numpy==2.4.6 --hash=sha256:{'0' * 64}\n")
    done = install(one, tmp_path / "prefix", "--no-systemd")
    assert done.returncode == 1
    assert "No matching distribution found for numpy==2.4.6" in done.stderr


def test_bundle_without_wheels_fetches_packages(bundles: Path, tmp_path: Path) -> None:
    one = light(bundles / "robot1", tmp_path / "one", wheels=False)
    (small,) = (pin for pin in wheels.robot_pins(HERE) if pin.name == "typing-inspection")
    with (one / "wheels" / "requirements.txt").open("a") as file:
        file.write(f"{small.line}\n")
    done = install(one, tmp_path / "prefix", "--no-systemd")
    assert done.returncode == 0, done.stderr
    assert list(
        (tmp_path / "prefix").glob(f"current/venv/lib/*/site-packages/{small.name.replace('-', '_')}")
    )


def edited(one: Path) -> None:
    """Its release would be one thing here and another on the other robots."""
    with (one / "mission.toml").open("a") as file:
        file.write("# faster\n")


PARTS = (VERSION, "mission.toml", "certificates/key.pem")


@pytest.mark.parametrize(
    ("facts", "change", "result"),
    [
        ({"platform": "riscv64"}, None, f"this bundle is for riscv64, and this machine is {HERE.platform}"),
        ({"python": "3.99"}, None, f"this bundle is for Python 3.99, and here is Python {HERE.python}"),
        ({"release": ""}, None, "cannot be read: make the bundle again"),
        ({}, edited, "mission.toml was changed after the bundles were made"),
        *(({}, part, f"holds no {part}: it is not a whole bundle") for part in PARTS),
    ],
)
def test_unfit_bundle_is_refused(
    make_bundle: MakeBundle, tmp_path: Path, facts: dict[str, str], change: Any, result: str
) -> None:
    one = make_bundle(**facts)
    if isinstance(change, str):
        (one / change).unlink()
    elif change:
        change(one)
    done = install(one, tmp_path / "prefix", "--no-systemd")
    assert done.returncode == 2
    assert result in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "prefix").exists()


@pytest.mark.parametrize(
    ("flags", "result"),
    [
        (["--fast"], "--fast: unknown; legal are --prefix"),
        (["--prefix"], "--prefix needs a folder"),
        (["--prefix", "/opt/my robots"], "named with letters, digits"),
        (["--prefix", "/"], "named with letters, digits"),
    ],
)
def test_illegal_flags_are_refused_in_one_line(
    bundles: Path, tmp_path: Path, flags: list[str], result: str
) -> None:
    done = install(bundles / "robot1", tmp_path / "prefix", "--no-systemd", *flags)
    assert done.returncode == 2
    assert result in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_install_reports_change_of_robot(make_bundle: MakeBundle, tmp_path: Path) -> None:
    for name, robot, result in (("one", "robot1", False), ("two", "robot2", True)):
        done = install(make_bundle(name, robot=robot), tmp_path / "prefix", "--no-systemd")
        assert done.returncode == 0, done.stderr
        assert ("this machine was robot1, and is robot2 now" in done.stdout) is result


def test_install_refuses_while_another_is_running(make_bundle: MakeBundle, tmp_path: Path) -> None:
    prefix = tmp_path / "prefix"
    prefix.mkdir()
    with (prefix / ".install.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        done = install(make_bundle(), prefix, "--no-systemd")
    assert done.returncode == 2
    assert "another installation is running" in done.stderr


@pytest.mark.shellcheck
def test_shellcheck_finds_nothing_in_install_script() -> None:
    done = subprocess.run([path_of("shellcheck"), SCRIPT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_installed_version_file_equals_that_of_bundle(bundles: Path, whole: Path) -> None:
    result = json.loads((whole / "current" / "VERSION.json").read_text())
    assert result == json.loads((bundles / "robot1" / "VERSION.json").read_text())
    assert result["release"] == current(whole)
