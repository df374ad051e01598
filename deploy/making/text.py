"""The text of a mission file: values set in it while all else stays as it was written, and the file kept."""

from __future__ import annotations

import os
import re
import tempfile
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from deploy.refusal import Refusal, refused
from formation.mission_file import shipped


class Change(NamedTuple):
    """``key`` in ``[group.name]`` becomes a list, or a word; nothing where that holds anyway."""

    group: str
    name: str
    key: str
    value: tuple[Any, ...] | str
    otherwise: tuple[Any, ...] | str = ()
    """What holds where the table says nothing."""


def edited(text: str, changes: Iterable[Change]) -> str:
    """A mission's TOML with these lists in it; comments, order and all other values are as before.

    Raises ValueError, with where, for a list that is not on lines of its own in a table with a header.
    """
    wanted = tomllib.loads(text)
    made = []
    for change in changes:
        table = wanted[change.group][change.name]
        value = _plain(change.value)
        if table.get(change.key, _plain(change.otherwise)) == value:
            continue
        if change.value != change.otherwise:
            table[change.key] = value
        else:
            del table[change.key]
        text = _changed(text, change)
        made.append(change)
    if not _says(text, wanted):  # a bracket in a comment inside a list, or the like
        raise ValueError(_where(made[0]))
    return text


def keep(path: Path, text: str) -> None:
    """Write a file, all of it or nothing; line ends are as in `text`. Raises Refusal."""
    target = Path(os.path.realpath(path))  # what a link points to, not the link
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
    """Raise Refusal for a file that a mission cannot be kept in."""
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
    """Whether this is a mission of the package, by whatever way and links."""
    # not Path.resolve, which has an error of its own for links in a circle
    return os.path.realpath(mission) in {os.path.realpath(path) for path in shipped().values()}


def _says(text: str, wanted: dict[str, Any]) -> bool:
    try:
        return tomllib.loads(text) == wanted
    except tomllib.TOMLDecodeError:
        return False


def _changed(text: str, change: Change) -> str:
    """`text` with one list set, added or taken out. Raises ValueError."""
    header = re.compile(
        rf"^[ \t]*\[[ \t]*{change.group}[ \t]*\.[ \t]*{change.name}[ \t]*\][^\n]*\n", re.MULTILINE
    )
    found = header.search(text)
    if found is None:
        raise ValueError(_where(change))
    after = re.compile(r"^[ \t]*\[\[?[ \t]*\w", re.MULTILINE).search(text, found.end())
    begin, end = found.end(), after.start() if after else len(text)
    return text[:begin] + _in_table(text[begin:end], change) + text[end:]


def _in_table(lines: str, change: Change) -> str:
    value, said = _toml(change.value), change.value != change.otherwise
    own = re.compile(
        rf"^([ \t]*{change.key}[ \t]*=[ \t]*)(?:\[[^\]]*\]|\"[^\"\n]*\"|'[^'\n]*')([^\n]*\n?)", re.MULTILINE
    )
    if own.search(lines):
        return own.sub(lambda line: f"{line[1]}{value}{line[2]}" if said else "", lines, count=1)
    # a new list goes under the one that it belongs with
    beside = re.compile(r"^([ \t]*)neighbours[ \t]*=[ \t]*\[[^\]]*\][^\r\n]*(\r?\n|\Z)", re.MULTILINE)
    if not beside.search(lines):
        raise ValueError(_where(change))
    return beside.sub(
        lambda line: f"{line[0]}{'' if line[2] else chr(10)}{line[1]}{change.key} = {value}{line[2]}",
        lines,
        count=1,
    )


def _plain(value: tuple[Any, ...] | str) -> list[Any] | str:
    """As TOML is read."""
    return value if isinstance(value, str) else list(value)


def _toml(value: tuple[Any, ...] | str) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    return "[" + ", ".join(_toml(one) if isinstance(one, str) else repr(one) for one in value) + "]"


def _where(change: Change) -> str:
    return f"{change.group}.{change.name}.{change.key}"


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
