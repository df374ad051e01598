"""The wheels that a robot needs, for installation without internet.

The versions are those of the robot's lock, each file checked against its hash. pip runs here, for a robot
with another platform and Python, so it gets the robot's tags; markers are evaluated here too, because pip
would use the Python that it runs on.
"""

from __future__ import annotations

import base64
import hashlib
import importlib.metadata
import re
import shutil
import sys
import zipfile
from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from formation.deploy import env
from formation.deploy.refusal import Refusal

PLATFORMS = ("aarch64", "x86_64")
PYTHONS = ("3.11", "3.12", "3.13")
PIP = "pip==26.3 --hash=sha256:f3b60b20ffaadd4415ed7957212a38ac63fa4c5fa375bd0f4a797777940fad13"
"""The pip for installing on the robot, which may have none: Debian and Ubuntu package it separately."""
MIN_GLIBC_MINOR = 28
"""Minor version of glibc 2 required on the robot; Zenoh's wheel has the highest requirement."""
REQUIREMENTS = "requirements.txt"
_EPOCH = (2020, 1, 1, 0, 0, 0)
_ON_CPYTHON = frozenset(("platform_python_implementation != 'PyPy'", "implementation_name != 'PyPy'"))
"""Markers that hold on every robot."""
_COMPARED = re.compile(r"python_(?:full_)?version\s*(<=|>=|==|!=|<|>)\s*'([\d.]+)'")


class Target(NamedTuple):
    """A robot's platform and Python."""

    platform: str
    """One of `PLATFORMS`, as in `uname -m`."""
    python: str
    """One of `PYTHONS`."""

    @property
    def tags(self) -> tuple[str, ...]:
        """Platform tags of wheels that run there, the newest first."""
        named = {17: "manylinux2014", 12: "manylinux2010", 5: "manylinux1"}
        oldest = 5 if self.platform == "x86_64" else 17
        tags = []
        for minor in range(MIN_GLIBC_MINOR, oldest - 1, -1):
            tags.append(f"manylinux_2_{minor}_{self.platform}")
            if minor in named:
                tags.append(f"{named[minor]}_{self.platform}")
        return (*tags, f"linux_{self.platform}")

    @property
    def flags(self) -> list[str]:
        """Flags for pip: only wheels for this target, no source code."""
        abi = "cp" + self.python.replace(".", "")
        flags = ["--only-binary=:all:", "--implementation=cp", f"--python-version={self.python}"]
        flags += [f"--abi={name}" for name in (abi, "abi3", "none")]
        return flags + [f"--platform={tag}" for tag in self.tags]


class Pin(NamedTuple):
    """One version of one package, with the hashes of its files."""

    name: str
    version: str
    hashes: frozenset[str]

    @property
    def line(self) -> str:
        """The pin as a line of a requirements file."""
        return " ".join(
            [f"{self.name}=={self.version}", *(f"--hash=sha256:{one}" for one in sorted(self.hashes))]
        )


def pins(lock: str, target: Target) -> tuple[Pin, ...]:
    """Return a lock's pins for a target, independent of the Python here. Raises Refusal if unreadable."""
    found = []
    for entry in re.split(r"\n(?=\S)", re.sub(r"\\\n", " ", re.sub(r"(?m)^\s*#.*\n?", "", lock)).strip()):
        head, *hashes = re.split(r"\s+--hash=sha256:", entry.strip())
        requirement, _, marker = head.partition(";")
        name, _, version = requirement.strip().partition("==")
        if not version or not hashes:
            raise Refusal(f"the robot's lock does not pin {head.strip()!r} with a hash")
        if applies(marker.strip(), target.python):
            found.append(Pin(name, version, frozenset(hashes)))
    return tuple(found)


def applies(marker: str, python: str) -> bool:
    """Return whether a marker holds for that Python. Raises Refusal for an unsupported marker."""
    for condition in filter(None, re.split(r"\s+and\s+", marker)):
        if condition.strip() in _ON_CPYTHON:
            continue
        match = _COMPARED.fullmatch(condition.strip())
        if match is None:
            raise Refusal(f"the robot's lock has a marker that is not about Python's version: {marker}")
        here, there = ((*env.release(text), 0, 0)[:3] for text in (python, match[2]))
        holds = {
            "<": here < there, "<=": here <= there, ">": here > there, ">=": here >= there,
            "==": here == there, "!=": here != there,
        }  # fmt: skip
        if not holds[match[1]]:
            return False
    return True


def robot_pins(target: Target) -> tuple[Pin, ...]:
    """Return the pins that a robot installs besides the project: its lock, and pip."""
    lock = (env.LOCK / "agent.txt").read_text(encoding="utf-8")
    return (*pins(lock, target), *pins(PIP, target))


def collect(target: Target, folder: Path, before: Iterable[Path] = (), *, fetch: bool = True) -> None:
    """Fill `folder` with the wheels of a robot and their requirements file.

    `before` are wheels of an earlier bundle: pinned ones are taken from there, the others fetched. Without
    `fetch`, add only what a robot with internet cannot fetch itself: a pip, and the project. Raises Refusal
    on failure.
    """
    every = robot_pins(target)
    wanted = every if fetch else tuple(pin for pin in every if pin.name == "pip")
    have = _reuse(wanted, folder, before)
    rest = [pin for pin in wanted if pin not in have]
    if rest:
        _download(rest, target, folder)
    own = project_wheel(folder)
    lines = [f"zenoh-formation=={own.name.split('-')[1]} --hash=sha256:{digest(own)}"]
    lines += [pin.line for pin in every if pin.name != "pip"]
    (folder / REQUIREMENTS).write_text("\n".join(lines) + "\n", encoding="utf-8")


def project_wheel(folder: Path) -> Path:
    """Return a wheel of this installation: built from a checkout, else from the installed files."""
    if not (env.ROOT / "pyproject.toml").is_file():
        return repack(importlib.metadata.distribution("zenoh-formation"), folder)
    where = str(folder.resolve())
    if find_spec("hatchling") is not None:
        build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", where]
    else:
        build = [*_pip(), "wheel", "--no-deps", "--wheel-dir", where, "."]
    try:
        env.run_checked(build, env.ROOT)
    except env.SetupError as error:
        raise Refusal(f"the project's own wheel cannot be built: {error}") from None
    return next(folder.glob("zenoh_formation-*.whl"))


def repack(distribution: importlib.metadata.Distribution, folder: Path) -> Path:
    """Return the wheel of an installed pure Python distribution, without the installer's metadata."""
    name = re.sub(r"[-_.]+", "_", distribution.name)  # as wheels spell it
    path = folder / f"{name}-{distribution.version}-py3-none-any.whl"
    meta = f"{name}-{distribution.version}.dist-info"
    noted = {f"{meta}/{one}" for one in ("INSTALLER", "REQUESTED", "RECORD", "direct_url.json")}
    record = []
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(distribution.files or (), key=str):
            inside = file.as_posix()
            if inside in noted or inside.startswith("..") or "__pycache__" in file.parts:
                continue
            content = file.read_binary()
            archive.writestr(_entry(inside), content)
            hashed = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
            record.append(f"{inside},sha256={hashed},{len(content)}")
        record.append(f"{meta}/RECORD,,")
        archive.writestr(_entry(f"{meta}/RECORD"), "\n".join(record) + "\n")
    return path


def digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def link(source: Path, place: Path) -> None:
    """Link the file under a second name, or copy it if the file system cannot link."""
    try:
        place.hardlink_to(source)
    except OSError:
        shutil.copyfile(source, place)


def _reuse(wanted: Iterable[Pin], folder: Path, before: Iterable[Path]) -> set[Pin]:
    pinned: Mapping[str, Pin] = {one: pin for pin in wanted for one in pin.hashes}
    have = set()
    for wheel in before:
        pin = pinned.get(digest(wheel))
        if pin is not None and pin not in have:
            link(wheel, folder / wheel.name)
            have.add(pin)
    return have


def _download(wanted: list[Pin], target: Target, folder: Path) -> None:
    file = folder / REQUIREMENTS
    file.write_text("".join(f"{pin.line}\n" for pin in wanted), encoding="utf-8")
    where = f"Python {target.python} on {target.platform}"
    progress = env.Progress(len(wanted), sys.stderr)
    progress.start(f"fetching {len(wanted)} wheel{'s' if len(wanted) > 1 else ''} for {where}")
    fetch = ["download", "--no-deps", "--require-hashes", *target.flags]
    try:
        env.run_pip([*_pip(), *fetch, "--dest", str(folder), "--requirement", str(file)], progress)
    except env.SetupError as error:
        progress.end("not fetched")
        raise Refusal(f"the wheels for {where} cannot be fetched: {error}") from None
    except BaseException:
        progress.end("not fetched")
        raise
    progress.end("fetched")


def _pip() -> list[str]:
    pip = env.find_pip()
    if pip is None:
        raise Refusal("there is no pip here to fetch wheels with: install one, for example python3-pip")
    return pip


def _entry(name: str) -> zipfile.ZipInfo:
    """Return an archive entry with a fixed time, so that equal content gives an equal archive."""
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.external_attr = 0o644 << 16
    return entry
