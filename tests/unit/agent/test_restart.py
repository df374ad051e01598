"""Restarted and thawed agents: the saved state that they restore, and the state that they refuse."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.agent.core import Agent
from formation.agent.inbox import DRAIN_TIME
from formation.agent.persistence.persistence import RESTORE_TRIAL_TIME, SAVE_PERIOD
from formation.agent.persistence.restore import MAX_INTEGRAL_AGE, MAX_STATE_AGE
from formation.agent.persistence.store import boot_id
from formation.agent.process import Sides, drive
from formation.control.tracker import FRESH_PERIODS
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from formation.ros2.messages import Odometry, Pose
from formation.topics import ODOM, POSE
from formation.transport.runtime import clock
from formation.transport.runtime.process import clocks
from tests.support import meddling
from tests.support.fleet import Fleet
from tests.support.missions import with_robots
from tests.support.recorded import Wire, all_alike, verify
from tests.support.restarting import Team, driving, turning_back
from tests.support.sensing import reset_odometry
from tests.unit.agent.sudden import largest_command_change

SIX = load("six_robots")
BACK = turning_back()
SEEN = turning_back(localisation="external")
COUNTING = turning_back(odometry_frame="start")
"""Its odometry counts from the start pose."""
AT_REST = (0.0, 0.0)
STRAIGHT = 5.0
"""Heading error with which a robot still drives in the right direction [deg]."""


def first_heading_error(team: Team, name: str, patience: float = 5.0) -> float:
    """Heading error at the first command from now on that moves the robot [deg]."""
    before, end = len(team.commands[name]), team.now + patience
    while team.now < end:
        team.run(0.002)
        if any(speed or turn_rate for _, speed, turn_rate in team.commands[name][before:]):
            return team.heading_error(name)
    raise AssertionError(f"{name} does not move: {team.agents[name].decision}")


def unmeasured_turn(team: Team, name: str, gone: float) -> float:
    """Greatest unmeasured turn from the last save until the watchdog stops the robot [deg]."""
    spec = team.mission.robots[name]
    if spec.localisation == "odometry":
        return 0.0
    until_stopped = (FRESH_PERIODS + 1.0) / spec.rate
    return math.degrees(spec.max_turn_rate * (SAVE_PERIOD + min(gone, until_stopped) + 1.0 / spec.rate))


@pytest.mark.slow
@settings(max_examples=5)
@given(
    mission=st.sampled_from([BACK, COUNTING, SEEN]),
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
    assert first_heading_error(team, name) < STRAIGHT + unmeasured_turn(team, name, gone)
    team.run(5.0)
    assert team.error() < 0.02
    assert team.within_limits
    assert largest_command_change(team, back) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mission", "gone", "most"), [(BACK, 0.5, STRAIGHT), (BACK, 5.4, STRAIGHT), (SEEN, 0.5, 10.0)]
)
def test_agent_without_saved_state_starts_in_right_direction(
    mission: Mission, gone: float, most: float
) -> None:
    team = driving(mission, 18.0)
    team.replace("robot3", gone, empty=True)
    assert first_heading_error(team, "robot3") < most
    team.run(8.0)
    assert team.error() < 0.02


def test_robot_runs_with_wrong_first_heading() -> None:
    team = Team(SIX).after(0.2)  # 0.1 s of driving later the heading is known
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


def lost(seconds: float, mission: Mission = SIX) -> Team:
    """A team in which robot3 has had no agent for `seconds`."""
    team = driving(mission)
    team.lose("robot3", seconds)
    return team


def start_messages(team: Team, caplog: pytest.LogCaptureFixture) -> str:
    """Start a new agent for robot3; return its log messages."""
    caplog.clear()
    team.begin("robot3")
    team.run(0.5)
    return " ".join(caplog.messages)


CHANGES: dict[str, tuple[dict[str, Any], str]] = {
    "mission": ({"mission": "another"}, "it is of mission another, this one of"),
    "law": ({"law": "paper"}, "it is of law paper, this one of field"),
    "robot": ({"robot": "robot4"}, "it is of robot robot4, this one of robot3"),
    "boot": ({"boot": "another"}, "the machine has been switched off or suspended meanwhile"),
    "future": ({"mono": 1e6}, "the machine has been switched off or suspended meanwhile"),
    "missing field": ({"here": {}}, "cannot be read: here.stream: Field required"),
    "negative term": ({"voted_term": -1}, "cannot be read: voted_term"),
    "absurd term": ({"voted_term": 2**62}, "voted for an absurd term: begins"),
    "not finite": ({"integral": ["NaN", 0.0]}, "a number in it is not finite"),
}


@pytest.mark.parametrize(("change", "words"), CHANGES.values(), ids=CHANGES)
def test_foreign_or_invalid_state_is_refused_and_logged(
    change: dict[str, Any], words: str, caplog: pytest.LogCaptureFixture
) -> None:
    team = lost(1.0)
    team.drawers["robot3"].change("state", **change)
    result = start_messages(team, caplog)
    assert result.startswith("starts without the saved state: ")
    assert words in result
    assert team.agents["robot3"].decision.state is AgentState.RUN


def test_machine_that_slept_has_another_boot_id(monkeypatch: pytest.MonkeyPatch) -> None:
    """The monotonic clock of a process leaves out what the machine slept before its start."""
    before = boot_id()
    monkeypatch.setattr(clock, "_SUSPENDED", clock._SUSPENDED + 7200.0)
    assert boot_id() == boot_id() != before


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        ("arrived", '"NaN"', "a number in it is not finite"),
        ("stamp", '"NaN"', "a number in it is not finite"),
        ("estimate", "[1.7e308, 1.7e308]", ""),
        ("jumps", 5000 * "1", ""),
    ],
    ids=["arrived", "stamp", "overflow at the first step", "too many digits"],
)
def test_state_with_impossible_number_is_refused(
    place: str, value: str, words: str, caplog: pytest.LogCaptureFixture
) -> None:
    team = lost(1.0)
    state = json.loads(team.drawers["robot3"].texts["state"])
    here = state["here"]["stream"] if place in state["here"]["stream"] else state["here"]
    assert place in here
    here[place] = "PLACE"
    team.drawers["robot3"].texts["state"] = json.dumps(state).replace('"PLACE"', value).encode()
    result = start_messages(team, caplog)
    assert "starts without the saved state" in result
    assert words in result
    assert team.agents["robot3"].here.stream.clock_agrees
    assert team.agents["robot3"].decision.state is AgentState.RUN


def test_state_is_set_aside_after_agent_fails_with_it(caplog: pytest.LogCaptureFixture) -> None:
    team = lost(1.0)
    assert start_messages(team, caplog).startswith("goes on from where it was 1.")
    sides = team.loop("robot3").sides
    sides.failed(team.moment)
    sides.end(team.moment)  # as after any end of an agent
    assert "state" not in team.drawers["robot3"].texts
    assert "after it took over saved state, which is now /somewhere/robot.state.failed" in caplog.text
    team.kill("robot3")
    assert "after it took over saved state: check its log" in start_messages(team, caplog)
    assert team.agents["robot3"].decision.state is AgentState.HOLD


@pytest.mark.slow
def test_state_is_kept_after_failure_past_trial_time(caplog: pytest.LogCaptureFixture) -> None:
    team = lost(1.0)
    start_messages(team, caplog)
    team.run(RESTORE_TRIAL_TIME)
    team.loop("robot3").sides.failed(team.moment)
    assert "state" in team.drawers["robot3"].texts


def test_failing_loop_calls_failed_of_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    failed = []
    monkeypatch.setattr(Sides, "failed", lambda _self, now: failed.append(now))

    def loop(*_: Any) -> Iterator[float]:
        yield 0.0
        raise OverflowError("absolute value too large")

    wire = Wire()
    bus = SimpleNamespace(
        advertise=wire.advertise, subscribe=wire.subscribe, routed=wire.routed, answer=wire.subscribe
    )
    process: Any = SimpleNamespace(bus=bus, robot=wire, ready=lambda *_: None, loop=loop, clock=clocks)
    with pytest.raises(OverflowError):
        list(drive(Agent(SIX, "robot3", publisher_id="a"), process))
    assert len(failed) == 1


@pytest.mark.slow
def test_state_older_than_max_age_is_refused(caplog: pytest.LogCaptureFixture) -> None:
    team = lost(1.0)
    team.run(MAX_STATE_AGE)
    assert f"which is more than {MAX_STATE_AGE:.0f} s" in start_messages(team, caplog)


@pytest.mark.slow
@pytest.mark.parametrize("localisation", ["odometry", "external"])
def test_restarted_agent_reports_jump_of_carried_robot(
    localisation: str, caplog: pytest.LogCaptureFixture
) -> None:
    team = lost(1.0, with_robots("six_robots", localisation=localisation))
    key, kind = (ODOM, Odometry) if localisation == "odometry" else (POSE, Pose)
    team.meddle = meddling.altered(
        key.key("robot3"), kind, lambda seen: replace(seen, position=seen.position + 9.0)
    )
    assert "jumped by 9.06 m" in start_messages(team, caplog)


@pytest.mark.slow
def test_restarted_agent_reports_other_odometry_frame(caplog: pytest.LogCaptureFixture) -> None:
    team = lost(1.0)
    team.meddle = meddling.altered(
        ODOM.key("robot3"), Odometry, lambda seen: replace(seen, frame="elsewhere")
    )
    assert "odometry counts in elsewhere, and counted in map" in start_messages(team, caplog)


@pytest.mark.slow
@pytest.mark.parametrize("gone", [1.0, MAX_INTEGRAL_AGE + 1.0])
def test_integral_is_restored_only_up_to_max_age(gone: float) -> None:
    team = lost(gone, SIX.under("paper"))
    kept = json.loads(team.drawers["robot3"].texts["state"])["integral"]
    team.begin("robot3")
    while team.agents["robot3"].here.stream.state.arrived is None:
        team.run(0.001)
    integral = team.agents["robot3"].state.integral
    assert (integral == complex(*kept)) is (gone < MAX_INTEGRAL_AGE)


@pytest.mark.slow
def test_realignment_of_odometry_survives_agent_restart() -> None:
    team = driving(COUNTING)
    reset_odometry(team.world._hosted["robot3"].plant)
    team.run(3.0)
    assert team.agents["robot3"].here.state.jumps == 1
    team.replace("robot3")
    team.run(6.0)
    assert team.error() < 0.05
    assert team.agents["robot3"].here.state.source.realigned == 1


@pytest.mark.slow
@pytest.mark.parametrize(("empty", "least", "most"), [(False, 0.0, 0.25), (True, 1.0, 100.0)])
def test_position_after_odometry_reset_needs_saved_state(empty: bool, least: float, most: float) -> None:
    """Saved state gives the position at the last save; without it the robot counts as at its start."""
    team = driving(COUNTING)
    team.lose("robot3", 1.0)
    reset_odometry(team.world._hosted["robot3"].plant)
    team.run(0.5)
    team.begin("robot3", empty=empty)
    team.run(6.0)
    assert least <= team.error() < most


def switched_off(*, resets: bool) -> Team:
    """A team in which robot3 was switched off while driving and on again; `resets`: its odometry as well."""
    team = driving(COUNTING)
    team.lose("robot3", 1.0)
    if resets:
        reset_odometry(team.world._hosted["robot3"].plant)
    team.begin("robot3", boot="another")
    team.run(3.0)
    return team


@pytest.mark.slow
def test_robot_switched_off_on_its_way_holds_until_run() -> None:
    team = switched_off(resets=True)
    for boot in ("another", "a third"):  # the hold outlives that too
        decision = team.agents["robot3"].decision
        assert decision.state is AgentState.HOLD
        assert decision.reason.code in {Code.UNPLACED, Code.HELD_BEFORE_START}
        assert team.last_command("robot3") == (0.0, 0.0)
        team.replace("robot3", boot=boot)
        team.run(3.0)
    assert team.tell("robot3", "run").ok
    team.run(0.5)
    assert team.agents["robot3"].decision.state is AgentState.RUN
    assert all_alike(verify(COUNTING, team.record))


def test_robot_runs_after_a_reboot_if_odometry_counts_on() -> None:
    team = switched_off(resets=False)
    assert team.agents["robot3"].decision.state is AgentState.RUN
    assert team.error() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mission": "another"}, "it is of mission another"),
        ({"mono": -100.0}, "which is more than 60 s"),
        ({"here": {}}, "cannot be read"),
    ],
    ids=["mission", "old", "unreadable"],
)
def test_unused_state_after_odometry_reset_holds_the_robot(
    change: dict[str, Any], words: str, caplog: pytest.LogCaptureFixture
) -> None:
    team = driving(COUNTING)
    team.lose("robot3", 1.0)
    reset_odometry(team.world._hosted["robot3"].plant)
    team.drawers["robot3"].change("state", **change)
    assert words in start_messages(team, caplog)
    decision = team.agents["robot3"].decision
    assert (decision.state, decision.reason.code) == (AgentState.HOLD, Code.UNPLACED)


@pytest.mark.slow
def test_reboot_of_stopped_robot_leaves_a_hold_below_the_stop() -> None:
    team = driving(COUNTING)
    assert team.tell("robot3", "stop").ok
    team.lose("robot3", 1.0)
    reset_odometry(team.world._hosted["robot3"].plant)
    team.begin("robot3", boot="another")
    team.run(1.0)
    assert team.agents["robot3"].decision.state is AgentState.STOP
    assert team.tell("robot3", "release").ok
    assert team.tell("robot3", "query").hold


def test_voted_term_survives_restart() -> None:
    team = lost(1.0)
    team.drawers["robot3"].change("state", voted_term=7)
    team.begin("robot3")
    assert team.agents["robot3"].orders.voter.state.voted_term == 7


@pytest.mark.slow
def test_unused_state_is_not_overwritten_without_odometry() -> None:
    team = lost(1.0)
    kept = team.drawers["robot3"].texts["state"]
    team.meddle = meddling.lost(ODOM.key("robot3"))
    team.begin("robot3")
    team.run(2.0)
    assert team.drawers["robot3"].texts["state"] == kept


@pytest.mark.parametrize("leader_dies", [False, True])
def test_thawed_agent_sends_zero_first(leader_dies: bool) -> None:
    fleet = Fleet.under_way(SIX, 8.0)
    fleet.freeze("robot4")
    fleet.run(2.5)
    if leader_dies:
        fleet.kill("leader")
        fleet.run(0.3)
    woke = fleet.now
    fleet.thaw("robot4")
    fleet.run(DRAIN_TIME)
    assert set(fleet.commands_since("robot4", woke - 1e-9)) == {AT_REST}
    assert fleet.agents["robot4"].decision.reason.code is Code.PROCESS_FROZEN
    assert any("waited while" in why for why in fleet.agents["robot4"].inbox.state.last_dropped.values())
    fleet.run(2.0)
    decision = fleet.agents["robot4"].decision
    assert (decision.state is AgentState.RUN) is not leader_dies
    assert not leader_dies or str(decision.reason).endswith("waits for new orders of the leader")


def test_short_pause_does_not_count_as_freeze() -> None:
    fleet = Fleet.under_way(SIX, 8.0)
    fleet.freeze("robot4")
    fleet.run(0.8)
    fleet.thaw("robot4")
    fleet.run(0.3)
    assert fleet.agents["robot4"].decision.state is AgentState.RUN
