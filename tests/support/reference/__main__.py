"""`python -m tests.support.reference`: write the generated pages of docs/reference."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from tests.support.reference import commands, mission_keys, states

PAGES: Mapping[str, Callable[[], str]] = {
    "mission-keys.md": mission_keys.page, "commands.md": commands.page, "states.md": states.page,
}  # fmt: skip
REGENERATE = "python3 deploy/env.py python -m tests.support.reference"
"""Writes them all, in a clone of the repository."""


def main() -> int:
    """Write every page into docs/reference of the current directory; the exit code."""
    folder = Path("docs", "reference")
    if not folder.is_dir():
        print("formation: no docs/reference here: run this in a clone of the repository", file=sys.stderr)
        return 2
    for name, page in PAGES.items():
        (folder / name).write_text(page(), encoding="utf-8")
        print(folder / name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
