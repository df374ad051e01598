"""The folder that bundles lie in: what an earlier run has left there, and how the new ones take its place.

Nothing there changes before everything new is ready, and a folder that holds anything else is left alone.
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

from deploy.field.wheels import Target, digest
from deploy.refusal import Refusal

BUNDLE, VERSION, DESK = "BUNDLE.json", "VERSION.json", "desk"
"""What marks a folder as one of ours; what says which release a robot's folder holds; the desk's folder."""


def before(out: Path) -> tuple[str, ...]:
    """The folders that an earlier run has left in `out`. Raises Refusal for one that holds other things."""
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
    """A folder beside `out`, on its file system, for what is not whole yet."""
    try:
        out.mkdir(mode=0o700, parents=True, exist_ok=True)
        shop = tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.resolve().parent)  # mode 0700
    except OSError as error:
        raise Refusal(f"--out {out}: {error.strerror}") from None
    with shop as folder:
        yield Path(folder)


def replace(shop: Path, out: Path, folders: Sequence[str], before: Sequence[str]) -> None:
    """Move `folders` from the workshop to `out`, in place of those that were there `before`."""
    out.chmod(0o700)
    write(out / ".gitignore", "*\n")
    # What is there may be of either run until all is done, so both are named until then.
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
    """Short name of everything in a folder but VERSION.json: names, modes and contents."""
    total = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name != VERSION:
            total.update(f"{name} {path.stat().st_mode & 0o777:o} {digest(path)}\n".encode())
    return total.hexdigest()[:12]


def earlier(out: Path, before: Sequence[str], target: Target) -> list[Path]:
    """Wheels that an earlier run has fetched for the same target."""
    same = []
    for name in before:
        said = _version(out / name)
        if (said.get("platform"), said.get("python")) == target:
            same += sorted((out / name / "wheels").glob("*.whl"))
    return same


def made(old: Path, release: str, now: datetime) -> str:
    """When a release was first made: a second run with the same outcome is not a new one."""
    said = _version(old)
    return str(said["made"]) if said.get("release") == release else now.isoformat(timespec="seconds")


def _version(folder: Path) -> Mapping[str, Any]:
    try:
        said = json.loads((folder / VERSION).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return said if isinstance(said, dict) else {}


def write(path: Path, text: str, mode: int = 0o644) -> None:
    """Write a file that is never readable by more than `mode` says."""
    path.unlink(missing_ok=True)
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        os.fchmod(handle, mode)  # whatever the umask
        file.write(text)
