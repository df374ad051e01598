"""Mission files with a few keys changed."""

from __future__ import annotations

import re


def edited(text: str, table: str, keys: str) -> str:
    """`text` with the lines `keys` in its `table`, in place of what it says of the same keys there."""
    head, mark, rest = text.partition(f"[{table}]")
    assert mark, f"no table {table}"
    end = re.search(r"^\[", rest, re.MULTILINE)
    body, tail = (rest[: end.start()], rest[end.start() :]) if end else (rest, "")
    for key in re.findall(r"^(\w+) *=", keys, re.MULTILINE):
        body = re.sub(rf"^{key} *=.*\n", "", body, flags=re.MULTILINE)
    return f"{head}{mark}{body.rstrip()}\n{keys}\n\n{tail}"
