"""An agent that died comes back without a lurch, and stopped if it was; on the fake clock."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.agent.persistence.restore import SAVE_PERIOD
from formation.control.tracker import FRESH_PERIODS
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.status import AgentState
from tests.support.recorded import verify
from tests.support.restarting import Team, driving, turning_back
from tests.unit.agent.sudden import most_sudden

SIX = load("six_robots")
BACK = turning_back()
SEEN = turning_back(localisation="external")
STRAIGHT = 5.0
"""Heading error up to which a robot goes where it should [deg]."""


def first_heading_error(team: Team, name: str, patience: float = 5.0) -> float:
    """How far the heading is off at the first command that moves the robot from now on [deg]."""
    before, end = len(team.commands[name]), team.now + patience
    while team.now < end:
        team.run(0.002)
        if any(speed or turn_rate for _, speed, turn_rate in team.commands[name][before:]):
            return team.heading_error(name)
    raise AssertionError(f"{name} does not move: {team.agents[name].decision}")


def turned_unseen(team: Team, name: str, gone: float) -> float:
    """How far a robot can turn unmeasured since its way was kept, until its watchdog stops it [deg]."""
    spec = team.mission.robots[name]
    if spec.localisation == "odometry":
        return 0.0
    until_stopped = (FRESH_PERIODS + 1.0) / spec.rate
    return math.degrees(spec.max_turn_rate * (SAVE_PERIOD + min(gone, until_stopped) + 1.0 / spec.rate))


@pytest.mark.slow
@settings(max_examples=5)
@given(
    mission=st.sampled_from([BACK, turning_back(odometry_frame="start"), SEEN]),
    name=st.sampled_from(SIX.followers),
    begun=st.floats(13.0, 15.0),
    gone=st.sampled_from([0.05, 0.1, 0.5, 1.4, 5.4]),
)
def test_restarted_agent_resumes_straight_within_limits_and_forms(
    mission: Mission, name: str, begun: float, gone: float
) -> None:
    team = driving(mission, begun)
    team.lose(name, gone)
    back = team.now
    team.begin(name)
    assert first_heading_error(team, name) < STRAIGHT + turned_unseen(team, name, gone)
    team.run(5.0)
    assert team.error() < 0.02
    assert team.within_limits
    assert most_sudden(team, back) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mission", "gone", "most"), [(BACK, 0.5, STRAIGHT), (BACK, 5.4, STRAIGHT), (SEEN, 0.5, 10.0)]
)
def test_without_state_heading_is_odometrys_or_leaders(mission: Mission, gone: float, most: float) -> None:
    team = driving(mission, 18.0)
    team.replace("robot3", gone, empty=True)
    assert first_heading_error(team, "robot3") < most
    team.run(8.0)
    assert team.error() < 0.02


def test_first_heading_guess_is_from_mission() -> None:
    team = Team(SIX).after(0.2)  # a tenth of a second of driving later it knows better
    assert team.heading_error("robot4") > 45.0
    assert team.agents["robot4"].decision.state is AgentState.RUN


@pytest.mark.slow
def test_recording_of_restarted_agent_verifies_exactly() -> None:
    team = driving(BACK, 14.0)
    team.replace("robot3", 0.7)
    team.run(3.0)
    team.tell("robot3", "stop", id="a")
    team.run(0.5)
    team.replace("robot3", 0.7)
    team.run(0.5)
    team.tell("robot3", "release", id="b")
    team.tell("robot3", "run", id="c")
    team.run(2.0)
    assert team.agents["robot3"].decision.state is AgentState.RUN
    verdict = verify(BACK, team.record)["robot3"]
    assert verdict.exact == verdict.compared == verdict.commands > 0
