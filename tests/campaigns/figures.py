"""What every benchmark does with its numbers: percentiles, medians over rounds, and tables in Markdown."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np


def tail(values: Sequence[float]) -> dict[str, float]:
    """The middle and the upper end of a distribution of at least one value."""
    middle, upper, last = np.percentile(values, (50.0, 90.0, 99.0)).tolist()
    return {"p50": middle, "p90": upper, "p99": last, "max": float(max(values))}


def over_rounds(rounds: Sequence[Any]) -> Any:
    """The same tree of dicts as each round is, with median, lowest and highest in place of each number."""
    if isinstance(rounds[0], dict):
        return {key: over_rounds([one[key] for one in rounds]) for key in rounds[0]}
    return {"median": float(np.median(rounds)), "low": float(min(rounds)), "high": float(max(rounds))}


def rounded(tree: Any) -> Any:
    """The same tree with five significant digits, which is more than any of these numbers has."""
    if isinstance(tree, dict):
        return {key: rounded(value) for key, value in tree.items()}
    if isinstance(tree, list):
        return [rounded(value) for value in tree]
    return float(f"{tree:.5g}") if isinstance(tree, float) else tree


def span(figure: dict[str, float], digits: int, unit: str = "") -> str:
    """A figure `over_rounds`, as a table has it: ``2.41× (2.30–2.55)``."""
    return (
        f"{figure['median']:.{digits}f}{unit} ({figure['low']:.{digits}f}–{figure['high']:.{digits}f})"
        if figure["low"] != figure["high"]
        else f"{figure['median']:.{digits}f}{unit}"
    )


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; the first column is text, the others are numbers."""
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def verdict(met: bool) -> str:
    """What is said of a figure that was to come to something."""
    return "met" if met else "falls short"


def judged(rows: Iterable[tuple[str, str, str, bool | None]]) -> str:
    """A table of figures: what, today's, the target, and whether it is met; None for what has no figure."""
    return markdown(
        ("figure", "today", "target", ""),
        [(*result, "" if met is None else verdict(met)) for *result, met in rows],
    )


def flags(description: str | None) -> argparse.ArgumentParser:
    """The flags of every benchmark."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="figures for programs, not for people")
    return parser


def filled(*words: str) -> str:
    return fill(" ".join(" ".join(words).split()), 110, break_on_hyphens=False) + "\n"


def curve_flags(description: str | None, rounds: int) -> argparse.ArgumentParser:
    """The flags of a benchmark that draws curves and has a short form of its own."""
    parser = flags(description)
    parser.set_defaults(rounds=rounds)
    parser.add_argument("--quick", action="store_true", help="one short round; the figures mean little")
    parser.add_argument("--draw", type=Path, metavar="FOLDER", help="put its curves there, as SVG")
    return parser


def progress(words: str) -> None:
    print(words, file=sys.stderr, flush=True)


def show(found: Any, section: Callable[[Any], str], *, as_json: bool) -> None:
    print(json.dumps(found) if as_json else section(found))
