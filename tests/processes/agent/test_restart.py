"""Bar: an agent that is killed while its team drives comes back without a lurch, and stopped if it was.

Over real processes, each with its watchdog. ``pytest -s`` shows every figure.
"""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path

import pytest

from formation.mission.file import read
from tests.processes.agent.returning import Team, summary_of

pytestmark = [pytest.mark.processes, pytest.mark.timeout(400)]
GONE = (0.1, 1.0, 5.0)
ROBOTS = ("robot2", "robot4", "robot5")
"""One that measures the leader alone, one in the middle, one before the last."""


def turning(folder: Path) -> Path:
    """The six robots; their leader has turned by 130 degrees before anything happens to them."""
    head, _, tail = read("six_robots")[0].partition("[[route]]")
    legs = "[[route]]\nspeed = 0.2\nheading_deg = {}\nduration = {}\n\n"
    path = folder / "mission.toml"
    rest = tail.partition("[simulation]")[2]
    text = head + legs.format(30, 4) + legs.format(160, 1e4) + "[simulation]" + rest
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("state", [True, False], ids=["with what it kept", "with nothing"])
def test_killed_agent_restarts_without_lurch(tmp_path: Path, state: bool) -> None:
    with ExitStack() as stack:
        team = Team(turning(tmp_path), tmp_path, stack, state=state)
        returns = [team.restart(robot, gone) for robot, gone in zip(ROBOTS, GONE, strict=True)]
    print(f"\n{summary_of(returns)}")
    for one in returns:
        assert one.heading < 5.0, summary_of(returns)
        assert one.share <= 1.0, summary_of(returns)
        assert one.jump <= 0.5, summary_of(returns)


def test_acknowledged_stop_persists_over_agent_and_leader_restarts(
    tmp_path: Path,
) -> None:
    with ExitStack() as stack:
        team = Team(turning(tmp_path), tmp_path, stack, state=True)
        for robot in team.mission.followers:
            assert team.ask(robot, "stop").mode == "stop"
            team.kill(f"agent {robot}")
            kept = json.loads((tmp_path / "state" / f"{robot}.stops.json").read_text())
            assert kept["mode"] == "stop"
        team.kill("leader")
        team.begin("leader")
        for robot in team.mission.followers:
            team.begin(f"agent {robot}")
        for robot in team.mission.followers:
            reply = team.ask(robot, "run")
            assert (reply.ok, reply.mode) == (False, "stop")
        for robot in team.mission.followers:
            assert team.ask(robot, "release").mode == "hold"
            assert team.ask(robot, "run").ok
        team.ask(team.mission.leader, "release")
        team.ask(team.mission.leader, "run")
        team.until(team.in_formation)
