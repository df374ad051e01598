"""`formation watch` at the desk of a team under certificates."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.field.team import Team, driving

pytestmark = [pytest.mark.processes, pytest.mark.namespaces, pytest.mark.timeout(300)]


def watched(team: Team, *flags: str) -> tuple[int, str, str]:
    """One look: exit code, output, errors."""
    done = team.desk_computer.run(*team.formation("watch", "--once", *flags))
    return done.returncode, done.stdout, done.stderr


def test_only_monitor_certificate_can_watch_the_team(tmp_path: Path) -> None:
    with driving(tmp_path) as team:
        code, out, errors = watched(team, "--json", "-c", str(team.desk.file("monitor")))
        states = {name: robot["state"] for name, robot in json.loads(out)["robots"].items()}
        assert set(states) == {"leader", "robot1", "robot2", "robot3"}, errors
        assert states.pop("robot3") == "unseen"  # which is not here
        assert set(states.values()) <= {"run", "hold"}  # a moment's hold, where this machine stood still
        assert code == 1

        code, out, errors = watched(team)
        assert (code, out) == (1, "")
        assert "no process answers at tls/" in errors
        assert "-c FILE" in errors
        assert team.states(0.0) - {"waiting", "hold"} == {"run"}  # none of which has disturbed anybody
