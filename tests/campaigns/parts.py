"""What campaigns of several parts share: their command line, and tables."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from tests.campaigns.document import count, one_of
from tests.campaigns.figures import markdown


def command_line(
    campaign: str, about: str | None, epilog: str, parts: Iterable[str], quick: str, jobs: int = 1
) -> argparse.ArgumentParser:
    """Takes PART ..., which may be none, --quick and --jobs; `quick` says what a short run is."""
    parts = list(parts)
    flags = argparse.ArgumentParser(
        prog=f"python -m tests.campaigns.{campaign}",
        description=about,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    flags.add_argument("parts", metavar="PART", nargs="*", type=one_of(parts), help=f"of {', '.join(parts)}")
    flags.add_argument("--quick", action="store_true", help=f"{quick}, printed only")
    flags.add_argument(
        "--jobs", type=count(64), default=jobs, metavar="N", help=f"side by side (default: {jobs})"
    )
    return flags


def table(header: str, rows: Iterable[str]) -> str:
    """A table in Markdown; its columns are separated by " | " in the header and in each row."""
    return markdown(header.split(" | "), [row.split(" | ") for row in rows])
