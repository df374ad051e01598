"""Rules of what robots have acknowledged, and of other agents: what breaks them is found."""

from __future__ import annotations

from typing import Any

import pytest

from formation.agent.persistence.restore import Persistence
from formation.agent.safety import failsafe
from formation.deploy.rehearsal import rehearsal
from formation.deploy.rehearsal.faults import parse
from formation.deploy.rehearsal.fleet import AgentFiles
from formation.deploy.rehearsal.rehearsal import Plan, run
from formation.deploy.rehearsal.rules import judge
from formation.protocol.order import OperatorRequest
from formation.protocol.reasons import Code
from formation.protocol.stops import Rest, Result
from tests.support.missions import with_robots

PAIR = with_robots("turtlebot3_pair", avoid="all")


def broken(*faults: str) -> set[str]:
    return run(Plan(PAIR), 0, tuple(parse(one, PAIR) for one in faults)).broken


def without_row(monkeypatch: pytest.MonkeyPatch, code: Code) -> None:
    """Take the first row with this plain reason out of the failsafe table, or the one for other missions."""
    rows = [
        row for row in failsafe.TABLE if not (code is Code.OTHER_MISSION and row.reason is failsafe._mixed)
    ]
    names = [one for one in rows if "_plain" not in one.reason.__qualname__ or not _has(one, code)]
    monkeypatch.setattr(failsafe, "TABLE", tuple(names))


def _has(row: failsafe.Row, code: Code) -> bool:
    facts: Any = None
    return row.reason(facts).code == code


def test_release_that_starts_motion_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken("robot1:stop@5+3") == set()

    def release(rest: Rest, *_: Any) -> Result:
        rest.stop = ""
        return Result(ok=True)

    monkeypatch.setattr(Rest, "_release", release)
    assert "release" in broken("robot1:stop@5+3")


def test_team_that_is_never_released_has_not_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    def release(_rest: Rest, _request: OperatorRequest, _fact: str) -> Result:
        return Result(ok=False, code="another")

    monkeypatch.setattr(Rest, "_release", release)
    monkeypatch.setattr(rehearsal, "RECOVERY_TIME", 5.0)
    monkeypatch.setattr(judge, "RECOVERY_TIME", 5.0)
    assert "formation" in broken("robot1:stop@12+3")


def test_robot_with_two_agents_that_drives_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken("robot1:second@5+4") == set()
    without_row(monkeypatch, Code.SECOND_AGENT)
    assert "alone" in broken("robot1:second@5+4")


def test_robot_that_drives_beside_another_mission_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken("robot2:mixed@5+4") == set()
    without_row(monkeypatch, Code.OTHER_MISSION)
    assert "mission" in broken("robot2:mixed@5+4")


def test_stop_that_is_not_saved_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert broken("robot1:full@4+5", "robot1:stop@5+2") == set()
    monkeypatch.setattr(AgentFiles, "written", lambda *_: True)
    assert "stop" in broken("robot1:full@4+5", "robot1:stop@5+2")


def test_stop_that_is_never_written_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Persistence, "requested", lambda _: None)
    assert "stop" in broken("robot1:stop@5+2")
