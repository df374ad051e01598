"""Wheels of a bundle: available for robots of a field, complete and not too large."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.tags import compatible_tags, cpython_tags
from packaging.utils import parse_wheel_filename

from formation.deploy import env
from formation.deploy.fleet import wheels
from formation.deploy.fleet.wheels import PLATFORMS, PYTHONS, Target
from formation.deploy.refusal import Refusal
from tests.field.deployed import HERE

LOCK = (env.LOCK / "agent.txt").read_text(encoding="utf-8")
ROOM = 145e6
"""Largest size of a robot's installation [bytes]."""
COMPILED = 1.7
"""Upper bound of the size of .pyc files, as a multiple of the sources' size."""
PI = [Target("aarch64", python) for python in PYTHONS]


def resolved(target: Target, pip: Path, folder: Path) -> list[dict[str, Any]]:
    """Report of pip on what it would install on a robot from its package index.

    `pip` is the wheel of pip in the bundle; an older one of this machine may judge by this Python.
    """
    requirements = folder / "requirements.txt"
    requirements.write_text("".join(f"{pin.line}\n" for pin in wheels.robot_pins(target)), encoding="utf-8")
    requested = [sys.executable, f"{pip}/pip", "--disable-pip-version-check", "install", "--dry-run"]
    requested += ["--ignore-installed", "--quiet", "--no-deps", "--require-hashes"]
    report = folder / "report.json"
    flags = [*target.flags, "--target", str(folder / "nowhere"), "--report", str(report)]
    done = subprocess.run(
        [*requested, *flags, "--requirement", str(requirements)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found: list[dict[str, Any]] = json.loads(report.read_text(encoding="utf-8"))["install"]
    return found


def runs_on(target: Target, wheel: str) -> bool:
    """Whether a wheel's name says that it runs on a target, by the rules of an independent library."""
    version = tuple(map(int, target.python.split(".")))
    interpreter = f"cp{version[0]}{version[1]}"
    legal = {
        *cpython_tags(version, [interpreter], target.tags),
        *compatible_tags(version, interpreter, target.tags),
    }
    return bool(parse_wheel_filename(wheel)[3] & legal)


@pytest.mark.parametrize("target", PI[1:], ids=[target.python for target in PI[1:]])
def test_every_robot_dependency_has_raspberry_pi_wheel(target: Target, bundles: Path, tmp_path: Path) -> None:
    found = resolved(target, next((bundles / "robot1" / "wheels").glob("pip-*.whl")), tmp_path)
    names = [one["download_info"]["url"].rpartition("/")[2].partition("#")[0] for one in found]
    assert len(names) == len(wheels.robot_pins(target))
    assert all(name.endswith(".whl") and runs_on(target, name) for name in names), names
    assert any(name.startswith("eclipse_zenoh-1.10.2-cp39-abi3-manylinux_2_28_aarch64") for name in names)


@pytest.mark.parametrize("platform", PLATFORMS)
def test_installed_wheels_take_under_145_mb(platform: str, bundles: Path, tmp_path: Path) -> None:
    target = Target(platform, PYTHONS[0])  # the largest of all
    here = (bundles / "robot1" / "wheels").glob("*.whl") if target == HERE else ()
    wheels.collect(target, tmp_path, here)
    collected = [path for path in tmp_path.glob("*.whl") if not path.name.startswith("pip-")]
    sources, unpacked = 0, 0
    for path in collected:
        with zipfile.ZipFile(path) as archive:
            unpacked += sum(entry.file_size for entry in archive.infolist())
            sources += sum(entry.file_size for entry in archive.infolist() if entry.filename.endswith(".py"))
    assert 100e6 < unpacked + COMPILED * sources < ROOM, (unpacked, sources)
    assert all(runs_on(target, path.name) for path in collected)
    assert len(collected) == len(wheels.robot_pins(target))  # the project's, but not pip


def test_collected_wheels_equal_lock_plus_pip_and_project(bundles: Path) -> None:
    folder = bundles / "robot1" / "wheels"
    hashes = {wheels.digest(path): path.name for path in folder.glob("*.whl")}
    pins = wheels.robot_pins(HERE)
    for pin in pins:
        assert pin.hashes & hashes.keys(), pin.name
    (own,) = folder.glob("zenoh_formation-*.whl")
    assert len(hashes) == len(pins) + 1
    lines = (folder / wheels.REQUIREMENTS).read_text(encoding="utf-8").splitlines()
    assert lines[0] == f"zenoh-formation==0.1.0 --hash=sha256:{wheels.digest(own)}"
    assert len(lines) == len(pins)  # pip itself is not installed


def test_robots_share_wheel_files(bundles: Path) -> None:
    for wheel in (bundles / "robot1" / "wheels").glob("*.whl"):
        assert wheel.samefile(bundles / "leader" / "wheels" / wheel.name)


@pytest.mark.parametrize("python", PYTHONS)
def test_markers_are_evaluated_for_python_of_robot(python: str) -> None:
    pins = {pin.name: pin.version for pin in wheels.pins(LOCK, Target("aarch64", python))}
    environment = {"python_version": python, "python_full_version": f"{python}.0"}
    expected = {}
    for line in LOCK.splitlines():
        if line[:1].isalpha():
            requirement = Requirement(line.removesuffix(" \\").strip())
            if requirement.marker is None or requirement.marker.evaluate(environment):
                expected[requirement.name] = str(requirement.specifier).removeprefix("==")
    assert pins == expected
    assert ("numpy", "2.4.6" if python == "3.11" else "2.5.5") in pins.items()


def test_pins_refuses_other_markers_and_unpinned_lines() -> None:
    lock = "colorama==0.4.6 ; sys_platform == 'win32' \\\n    --hash=sha256:00\n"
    with pytest.raises(Refusal, match="not about Python's version: sys_platform"):
        wheels.pins(lock, PI[0])
    with pytest.raises(Refusal, match="does not pin 'numpy>=2'"):
        wheels.pins("numpy>=2\n", PI[0])


@pytest.mark.parametrize("platform", PLATFORMS)
def test_target_accepts_wheels_up_to_manylinux_2_28(platform: str) -> None:
    target = Target(platform, "3.12")
    other = next(one for one in PLATFORMS if one != platform)
    assert runs_on(target, f"a-1-cp312-cp312-manylinux2014_{platform}.whl")
    assert runs_on(target, f"a-1-cp39-abi3-manylinux_2_28_{platform}.whl")
    assert not runs_on(target, f"a-1-cp39-abi3-manylinux_2_34_{platform}.whl")
    assert not runs_on(target, f"a-1-cp39-abi3-manylinux_2_28_{other}.whl")


def test_collect_reuses_wheels_of_earlier_bundle_without_fetching(
    bundles: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    before = sorted((bundles / "robot1" / "wheels").glob("*.whl"))
    wheels.collect(HERE, tmp_path, before)
    names = {path.name for path in before}
    assert {path.name for path in tmp_path.glob("*.whl")} == names
    taken = names - {next(tmp_path.glob("zenoh_formation-*.whl")).name}
    assert all((tmp_path / name).samefile(bundles / "robot1" / "wheels" / name) for name in taken)


def test_collect_without_index_names_python_and_platform(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    with pytest.raises(Refusal, match=r"the wheels for Python 3\.12 on aarch64 cannot be fetched"):
        wheels.collect(Target("aarch64", "3.12"), tmp_path)


def test_project_wheel_is_reproducible(bundles: Path, tmp_path: Path) -> None:
    again = wheels.project_wheel(tmp_path)
    assert again.name == next((bundles / "robot1" / "wheels").glob("zenoh_formation-*.whl")).name
    first = wheels.digest(again)
    again.unlink()
    assert wheels.digest(wheels.project_wheel(tmp_path)) == first


def test_project_wheel_has_install_script_units_and_lock(bundles: Path) -> None:
    (own,) = (bundles / "robot1" / "wheels").glob("zenoh_formation-*.whl")
    with zipfile.ZipFile(own) as archive:
        names = set(archive.namelist())
    for path in ("install.sh", "systemd/formation-watchdog.service"):
        assert f"formation/deploy/fleet/{path}" in names
    assert "formation/deploy/lock/agent.txt" in names, "a robot's install could not make bundles"


def test_repack_of_installed_formation_equals_its_wheel(bundles: Path, tmp_path: Path) -> None:
    (own,) = (bundles / "robot1" / "wheels").glob("zenoh_formation-*.whl")
    (pip,) = (bundles / "robot1" / "wheels").glob("pip-*.whl")
    place, again = tmp_path / "place", tmp_path / "again"
    command = [
        sys.executable,
        f"{pip}/pip",
        "--isolated",
        "--disable-pip-version-check",
        "install",
        "--quiet",
    ]
    command += ["--no-deps", "--no-index", "--root-user-action=ignore", "--target", str(place), str(own)]
    subprocess.run(command, env=env.own_variables(os.environ), check=True)
    again.mkdir()
    (installed,) = importlib.metadata.distributions(name="zenoh-formation", path=[str(place)])
    packed = wheels.repack(installed, again)
    assert contents(packed) == contents(own)
    with zipfile.ZipFile(packed) as archive:
        record = archive.read("zenoh_formation-0.1.0.dist-info/RECORD").decode()
    assert all(f"{name}," in record for name in contents(own))


def contents(wheel: Path) -> dict[str, str]:
    with zipfile.ZipFile(wheel) as archive:
        names = (name for name in archive.namelist() if not name.endswith("/RECORD"))
        return {name: hashlib.sha256(archive.read(name)).hexdigest() for name in names}
