"""What campaigns write into docs/: figures as JSON, and the same in Markdown, part by part."""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tests.campaigns.figures import filled, rounded

Found = dict[str, Any]
"""Figures of a part, as they stand in a JSON file of docs/: plain dicts, lists, numbers and words."""
DOCS = Path(__file__).parents[2] / "docs"
COMMAND = "python3 deploy/env.py python -m tests.campaigns"


def head(title: str, name: str, words: str) -> str:
    """The beginning of docs/NAME.md, a blank line at its end; `name` is not always that of the campaign."""
    campaign = {"benchmarks": "bench", "yardstick": "bench.yardstick"}.get(name, name)
    about = f"Written, with [the same figures for programs]({name}.json), by"
    return f"# {title}\n\n{about}\n\n```sh\n{COMMAND}.{campaign}\n```\n\n{words}"


def section(campaign: str, name: str, title: str, one: Mapping[str, Any], *words: str) -> str:
    """One part: how it is run, when, where and how long it was, and what is said of it.

    Its `note` says which of its figures are of another commit.
    """
    load = f", load {one['load']:.1f} before" if "load" in one else ""
    took = f"{load}; {one['took'] / 60.0:.0f} min" if "took" in one else ""
    where = f"{one['date']}, commit {one['commit']}, {one['machine']}{took}."
    notes = [filled(one["note"]).strip()] if "note" in one else []
    return "\n\n".join([f"## {title}", f"```sh\n{COMMAND}.{campaign} {name}\n```", where, *notes, *words])


def stamp(found: Mapping[str, Any], tries: int, seconds: float) -> Found:
    """A part's figures with when, where and how often."""
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": commit(),
        "machine": machine(),
        "tries": tries,
        "took": seconds,
        **found,
    }


def update(path: Path, found: Mapping[str, Any], order: Iterable[str], *, ascii_only: bool = True) -> Found:
    """Put `found` in place of what these parts had found before; what all parts have, in this `order`."""
    before = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    every = {**before, **rounded(dict(found))}
    ordered = {name: every[name] for name in order if name in every}
    path.write_text(json.dumps(ordered, indent=1, ensure_ascii=ascii_only) + "\n", encoding="utf-8")
    return ordered


def commit() -> str:
    """Of this checkout; with a + if anything but docs/ has been changed since."""
    git = ("git", "-C", str(DOCS.parent))
    name = subprocess.run([*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    changes = (*git, "status", "--porcelain", "--untracked-files=no", "--", ":(top)", ":(top,exclude)docs")
    dirty = subprocess.run(changes, capture_output=True, text=True, check=False)
    return name.stdout.strip() + "+" * bool(dirty.stdout.strip()) if name.returncode == 0 else "unknown"


def machine() -> str:
    cores, python = f"{os.cpu_count()} cores of {platform.machine()}", platform.python_version()
    return f"{cores}, {platform.system()}, Python {python}, eclipse-zenoh {version('eclipse-zenoh')}"


def one_of(names: Iterable[str]) -> Callable[[str], str]:
    """The type of an argument that is one of `names`; `choices` refuses a list that may be empty."""
    known = list(names)

    def name(text: str) -> str:
        if text not in known:
            raise argparse.ArgumentTypeError(f"{text!r}: must be one of {', '.join(known)}")
        return text

    return name


def count(most: int) -> Callable[[str], int]:
    """The type of an argument that is a whole number from 1 to `most`."""

    def number(text: str) -> int:
        value = int(text) if text.isdecimal() else 0
        if not 1 <= value <= most:
            raise argparse.ArgumentTypeError(f"{text!r}: must be a whole number from 1 to {most}")
        return value

    return number
