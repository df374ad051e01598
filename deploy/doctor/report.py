"""The doctor's report: lines for people, an object for programs."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from formation.deploy.doctor.facts import Checked

TITLE_WIDTH = 13
"""Width of the column for an examination's name [characters]."""
LINE_WIDTH = 80
Checks = Mapping[str, Sequence[Checked]]
"""Results by robot (or desk)."""


class Style(NamedTuple):
    """The marks of results."""

    well: str
    ill: str
    arrow: str
    bold: str
    plain: str


PLAIN = Style("✓", "✗", "→", "", "")
ASCII = Style("+", "!", ">", "", "")
COLOUR = Style("\033[32m✓\033[0m", "\033[31m✗\033[0m", "→", "\033[1m", "\033[0m")


def words(checks: Checks, style: Style = PLAIN, width: int = LINE_WIDTH) -> str:
    """Return all results, grouped by robot."""
    lines: list[str] = []
    for name, checked in checks.items():
        lines.append(f"{style.bold}{name}{style.plain}")
        for one in checked:
            lines += _lines(one, style, width)
        lines.append("")
    ill = {name: sum(len(one.findings) for one in checked) for name, checked in checks.items()}
    found = sum(ill.values())
    if not found:
        return "\n".join([*lines, "healthy: nothing is wrong"])
    where = ", ".join(name for name, count in ill.items() if count)
    things = "1 thing is" if found == 1 else f"{found} things are"
    return "\n".join([*lines, f"{things} wrong: {where}"])


def as_object(checks: Checks) -> dict[str, Any]:
    """Return the results for programs."""
    robots = {
        name: {
            one.title: {
                "ok": not one.findings,
                "seen": one.seen,
                "findings": [f._asdict() for f in one.findings],
            }
            for one in checked
        }
        for name, checked in checks.items()
    }
    return {"ok": ok(checks), "robots": robots}


def ok(checks: Checks) -> bool:
    """Return whether there are no faults."""
    return not any(one.findings for checked in checks.values() for one in checked)


def _lines(one: Checked, style: Style, width: int) -> Iterator[str]:
    if not one.findings:
        yield from _wrapped(f"  {style.well} {one.title:<{TITLE_WIDTH}}", one.seen, width)
    for finding in one.findings:
        yield from _wrapped(f"  {style.ill} {one.title:<{TITLE_WIDTH}}", finding.sentence, width)
        yield from _wrapped(f"    {'':<{TITLE_WIDTH}}{style.arrow} ", finding.remedy, width, hang=2)


def _wrapped(head: str, text: str, width: int, hang: int = 0) -> Iterator[str]:
    column = 4 + TITLE_WIDTH
    first, *rest = textwrap.wrap(text, max(20, width - column - hang), break_on_hyphens=False) or [""]
    yield head + first
    yield from (" " * (column + hang) + line for line in rest)
