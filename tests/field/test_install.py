"""The script that installs a bundle on a robot."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from formation.deploy.fleet import bundle, units, wheels
from tests.field.deployed import HERE, commands, install
from tests.field.light import Made, light, release
from tests.support.namespaces import until
from tests.support.needs import path_of

SCRIPT = Path(bundle.__file__).with_name("install.sh")
ROOM = 145e6
"""What a robot's install may take up [bytes]."""


@pytest.fixture(scope="module")
def whole(bundles: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A prefix with all that a robot needs; not to be changed."""
    prefix = tmp_path_factory.mktemp("robot1") / "formation"
    done = install(bundles / "robot1", prefix, "--no-systemd")
    assert done.returncode == 0, done.stderr
    return prefix


def current(prefix: Path) -> str:
    """The release in use; empty if there is none."""
    link = prefix / "current"
    return link.readlink().name if link.is_symlink() else ""


def state(folder: Path) -> dict[str, tuple[int, int]]:
    """Every file of a folder, with its mode and the time of its last change."""
    paths = (path.lstat() for path in folder.rglob("*"))
    named = zip((str(path) for path in folder.rglob("*")), paths, strict=True)
    return {name: (found.st_mode, found.st_mtime_ns) for name, found in named}


def test_what_is_installed_runs_and_fits_on_a_robot(whole: Path) -> None:
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


def test_what_is_installed_names_its_own_place(whole: Path) -> None:
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


def test_a_second_run_does_nothing_and_says_so(bundles: Path, whole: Path) -> None:
    before = state(whole)
    done = install(bundles / "robot1", whole, "--no-systemd")
    assert (done.returncode, done.stderr) == (0, "")
    assert "already: nothing to do" in done.stdout
    assert state(whole) == before


def test_a_dry_run_says_what_it_would_do_and_does_nothing(made: Made, tmp_path: Path) -> None:
    one = made()
    done = install(one, tmp_path / "prefix", "--no-systemd", "--dry-run")
    assert done.returncode == 0
    assert f"would install release {release(one)}" in done.stdout
    assert not (tmp_path / "prefix").exists()


def test_releases_follow_each_other_and_three_are_kept(made: Made, tmp_path: Path) -> None:
    prefix = tmp_path / "prefix"
    bundles = [made(name) for name in ("one", "two", "three", "four")]
    names = [release(one) for one in bundles]
    assert len(set(names)) == 4
    for number, one in enumerate(bundles):
        assert install(one, prefix, "--no-systemd").returncode == 0
        assert current(prefix) == names[number]
        if number:
            assert (prefix / "previous").readlink().name == names[number - 1]
        time.sleep(0.01)  # releases are kept by when they were used
    assert {path.name for path in (prefix / "releases").iterdir()} == set(names[1:])
    assert install(bundles[1], prefix, "--no-systemd").returncode == 0  # back to one that is still there
    assert current(prefix) == names[1]
    assert {path.name for path in (prefix / "releases").iterdir()} == set(names[1:])


def test_what_was_interrupted_is_never_used_and_is_made_anew(made: Made, tmp_path: Path) -> None:
    prefix, one, two = tmp_path / "prefix", made("one"), made("two")
    assert install(one, prefix, "--no-systemd").returncode == 0
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
    assert install(two, prefix, "--no-systemd").returncode == 0
    assert current(prefix) == release(two)
    assert not (half / "left over").exists()


def test_a_release_that_does_not_run_here_is_not_switched_to(made: Made, tmp_path: Path) -> None:
    prefix, one = tmp_path / "prefix", made("one")
    assert install(one, prefix, "--no-systemd").returncode == 0
    broken = made("two", zenoh="raise ImportError('GLIBC_2.99 not found')")
    done = install(broken, prefix, "--no-systemd")
    assert done.returncode == 1
    assert "GLIBC_2.99 not found" in done.stderr
    assert "does not run here" in done.stderr
    assert current(prefix) == release(one)


def test_a_wheel_that_is_not_what_was_bundled_is_not_installed(made: Made, tmp_path: Path) -> None:
    prefix, one = tmp_path / "prefix", made()
    (wheel,) = (one / "wheels").glob("zenoh_formation-*.whl")
    wheel.write_bytes(wheel.read_bytes() + b"\0")
    done = install(one, prefix, "--no-systemd")
    assert done.returncode == 1
    assert "packages cannot be installed" in done.stderr
    assert current(prefix) == ""


def test_a_package_that_is_in_no_list_is_not_fetched(made: Made, tmp_path: Path) -> None:
    one = made()
    with (one / "wheels" / "requirements.txt").open("a") as file:
        file.write(f"numpy==2.4.6 --hash=sha256:{'0' * 64}\n")
    done = install(one, tmp_path / "prefix", "--no-systemd")
    assert done.returncode == 1
    assert "No matching distribution found for numpy==2.4.6" in done.stderr


def test_a_robot_with_internet_fetches_what_its_bundle_leaves_out(bundles: Path, tmp_path: Path) -> None:
    one = light(bundles / "robot1", tmp_path / "one", wheels=False)
    (small,) = (pin for pin in wheels.robot_pins(HERE) if pin.name == "typing-inspection")
    with (one / "wheels" / "requirements.txt").open("a") as file:
        file.write(f"{small.line}\n")
    done = install(one, tmp_path / "prefix", "--no-systemd")
    assert done.returncode == 0, done.stderr
    assert list(
        (tmp_path / "prefix").glob(f"current/venv/lib/*/site-packages/{small.name.replace('-', '_')}")
    )


@pytest.mark.parametrize(
    ("facts", "result"),
    [
        ({"platform": "riscv64"}, f"this bundle is for riscv64, and this machine is {HERE.platform}"),
        ({"python": "3.99"}, f"this bundle is for Python 3.99, and here is Python {HERE.python}"),
        ({"release": ""}, "cannot be read: make the bundle again"),
    ],
)
def test_a_bundle_for_another_machine_is_refused_in_a_sentence(
    made: Made, tmp_path: Path, facts: dict[str, str], result: str
) -> None:
    done = install(made(**facts), tmp_path / "prefix", "--no-systemd")
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
def test_what_cannot_be_is_refused_in_a_sentence(
    bundles: Path, tmp_path: Path, flags: list[str], result: str
) -> None:
    done = install(bundles / "robot1", tmp_path / "prefix", "--no-systemd", *flags)
    assert done.returncode == 2
    assert result in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("part", [bundle.VERSION, "mission.toml", "certificates/key.pem"])
def test_a_folder_that_is_half_a_bundle_is_refused(made: Made, tmp_path: Path, part: str) -> None:
    one = made()
    (one / part).unlink()
    done = install(one, tmp_path / "prefix", "--no-systemd")
    assert done.returncode == 2
    assert f"holds no {part}: it is not a whole bundle" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "prefix").exists()


def test_a_machine_that_becomes_another_robot_says_so(made: Made, tmp_path: Path) -> None:
    for name, robot, result in (
        ("one", "robot1", False),
        ("two", "robot1", False),
        ("three", "robot2", True),
    ):
        done = install(made(name, robot=robot), tmp_path / "prefix", "--no-systemd")
        assert done.returncode == 0, done.stderr
        assert ("this machine was robot1, and is robot2 now" in done.stdout) is result


def test_two_do_not_install_at_the_same_time(made: Made, tmp_path: Path) -> None:
    prefix = tmp_path / "prefix"
    prefix.mkdir()
    with (prefix / ".install.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        done = install(made(), prefix, "--no-systemd")
    assert done.returncode == 2
    assert "another installation is running" in done.stderr


@pytest.mark.shellcheck
def test_the_script_is_one_that_shellcheck_has_nothing_against() -> None:
    done = subprocess.run([path_of("shellcheck"), SCRIPT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_what_a_bundle_says_of_itself_is_what_is_installed(bundles: Path, whole: Path) -> None:
    result = json.loads((whole / "current" / "VERSION.json").read_text())
    assert result == json.loads((bundles / "robot1" / "VERSION.json").read_text())
    assert result["release"] == current(whole)
