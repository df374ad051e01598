"""What every benchmark does with its numbers: percentiles, medians over rounds, and tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np


class Over(NamedTuple):
    """One figure over several rounds: the median, and between which values the rounds lie."""

    median: float
    low: float
    high: float


def tail(values: Sequence[float]) -> dict[str, float]:
    """The middle and the upper end of a distribution of at least one value."""
    middle, upper, last = np.percentile(values, (50.0, 90.0, 99.0)).tolist()
    return {"p50": middle, "p90": upper, "p99": last, "max": float(max(values))}


def over_rounds(rounds: Sequence[Any]) -> Any:
    """The same tree of dicts as each round is, with an `Over` for each number."""
    if isinstance(rounds[0], dict):
        return {key: over_rounds([one[key] for one in rounds]) for key in rounds[0]}
    return Over(float(np.median(rounds)), float(min(rounds)), float(max(rounds)))


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; the first column is text, the others are numbers."""
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
