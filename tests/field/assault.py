"""Helpers for tests of attacks: run one, and check that it has no effect."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.field.team import VICTIM, Band, Team, longest_gap, mission
from tests.support.namespaces import until

LASTS = 2.0
"""Duration of an attack [s]."""
SILENCE = 0.3
"""The watchdog stops the robot after such a gap of commands; no attack may cause one [s]."""


def link(team: Team, name: str, victim: str = VICTIM, identity: Path | None = None) -> dict[str, Any]:
    """Arguments for a link with the victim: with the key of `name`, or the one in `identity`."""
    folder = team.desk.folder / name
    return {
        "identity": str(identity or folder),
        "trusted": str(folder / "ca.pem"),
        "victims": [team.desk.endpoint(victim)],
        "team": mission().team,
    }


def usual(team: Team) -> Band:
    """Wait until the victim drives settled; return the range of its commands."""
    until(team.settled, what="settled before the attack")
    return Band.of(team.commands()[-40:])


@contextmanager
def without_effect(team: Team) -> Iterator[None]:
    """Check that the body changes no command and no state of the victim."""
    band = usual(team)
    start = time.monotonic()
    yield
    end = time.monotonic()
    until(lambda: team.commands(since=end), what="a command after the attack")
    during = team.commands(since=start)
    assert len(during) > 15 * (end - start), "commands are missing"
    assert longest_gap(during) < SILENCE
    assert [command for command in during if not band.holds(command)] == [], band
    assert team.states(since=start) <= {"run"}


def wait_for_refusals(team: Team, kind: str, before: dict[str, int], by: int = 1) -> None:
    """Wait until the victim's status counts at least `by` more refusals of `kind`."""
    until(
        lambda: team.refused().get(kind, 0) - before.get(kind, 0) >= by,
        what=f"{by} more of {kind!r}; refused: {team.refused()}",
    )
