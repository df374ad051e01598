"""Check where a mission file may be written, and write it completely or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from formation.deploy.refusal import Refusal, refused
from formation.mission.file import shipped


def write_mission(path: Path, text: str) -> None:
    """Write a file, completely or not at all; line ends are as in `text`. Raises Refusal."""
    target = Path(os.path.realpath(path))  # write to the target of a link, not the link
    try:
        mode = target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~_umask()
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
        temporary = Path(name)
        try:
            with os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
                file.write(text)
            temporary.chmod(mode)
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise Refusal(f"{path}: cannot be written: {error.strerror}") from None


def check_out(out: Path, *, force: bool) -> None:
    """Raise Refusal for a path that cannot be a mission file."""
    if out.suffix != ".toml":
        raise Refusal(f"--out {out}: must end in .toml")
    with refused(f"--out {out}"):
        if not out.parent.is_dir():
            raise Refusal(f"--out {out}: there is no folder {out.parent}")
        if is_shipped(out):
            raise Refusal(f"--out {out}: is shipped, and stays as it is; name another")
        if out.is_dir():
            raise Refusal(f"--out {out}: is a folder; name a file")
        if out.exists() and not force:
            raise Refusal(f"--out {out}: is there already; name another, or write over it with --force")


def is_shipped(mission: Path) -> bool:
    """Return whether this is a mission of the package, also through links."""
    # not Path.resolve, which has an error of its own for links in a circle
    return os.path.realpath(mission) in {os.path.realpath(path) for path in shipped().values()}


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
