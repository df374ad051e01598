"""Stop and hold of a robot survive restarts of agent and machine; an unreadable file is a stop."""

from __future__ import annotations

import json

import pytest

from formation.mission.file import load
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from tests.support.restarting import Drawer, Team, driving

SIX = load("six_robots")
BEFORE = {Code.STOPPED_BEFORE_START, Code.HELD_BEFORE_START}


def state_of(team: Team) -> AgentState:
    return team.agents["robot3"].decision.state


@pytest.fixture
def team() -> Team:
    return driving(SIX, 5.0)


@pytest.mark.slow
@pytest.mark.parametrize(("do", "state"), [("stop", AgentState.STOP), ("hold", AgentState.HOLD)])
@pytest.mark.parametrize("boot", ["this very boot", "another"])
def test_operator_stop_persists_over_restarts_until_released(
    team: Team, do: str, state: AgentState, boot: str
) -> None:
    assert team.tell("robot3", do).ok
    team.run(0.5)
    for rest, ends in ((state, None), (state, "release"), (AgentState.HOLD, "run")):
        team.replace("robot3", boot=boot)
        team.run(3.0)
        assert state_of(team) is rest
        assert team.agents["robot3"].decision.reason.code in BEFORE
        assert team.last_command("robot3") == (0.0, 0.0)
        assert ends is None or team.tell("robot3", ends).ok
    team.run(1.0)
    assert state_of(team) is AgentState.RUN
    team.replace("robot3", boot=boot)
    team.run(1.0)
    assert state_of(team) is AgentState.RUN


@pytest.mark.slow
def test_release_after_restart_must_name_the_stop(team: Team) -> None:
    team.tell("robot3", "stop", id="s2")
    team.replace("robot3")
    assert team.tell("robot3", "release", id="r1", ends=("s1",)).code == "another"
    assert team.tell("robot3", "release", id="r2", ends=("s1", "s2")).mode == "hold"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "state"), [("stop", AgentState.STOP), ("hold", AgentState.HOLD), (None, AgentState.RUN)]
)
def test_stops_file_without_holding_restores_its_mode(
    team: Team, mode: str | None, state: AgentState
) -> None:
    team.tell("robot3", "run")
    kept = json.loads(team.drawers["robot3"].texts["stops"])
    assert "holding" not in kept, "an earlier version of the program can read it"
    team.lose("robot3", 1.0)
    team.drawers["robot3"].texts["stops"] = json.dumps({**kept, "mode": mode}).encode()
    team.begin("robot3")
    team.run(1.0)
    assert state_of(team) is state


def test_acknowledged_stop_survives_immediate_kill_of_agent(team: Team) -> None:
    assert team.tell("robot3", "stop").ok
    team.replace("robot3")  # before any step
    team.run(2.0)
    assert state_of(team) is AgentState.STOP


def test_stop_that_cannot_be_stored_is_obeyed(team: Team) -> None:
    team.drawers["robot3"].failure = "no space left on device"
    answer = team.tell("robot3", "stop", id="s")
    assert (answer.ok, answer.mode) == (True, "stop")
    assert answer.reason == "cannot be saved just now: a restart may undo it"
    assert team.tell("robot3", "run").reason == "stopped: release it first"
    team.drawers["robot3"].failure = ""
    assert team.tell("robot3", "stop", id="s").reason == "", "the repeated request is stored by now"


@pytest.mark.slow
def test_agent_runs_again_after_normal_exit(team: Team) -> None:
    team.halt("robot3")
    team.run(1.0)
    team.begin("robot3")
    team.run(1.0)
    assert state_of(team) is AgentState.RUN


@pytest.mark.slow
@pytest.mark.parametrize(
    "text",
    [b"", b"{", b"[]", b"null", b"\xff\x00", b'{"robot": "robot3"}', b'{"robot": "robot3", "mode": "sotp"}'],
)
def test_unreadable_stops_file_stops_robot_and_is_reported(team: Team, text: bytes) -> None:
    team.lose("robot3", 0.5)
    team.drawers["robot3"].texts["stops"] = text
    team.begin("robot3")
    team.run(1.0)
    reason = team.agents["robot3"].decision.reason
    assert state_of(team) is AgentState.STOP
    assert reason.code is Code.STOP_UNKNOWN
    assert str(reason).startswith("/somewhere/robot.stops.json cannot be read: ")
    assert str(reason).endswith("release the robot if it may drive")
    assert team.drawers["robot3"].texts["stops"] == text, "the file stays as it was"
    assert not team.tell("robot3", "run").ok
    team.tell("robot3", "release")
    team.tell("robot3", "run")
    team.run(1.0)
    assert state_of(team) is AgentState.RUN
    assert json.loads(team.drawers["robot3"].texts["stops"])["mode"] is None


@pytest.mark.slow
def test_stops_file_of_another_robot_is_reported(team: Team) -> None:
    assert team.tell("robot3", "stop").ok
    team.run(0.5)
    team.kill("robot4")
    team.drawers["robot4"].texts["stops"] = team.drawers["robot3"].texts["stops"]
    team.begin("robot4")
    team.run(0.5)
    assert "it is of robot3" in str(team.agents["robot4"].decision.reason)


def test_stops_file_without_permission_stops_robot() -> None:
    class Broken(Drawer):
        def read_stops(self) -> bytes | None:
            raise PermissionError(13, "Permission denied")

    team = driving(SIX, 5.0)
    team.lose("robot3", 0.5)
    team.drawers["robot3"] = Broken()
    team.begin("robot3")
    team.run(0.5)
    assert state_of(team) is AgentState.STOP
    assert "cannot be read: Permission denied" in str(team.agents["robot3"].decision.reason)


def test_repeated_release_after_restart_ends_no_later_stop(team: Team) -> None:
    team.tell("robot3", "hold", id="h")
    team.tell("robot3", "release", id="r")
    team.run(0.5)
    team.tell("robot3", "stop", id="s")
    team.run(0.5)
    team.replace("robot3")
    for _ in range(3):
        team.tell("robot3", "release", id="r", age=2.0)  # its operator still waits for another robot
        team.tell("robot3", "release", id="older", age=3.0)
        team.run(0.3)
    assert state_of(team) is AgentState.STOP


@pytest.mark.slow
@pytest.mark.parametrize("boot", ["this very boot", "another"])
def test_release_requested_before_stop_is_refused_after_restart(team: Team, boot: str) -> None:
    assert team.tell("robot3", "stop").ok
    team.run(0.5)
    team.replace("robot3", 2.0, boot=boot)
    assert not team.tell("robot3", "release", id="old", age=5.0).ok
    team.run(0.5)
    assert not team.tell("robot3", "release", id="old-too", age=5.0).ok
    assert state_of(team) is AgentState.STOP
    assert team.tell("robot3", "release", id="new", age=0.6).ok is (boot == "this very boot")


def test_stopped_robots_stay_stopped_after_full_restart(team: Team) -> None:
    for name in SIX.followers:
        team.tell(name, "stop")
    team.run(0.5)
    for name in ("leader", *SIX.followers):
        team.kill(name)
    team.run(1.0)
    team.restart("leader")
    for name in SIX.followers:
        team.begin(name)
    team.run(5.0)
    assert team.states == {AgentState.STOP}
    assert {team.last_command(name) for name in SIX.followers} == {(0.0, 0.0)}
