"""Compare two runs: number by number, and whether they are comparable at all."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, NamedTuple

from formation.mission.model import Mission
from formation.monitor.report import words
from formation.monitor.report.gather import Run
from formation.monitor.report.summary import items

MAX_DIFFERENCES = 12
"""Number of differences of two missions that are listed."""


class Row(NamedTuple):
    """One number of both runs."""

    title: str
    first: str
    second: str
    ratio: str
    """Ratio of the second to the first."""


def verdict(first: Run, second: Run) -> str:
    """Return in a sentence which run settled sooner."""
    a, b = first.snapshot.settled_at, second.snapshot.settled_at
    if a is None or b is None:
        times = [words.seconds(time) if time is not None else "never" for time in (a, b)]
        return f"Settled for good: A {times[0]}, B {times[1]}."
    by = f" ({words.ratio(max(a, b) / min(a, b))})" if min(a, b) > 0.0 else ""
    sooner, later = ("A", "B") if a <= b else ("B", "A")
    return f"{sooner} settled after {words.seconds(min(a, b))}, {later} after {words.seconds(max(a, b))}{by}."


def rows(first: Run, second: Run) -> Iterator[Row]:
    """Yield every number of either run."""
    for a, b in zip(items(first), items(second), strict=True):
        if a.value is not None or b.value is not None:
            yield Row(a.title, a.text, b.text, words.ratio(_ratio(a.value, b.value)))


def robot_rows(first: Run, second: Run) -> Iterator[Row]:
    """Yield the RMS error of every follower in both runs."""
    for name in first.mission.followers:
        if name in second.robots:
            a, b = first.robots[name].error.whole.rms, second.robots[name].error.whole.rms
            yield Row(name, words.length(a), words.length(b), words.ratio(_ratio(a, b)))


def differences(first: Mission, second: Mission) -> list[str]:
    """Return the differences of two missions except law and name, as `key: one, other`."""
    a, b = first.model_dump(mode="json"), second.model_dump(mode="json")
    for one in (a, b):
        one["law"].pop("kind")
        one.pop("name")
    return list(_differ("", a, b))


def shortened(different: list[str]) -> list[str]:
    """Return the first `MAX_DIFFERENCES` of them, and the number of others."""
    more = len(different) - MAX_DIFFERENCES
    return different if more <= 0 else [*different[:MAX_DIFFERENCES], f"… and {more} more"]


def _differ(where: str, a: Any, b: Any) -> Iterator[str]:
    if isinstance(a, dict) and isinstance(b, dict):
        for key in [*a, *(key for key in b if key not in a)]:
            below = f"{where}.{key}" if where else key
            if key not in a or key not in b:
                yield f"{below}: only in {'A' if key in a else 'B'}"
            else:
                yield from _differ(below, a[key], b[key])
    elif a != b:
        yield f"{where}: {_short(a)} in A, {_short(b)} in B"


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:59]}…"


def _ratio(a: float | None, b: float | None) -> float | None:
    return b / a if a and b is not None else None
