"""Set values in a mission's TOML; comments, order and layout stay as they were."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from typing import Any, NamedTuple

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable


class Change(NamedTuple):
    """A new list or word for ``key`` in ``[group.name]``; no edit if it already has that value."""

    group: str
    name: str
    key: str
    value: tuple[Any, ...] | str
    otherwise: tuple[Any, ...] | str = ()
    """The default if the table has no such key."""


def edited(text: str, changes: Iterable[Change]) -> str:
    """Return a mission's TOML with these values; comments, order, layout and all other values stay.

    Raises ValueError, with the first key, if that cannot be done in place.
    """
    document: Any = tomlkit.parse(text)
    wanted, made = tomllib.loads(text), []
    newline = "\r\n" if "\r\n" in text else "\n"
    try:
        for change in changes:
            value, plain = _plain(change.value), wanted[change.group][change.name]
            if plain.get(change.key, _plain(change.otherwise)) == value:
                continue
            made.append(f"{change.group}.{change.name}.{change.key}")
            table = document[change.group][change.name]
            if change.value == change.otherwise:
                del plain[change.key], table[change.key]
                continue
            plain[change.key] = value
            if change.key in table:
                table[change.key] = value
            else:
                _add(table, change.key, value, newline)
        after = tomlkit.dumps(document)
        if tomllib.loads(after) == wanted:
            return after
    except (TOMLKitError, tomllib.TOMLDecodeError):
        pass
    raise ValueError(made[0])


def _add(table: Any, key: str, value: list[Any] | str, newline: str) -> None:
    """Add a key to a robot's table, on the line after its neighbours; to an inline table at its end."""
    if isinstance(table, InlineTable):
        table.append(key, value)
        return
    item, beside = tomlkit.item(value), table.item("neighbours")
    item.trivia.indent, item.trivia.trail = beside.trivia.indent, beside.trivia.trail
    beside.trivia.trail = beside.trivia.trail or newline  # at the end of the file there may be none
    # append() would put it behind the comments that belong to the next table
    table.value._insert_after("neighbours", key, item)  # noqa: SLF001


def _plain(value: tuple[Any, ...] | str) -> list[Any] | str:
    """Return the value as read from TOML."""
    return value if isinstance(value, str) else list(value)
