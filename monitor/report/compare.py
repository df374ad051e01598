"""Two runs beside each other: number by number, and whether they may be compared at all."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, NamedTuple

from formation.mission import Mission
from monitor.report import words
from monitor.report.gather import Run
from monitor.report.summary import items

MOST = 12
"""Differences of two missions that are spelled out."""


class Row(NamedTuple):
    """One number of both runs."""

    title: str
    first: str
    second: str
    ratio: str
    """Of the second to the first."""


def verdict(first: Run, second: Run) -> str:
    """Which one settled sooner, in a sentence."""
    a, b = first.snapshot.settled_at, second.snapshot.settled_at
    if a is None or b is None:
        told = [words.seconds(time) if time is not None else "never" for time in (a, b)]
        return f"Settled for good: A {told[0]}, B {told[1]}."
    by = f" ({words.ratio(max(a, b) / min(a, b))})" if min(a, b) > 0.0 else ""
    sooner, later = ("A", "B") if a <= b else ("B", "A")
    return f"{sooner} settled after {words.seconds(min(a, b))}, {later} after {words.seconds(max(a, b))}{by}."


def rows(first: Run, second: Run) -> Iterator[Row]:
    """Every number that either has."""
    for a, b in zip(items(first), items(second), strict=True):
        if a.value is not None or b.value is not None:
            yield Row(a.title, a.text, b.text, words.ratio(_ratio(a.value, b.value)))


def robot_rows(first: Run, second: Run) -> Iterator[Row]:
    """RMS error of every follower that both have."""
    for name in first.mission.followers:
        if name in second.robots:
            a, b = first.robots[name].error.whole.rms, second.robots[name].error.whole.rms
            yield Row(name, words.length(a), words.length(b), words.ratio(_ratio(a, b)))


def differences(first: Mission, second: Mission) -> list[str]:
    """Where two missions differ beyond their law and their name, as `key: one, other`; empty if nowhere."""
    a, b = first.model_dump(mode="json"), second.model_dump(mode="json")
    for one in (a, b):
        one["law"].pop("kind")
        one.pop("name")
    return list(_differ("", a, b))


def told(different: list[str]) -> list[str]:
    """The first few of them, and how many more there are."""
    more = len(different) - MOST
    return different if more <= 0 else [*different[:MOST], f"… and {more} more"]


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
