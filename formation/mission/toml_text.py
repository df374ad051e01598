"""TOML from a stranger: read within limits of length, depth and time, or refused in one sentence.

`tomllib` takes minutes for a key of ten thousand parts, fails in its own ways on long numbers and deep lists,
and has no limit of its own.
"""

from __future__ import annotations

import re
import tomllib
from typing import Any

MAX_MISSION_BYTES = 1024 * 1024
"""Longest mission file that is read [bytes]. A mission of 200 robots has a tenth of that."""
MAX_KEY_PARTS = 32
"""Parts of a dotted key, as `a.b.c` has three. No key of a mission has more than four."""
_PIECES = re.compile(
    r'"""(?:[^\\]|\\.)*?"""|\'\'\'.*?\'\'\'|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'|#[^\n]*|[\w+-]+|[ \t]+|.',
    re.DOTALL,
)


class TomlError(ValueError):
    """Text that is no TOML, or beyond the limits; a sentence says which."""


def loads(text: str) -> dict[str, Any]:
    """The tables in `text`. Raises TomlError."""
    if len(text) > MAX_MISSION_BYTES:
        raise TomlError(f"is longer than {MAX_MISSION_BYTES} bytes, the most that is read")
    if _longest_key(text) > MAX_KEY_PARTS:
        raise TomlError(f"not a mission: a key of over {MAX_KEY_PARTS} parts")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise TomlError(f"not valid TOML: {error}") from None
    except RecursionError:
        raise TomlError("not a mission: lists or tables a thousand deep") from None
    except ValueError:  # of Python's own int()
        raise TomlError("not a mission: a number of over 4300 digits") from None


def _longest_key(text: str) -> int:
    """Most names in a row with dots between them."""
    longest, names, dotted = 0, 0, True
    for piece in _PIECES.findall(text):
        if piece == ".":
            dotted = True
        elif piece[0] in "\"'" or piece[0].isalnum() or piece[0] in "_+-":
            names = names + 1 if dotted else 1
            dotted, longest = False, max(longest, names)
        elif not piece.isspace() or "\n" in piece:
            names, dotted = 0, False
    return longest
