"""Tries as rows of a table: how many were as they should be, and the middle and the worst of every figure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from tests.campaigns.figures import markdown
from tests.campaigns.reliability.judge import middle
from tests.campaigns.reliability.trial import Try

LEAST = ("nearest",)
"""Figures of which the smallest is the worst."""
METRES = " [m]"
"""Ends the name of a figure that is a distance, not a time."""
HEADER = (
    "what was done", "as it should be", "in time", "error back after", "largest command", "largest jump",
    "error then",
)  # fmt: skip


def summary(title: str, tries: Sequence[Try]) -> dict[str, Any]:
    """One row, for programs."""
    names = sorted({name for one in tries for name in one.figures})
    figures = {name: [one.figures[name] for one in tries if name in one.figures] for name in names}
    return {
        "title": title,
        "tries": len(tries),
        "well": sum(not one.wrong for one in tries),
        "wrong": dict(Counter(word for one in tries for word in one.wrong)),
        "figures": {name: _middle(name, values) for name, values in figures.items()},
        "settles": middle([one.settles for one in tries if one.settles is not None]),
        "peak": max((one.peak for one in tries), default=0.0),
        "jump": max((one.jump for one in tries), default=0.0),
        "zeros": sum(one.zeros for one in tries),
        "error": max((one.error for one in tries if one.error is not None), default=None),
    }


def table(rows: Iterable[Mapping[str, Any]]) -> str:
    """Rows for people."""
    return markdown(HEADER, [_row(row) for row in rows])


def failures(rows: Iterable[Mapping[str, Any]]) -> str:
    """What was not as it should be, if anything."""
    lines = [
        f"- {row['title']}: {what} ({times} of {row['tries']})"
        for row in rows
        for what, times in row["wrong"].items()
    ]
    return "\n".join(["Not as it should be:", "", *lines, ""]) if lines else ""


def span(figure: Mapping[str, float] | None, unit: str, digits: int = 2, scale: float = 1.0) -> str:
    """Median, and in brackets the worst."""
    if figure is None:
        return ""
    return f"{figure['median'] * scale:.{digits}f} ({figure['worst'] * scale:.{digits}f}) {unit}"


def _row(row: Mapping[str, Any]) -> tuple[str, ...]:
    figures = "; ".join(f"{_plain(name)} {span(one, _unit(name))}" for name, one in row["figures"].items())
    return (
        row["title"],
        f"{row['well']} of {row['tries']}",
        figures or "–",
        span(row["settles"], "s", 1) or ("–" if row["error"] is None else "never"),
        f"{100 * row['peak']:.0f} %",
        f"{100 * row['jump']:.0f} %",
        "–" if row["error"] is None else f"{1000 * row['error']:.1f} mm",
    )


def _unit(name: str) -> str:
    return "m" if name in LEAST or name.endswith(METRES) else "s"


def _plain(name: str) -> str:
    return name.removesuffix(METRES)


def _middle(name: str, values: Sequence[float]) -> Mapping[str, float] | None:
    if name not in LEAST:
        return middle(values)
    turned = middle([-value for value in values])
    return None if turned is None else {key: -value for key, value in turned.items()}
