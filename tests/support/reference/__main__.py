"""`python -m tests.support.reference`: write the generated pages of docs/reference."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.support.reference.pages import PAGES


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
