"""What attacks on a team have in common: how they are made, and what must come of each."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.field.team import VICTIM, Band, Team, longest_gap, mission
from tests.support.namespaces import until

BEFORE = 2.0
"""So long before an attack commands are what they are without one [s]."""
LASTS = 2.0
"""How long an attack goes on [s]."""
SILENCE = 0.3
"""The watchdog would stop the robot after that; nobody's attack may keep commands away so long [s]."""


def link(team: Team, name: str, victim: str = VICTIM, identity: Path | None = None) -> dict[str, Any]:
    """How the attacker links with the victim: with the key of `name`, or another one."""
    folder = team.desk.folder / name
    return {
        "identity": str(identity or folder),
        "trusted": str(folder / "ca.pem"),
        "victims": [team.desk.endpoint(victim)],
        "team": mission().team,
    }


@contextmanager
def without_effect(team: Team) -> Iterator[None]:
    """What happens in here must not show in any command, nor in the state of the victim."""
    until(team.settled, what="settled before the attack")
    time.sleep(BEFORE)
    start = time.monotonic()
    usual = team.commands(since=start - BEFORE)
    band = Band.of(usual)
    yield
    end = time.monotonic()
    until(lambda: team.commands(since=end), what="a command after the attack")
    during = team.commands(since=start)
    assert len(during) > 15 * (end - start), "commands were kept away"
    assert longest_gap(during) < SILENCE
    assert [command for command in during if not band.holds(command)] == [], band
    assert team.states(since=start) <= {"run"}


def attack(team: Team, kind: str, **how: Any) -> Any:
    """Attack, to the end; what the attacker knows of its success."""
    running = team.attack(kind, **how)
    done = running.event("done")["result"]
    assert running.wait() == 0, running.errors
    return done


def rises(team: Team, kind: str, before: dict[str, int], by: int = 1) -> None:
    """The victim's status soon says that so many more were refused."""
    until(
        lambda: team.refused().get(kind, 0) - before.get(kind, 0) >= by,
        what=f"{by} times {kind!r}; there is {team.refused()}",
    )
