"""The folder of bundles: what an earlier run has left, and its replacement.

Nothing there changes before all new bundles are ready, and a folder with other content is left alone.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from formation.deploy.fleet.wheels import Target, digest
from formation.deploy.refusal import Refusal

BUNDLE, VERSION = "BUNDLE.json", "VERSION.json"
"""File that marks a folder as ours, and file with the release of a robot's folder."""


def before(out: Path) -> tuple[str, ...]:
    """Return the folders of an earlier run in `out`. Raises Refusal if it has other content."""
    try:
        found = {path.name for path in out.iterdir()}
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise Refusal(f"--out {out}: {error.strerror}") from None
    known: tuple[str, ...] = ()
    if BUNDLE in found:
        try:
            known = tuple(json.loads((out / BUNDLE).read_text(encoding="utf-8"))["folders"])
        except (OSError, ValueError, KeyError, TypeError):
            raise Refusal(f"{out / BUNDLE}: cannot be read; remove {out}, or name another folder") from None
    foreign = sorted(found - {BUNDLE, ".gitignore", *known})
    if foreign:
        raise Refusal(
            f"--out {out}: holds {', '.join(foreign[:3])}{' and more' if len(foreign) > 3 else ''}, which no"
            " bundle has; name a new folder"
        )
    return tuple(name for name in known if name in found)


@contextmanager
def workshop(out: Path) -> Iterator[Path]:
    """Make a folder beside `out`, on its file system, for incomplete bundles."""
    try:
        out.mkdir(mode=0o700, parents=True, exist_ok=True)
        shop = tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.resolve().parent)  # mode 0700
    except OSError as error:
        raise Refusal(f"--out {out}: {error.strerror}") from None
    with shop as folder:
        yield Path(folder)


def replace(shop: Path, out: Path, folders: Sequence[str], before: Sequence[str]) -> None:
    """Move `folders` from the workshop to `out`, replacing those of `before`."""
    out.chmod(0o700)
    write(out / ".gitignore", "*\n")
    # Until all is done the content may be of either run, so both are named.
    write(out / BUNDLE, json.dumps({"folders": sorted({*folders, *before})}) + "\n")
    old = shop / "old"
    old.mkdir()
    for name in before:
        (out / name).rename(old / name)
    for name in folders:
        (shop / name).rename(out / name)
    write(out / BUNDLE, json.dumps({"folders": list(folders)}) + "\n")
    shutil.rmtree(old)


def release_id(folder: Path) -> str:
    """Return a hash of a folder's names, modes and contents, except VERSION.json."""
    total = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name != VERSION:
            total.update(f"{name} {path.stat().st_mode & 0o777:o} {digest(path)}\n".encode())
    return total.hexdigest()[:12]


def earlier(out: Path, before: Sequence[str], target: Target) -> list[Path]:
    """Return the wheels that an earlier run fetched for the same target."""
    same = []
    for name in before:
        version = _version(out / name)
        if (version.get("platform"), version.get("python")) == target:
            same += sorted((out / name / "wheels").glob("*.whl"))
    return same


def made(old: Path, release: str, now: datetime) -> str:
    """Return when a release was first made; a second run with the same result keeps the time."""
    version = _version(old)
    return str(version["made"]) if version.get("release") == release else now.isoformat(timespec="seconds")


def _version(folder: Path) -> Mapping[str, Any]:
    try:
        version = json.loads((folder / VERSION).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return version if isinstance(version, dict) else {}


def write(path: Path, text: str, mode: int = 0o644) -> None:
    """Write a file that is never more readable than `mode`."""
    path.unlink(missing_ok=True)
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        os.fchmod(handle, mode)  # whatever the umask
        file.write(text)
