"""What every benchmark does with its numbers: percentiles, medians over rounds, and tables in Markdown."""

from __future__ import annotations

import argparse
import json
import operator
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from textwrap import fill
from typing import Any, NamedTuple

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


def at(tree: Any, path: str) -> Any:
    """What a tree of dicts has at a path such as ``ratio/cost to copy``; None where a key is missing."""
    for key in path.split("/"):
        tree = (tree or {}).get(key)
    return tree


def span(figure: dict[str, float], digits: int, unit: str = "", scale: float = 1.0) -> str:
    """A figure `over_rounds`, as a table has it: ``2.41× (2.30–2.55)``."""
    median, low, high = (scale * figure[key] for key in ("median", "low", "high"))
    rounds = f" ({low:.{digits}f}–{high:.{digits}f})" if low != high else ""
    return f"{median:.{digits}f}{unit}{rounds}"


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; the first column is text, the others are numbers."""
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


class Column(NamedTuple):
    """A column of figures `over_rounds`."""

    head: str
    path: str
    digits: int
    unit: str = ""
    spread: bool = True
    """Whether the lowest and the highest round are shown."""

    def cell(self, tree: Any) -> str:
        """What this column has of one row."""
        figure = at(tree, self.path)
        if self.spread:
            return span(figure, self.digits, self.unit)
        return f"{figure['median']:.{self.digits}f}{self.unit}"


def table(first: str, rows: Mapping[str, Any], columns: Sequence[Column]) -> str:
    """A table of figures `over_rounds`, by the name of each row."""
    header = [first, *(column.head for column in columns)]
    return markdown(header, [[name, *(column.cell(one) for column in columns)] for name, one in rows.items()])


def verdict(met: bool) -> str:
    """What is said of a figure that was to come to something."""
    return "met" if met else "falls short"


def judged(rows: Iterable[tuple[str, str, str, bool | None]]) -> str:
    """A table of figures: what, today's, the target, and whether it is met; None for what has no figure."""
    return markdown(
        ("figure", "today", "target", ""),
        [(*result, "" if met is None else verdict(met)) for *result, met in rows],
    )


class Bar(NamedTuple):
    """What the median of a figure is to come to."""

    what: str
    path: str
    sign: str
    """``≤``, ``<`` or ``≥`` the bound."""
    bound: float
    digits: int
    unit: str
    scale: float = 1.0

    def row(self, found: Any) -> tuple[str, str, str, bool | None]:
        """What `judged` shows of it."""
        figure, wanted = at(found, self.path), f"{self.sign} {self.bound:g}{self.unit}"
        if not figure:
            return self.what, "not measured", wanted, None
        holds = {"≤": operator.le, "<": operator.lt, "≥": operator.ge}[self.sign]
        met: bool = holds(self.scale * figure["median"], self.bound)
        return self.what, span(figure, self.digits, self.unit, self.scale), wanted, met


def flags(description: str | None, rounds: int = 5) -> argparse.ArgumentParser:
    """The flags of every benchmark."""
    parser = worded(description)
    parser.add_argument("--rounds", type=int, default=rounds)
    parser.add_argument("--quick", action="store_true", help="one short round; the figures mean little")
    parser.add_argument("--json", action="store_true", help="figures for programs, not for people")
    return parser


def worded(description: str | None) -> argparse.ArgumentParser:
    """A parser whose help is a module's docstring as it stands."""
    return argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def command(
    description: str | None,
    measure: Callable[..., Any],
    section: Callable[[Any], str],
    rounds: int = 5,
    **quick: Any,
) -> None:
    """Measure so many rounds and print what was found; a quick one is measured with the arguments `quick`."""
    given = flags(description, rounds).parse_args()
    found = measure(1, **quick) if given.quick else measure(given.rounds)
    show(found, section, as_json=given.json)


def filled(*words: str) -> str:
    return fill(" ".join(" ".join(words).split()), 110, break_on_hyphens=False) + "\n"


def progress(words: str) -> None:
    print(words, file=sys.stderr, flush=True)


def show(found: Any, section: Callable[[Any], str], *, as_json: bool) -> None:
    print(json.dumps(found) if as_json else section(found))
