from __future__ import annotations

from typing import Any

from rich.console import Console

from formation.deploy.terminal.snapshot import Progress, Snapshot
from formation.deploy.terminal.table import draw
from formation.monitor.metrics.words import as_json
from tests.support.monitored import with_standbys
from tests.unit.monitor.metrics.test_leading import Team


def drawn(event: dict[str, Any], width: int = 90, *, dead: str = "", ascii_only: bool = False) -> str:
    progress = Progress(with_standbys(), phase="running", dead_robots={dead} - {""})
    progress.add_snapshot(Snapshot.of(event))
    console = Console(width=width, height=30, color_system=None, force_terminal=False)
    with console.capture() as capture:
        console.print(draw(progress, width, 30, ascii_only=ascii_only))
    return capture.get()


def seen() -> dict[str, Any]:
    """What the monitor's snapshot says once spare1 has taken robot1's place."""
    team = Team(12.0)
    team.fail_over()
    return as_json(team.seen)


def test_leader_and_candidates_are_below_the_table() -> None:
    text = drawn(seen())
    assert "robot1 lost  spare1 leads  spare2 standby" in text
    assert "robot1 (spare1)" in text


def test_dead_leader_process_is_shown_beside_new_leader() -> None:
    text = drawn(seen(), dead="robot1")
    row = next(line for line in text.splitlines() if line.startswith("robot1 ("))
    assert "run" in row
    assert "dead" not in row
    assert "robot1 dead  spare1 leads" in text


def test_only_unusual_conditions_have_a_line() -> None:
    event = seen()
    plain = drawn(event)
    for word in ("waits", "turned", "in place of"):
        assert word not in plain
    event |= {"waits": "robot4", "rotation": 0.5, "scale": 1.5, "formed": False}
    event["robots"]["robot4"] |= {"unavailable": True, "state": "run"}
    event["robots"]["robot6"] |= {"fallback": "robot3"}
    text = drawn(event)
    assert "the leader waits for robot4" in text
    assert "hexagon turned by 28.6°, 1.5 times as large, on its way" in text
    assert "in place of lost neighbours: robot6 follows robot3" in text
    assert next(line for line in text.splitlines() if line.startswith("robot4")).split()[1] == "unavail"
    assert "°" not in drawn(event, ascii_only=True).splitlines()[-4]
