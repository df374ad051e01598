"""An agent that died comes back without a lurch, and stopped if it was; on the fake clock."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.failsafe import State
from agent.survival import PERIOD
from agent.verify.core import verify
from formation.mission import Mission
from formation.mission_file import load
from formation.neighbour import FRESH_PERIODS
from tests.agent.restarting import Team, driving, turning_back

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
    """How far a robot can turn unmeasured since its way was kept, until its guard stops it [deg]."""
    spec = team.mission.robots[name]
    if spec.localisation == "odometry":
        return 0.0
    guarded = (FRESH_PERIODS + 1.0) / spec.rate
    return math.degrees(spec.max_turn_rate * (PERIOD + min(gone, guarded) + 1.0 / spec.rate))


def within_limits(team: Team, name: str) -> bool:
    spec = team.mission.robots[name]
    return all(abs(u) <= spec.max_speed and abs(w) <= spec.max_turn_rate for _, u, w in team.commands[name])


def largest_jump(team: Team, name: str, since: float) -> float:
    """Between two commands, but for those that stop the robot, as a share of the limit."""
    spec, jump, before = team.mission.robots[name], 0.0, (0.0, 0.0)
    for moment, speed, turn_rate in team.commands[name]:
        if moment >= since and (speed, turn_rate) != (0.0, 0.0):
            change = abs(speed - before[0]) / spec.max_speed, abs(turn_rate - before[1]) / spec.max_turn_rate
            jump = max(jump, *change)
        before = (speed, turn_rate)
    return jump


@settings(max_examples=5)
@given(
    mission=st.sampled_from([BACK, turning_back(odometry_frame="start"), SEEN]),
    name=st.sampled_from(SIX.followers),
    begun=st.floats(13.0, 15.0),
    gone=st.sampled_from([0.05, 0.1, 0.5, 1.4, 5.4]),
)
def test_whenever_an_agent_dies_it_goes_on_straight_within_limits_and_into_formation(
    mission: Mission, name: str, begun: float, gone: float
) -> None:
    team = driving(mission, begun)
    team.lose(name, gone)
    back = team.now
    team.begin(name)
    assert first_heading_error(team, name) < STRAIGHT + turned_unseen(team, name, gone)
    team.run(5.0)
    assert team.error() < 0.02
    assert within_limits(team, name)
    assert largest_jump(team, name, back) < 0.5


@pytest.mark.parametrize("gone", [0.5, 5.4])
def test_without_what_was_kept_it_takes_its_heading_from_odometry_that_counts_in_the_world(
    gone: float,
) -> None:
    team = driving(BACK, 18.0)
    team.lose("robot3", gone)
    team.begin("robot3", empty=True)
    assert first_heading_error(team, "robot3") < STRAIGHT
    team.run(8.0)
    assert team.error() < 0.02


def test_seen_from_outside_and_without_what_was_kept_it_guesses_that_it_faces_where_the_leader_goes() -> None:
    team = driving(SEEN, 18.0)
    team.lose("robot3", 0.5)
    team.begin("robot3", empty=True)
    assert first_heading_error(team, "robot3") < 10.0


def test_at_the_start_of_a_mission_the_first_guess_is_what_the_mission_says() -> None:
    team = Team(SIX)
    team.run(0.4)
    assert team.heading_error("robot4") > 45.0
    assert team.agents["robot4"].decision.state is State.RUN


def test_a_recording_with_an_agent_that_came_back_is_verified_to_the_last_bit() -> None:
    team = driving(BACK, 14.0)
    team.lose("robot3", 0.7)
    team.begin("robot3")
    team.run(3.0)
    team.tell("robot3", "stop", id="a")
    team.run(0.5)
    team.lose("robot3", 0.7)
    team.begin("robot3")
    team.run(0.5)
    team.tell("robot3", "release", id="b")
    team.tell("robot3", "run", id="c")
    team.run(2.0)
    assert team.agents["robot3"].decision.state is State.RUN
    verdict = verify(BACK, team.record)["robot3"]
    assert verdict.exact == verdict.compared == verdict.commands > 0
