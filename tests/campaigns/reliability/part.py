"""What every part of the campaign is given, and what it gives."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from tests.campaigns.document import Found
from tests.campaigns.reliability.campaign import Campaign, Maker
from tests.campaigns.reliability.rows import Row
from tests.campaigns.reliability.table import summary
from tests.campaigns.reliability.trial import Try


class Options(NamedTuple):
    """What was asked for on the command line."""

    tries: int = 20
    fields: int = 2
    """Fleets side by side."""
    only: tuple[str, ...] = ()
    """Rows whose names begin like this; all if there is none."""
    keep: Path | None = None
    """Where what was said in tries that failed is kept."""
    minutes: float = 30.0
    """Of the soak."""

    def chosen(self, name: str) -> bool:
        """Whether a row is asked for."""
        return not self.only or any(name.startswith(one) for one in self.only)


class Part(Protocol):
    """A module of this folder."""

    TITLE: str
    ABOUT: str
    """What was done, in sentences."""

    def run(self, options: Options) -> Found:
        """Do it; what was found, with ``well`` for whether all was as it should be."""

    def section(self, found: Found) -> str:
        """Tables for people."""

    def seconds(self, options: Options) -> float:
        """It takes about so long [s]."""

    def names(self) -> Sequence[str]:
        """Its rows."""


def campaign(options: Options, maker: Maker, rows: Sequence[Row]) -> tuple[Found, list[Try]]:
    """Try every chosen row as often as asked for."""
    chosen = [row for row in rows if options.chosen(row.name)]
    if not chosen:
        return {"rows": {}, "well": True}, []
    tries = Campaign(maker, chosen, options.tries, options.keep).run(options.fields)
    found = {row.name: summary(row.title, [one for one in tries if one.row == row.name]) for row in chosen}
    return {"rows": found, "well": all(not one.wrong for one in tries)}, tries
