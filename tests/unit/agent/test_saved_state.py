"""What an agent kept of its way is gone on with if it fits; if not, the log says why. On the fake clock."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from formation.agent.core import Agent
from formation.agent.persistence.restore import MAX_INTEGRAL_AGE, MAX_STATE_AGE, RESTORE_TRIAL_TIME
from formation.agent.process import Sides, drive
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.status import AgentState
from formation.ros2.messages import Odometry, Pose
from formation.topics import ODOM, POSE
from formation.transport.runtime.process import clocks
from tests.support import meddling
from tests.support.missions import with_robots
from tests.support.recorded import Wire
from tests.support.restarting import Team, driving, turning_back
from tests.support.sensing import reset_odometry

SIX = load("six_robots")


def lost(seconds: float, mission: Mission = SIX) -> Team:
    """A team whose robot3 has lost its agent for so long."""
    team = driving(mission)
    team.lose("robot3", seconds)
    return team


def news(team: Team, caplog: pytest.LogCaptureFixture) -> str:
    """What robot3's agent says of the one before it."""
    caplog.clear()
    team.begin("robot3")
    team.run(0.5)
    return " ".join(caplog.messages)


CHANGES: dict[str, tuple[dict[str, Any], str]] = {
    "mission": ({"mission": "another"}, "it is of mission another, this one of"),
    "law": ({"law": "paper"}, "it is of law paper, this one of field"),
    "robot": ({"robot": "robot4"}, "it is of robot robot4, this one of robot3"),
    "boot": ({"boot": "another"}, "the machine has been switched off meanwhile"),
    "future": ({"mono": 1e6}, "the machine has been switched off meanwhile"),
    "shape": ({"here": {}}, "cannot be read: here.stream: Field required"),
    "table": ({"voted_term": -1}, "cannot be read: voted_term"),
    "voted_term": ({"voted_term": 2**62}, "voted for an absurd term: begins"),
    "number": ({"integral": ["NaN", 0.0]}, "a number in it is not finite"),
}


@pytest.mark.parametrize(("change", "words"), CHANGES.values(), ids=CHANGES)
def test_foreign_state_is_refused_and_logged(
    change: dict[str, Any], words: str, caplog: pytest.LogCaptureFixture
) -> None:
    team = lost(1.0)
    team.drawers["robot3"].change("state", **change)
    result = news(team, caplog)
    assert result.startswith("starts without the saved state: ")
    assert words in result
    assert team.agents["robot3"].decision.state is AgentState.RUN


@pytest.mark.parametrize("where", ["arrived", "stamp"])
def test_state_with_nan_in_stream_is_refused(where: str, caplog: pytest.LogCaptureFixture) -> None:
    team = lost(1.0)
    here = json.loads(team.drawers["robot3"].texts["state"])["here"]
    here["stream"][where] = "NaN"
    team.drawers["robot3"].change("state", here=here)
    assert "a number in it is not finite" in news(team, caplog)
    assert team.agents["robot3"].here.stream.clock_agrees


@pytest.mark.parametrize(
    ("place", "value"),
    [("estimate", "[1.7e308, 1.7e308]"), ("jumps", 5000 * "1")],
    ids=["an agent would fail with it at its first step", "too long to be shown"],
)
def test_state_that_an_agent_would_fail_with_is_refused(
    place: str, value: str, caplog: pytest.LogCaptureFixture
) -> None:
    team = lost(1.0)
    here = json.loads(team.drawers["robot3"].texts["state"])["here"]
    assert place in here
    text = json.dumps({**here, place: "PLACE"}).replace('"PLACE"', value)
    way = team.drawers["robot3"].texts["state"]
    team.drawers["robot3"].texts["state"] = way.replace(json.dumps(here).encode(), text.encode())
    assert team.drawers["robot3"].texts["state"] != way
    assert "starts without the saved state" in news(team, caplog)
    assert team.agents["robot3"].decision.state is AgentState.RUN


def test_saved_state_that_its_agent_failed_with_is_set_aside(caplog: pytest.LogCaptureFixture) -> None:
    team = lost(1.0)
    assert news(team, caplog).startswith("goes on from where it was")
    sides = team.loop("robot3").sides
    sides.failed(team.moment)
    sides.end(team.moment)  # which an agent does in any case
    assert "state" not in team.drawers["robot3"].texts
    assert "after it took over saved state, which is now /somewhere/robot.state.failed" in caplog.text
    team.kill("robot3")
    assert news(team, caplog) == ""
    assert team.agents["robot3"].decision.state is AgentState.RUN


@pytest.mark.slow
def test_proven_saved_state_survives_a_failure(caplog: pytest.LogCaptureFixture) -> None:
    team = lost(1.0)
    news(team, caplog)
    team.run(RESTORE_TRIAL_TIME)
    team.loop("robot3").sides.failed(team.moment)
    assert "state" in team.drawers["robot3"].texts


def test_a_loop_that_fails_says_so_to_what_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_way_that_fits_is_taken_over_and_said(caplog: pytest.LogCaptureFixture) -> None:
    assert news(lost(1.0), caplog).startswith("goes on from where it was 1.")


@pytest.mark.slow
def test_a_way_that_is_too_old_is_not_taken_over(caplog: pytest.LogCaptureFixture) -> None:
    team = lost(1.0)
    team.run(MAX_STATE_AGE)
    assert f"which is more than {MAX_STATE_AGE:.0f} s" in news(team, caplog)


@pytest.mark.slow
@pytest.mark.parametrize("localisation", ["odometry", "external"])
def test_a_robot_that_was_carried_meanwhile_begins_anew(
    localisation: str, caplog: pytest.LogCaptureFixture
) -> None:
    team = lost(1.0, with_robots("six_robots", localisation=localisation))
    key, kind = (ODOM, Odometry) if localisation == "odometry" else (POSE, Pose)
    team.meddle = meddling.altered(
        key.key("robot3"), kind, lambda seen: replace(seen, position=seen.position + 9.0)
    )
    assert "jumped by 9.06 m" in news(team, caplog)


@pytest.mark.slow
def test_odometry_of_another_frame_begins_anew(caplog: pytest.LogCaptureFixture) -> None:
    team = lost(1.0)

    team.meddle = meddling.altered(
        ODOM.key("robot3"), Odometry, lambda seen: replace(seen, frame="elsewhere")
    )
    assert "odometry counts in elsewhere, and counted in map" in news(team, caplog)


@pytest.mark.slow
@pytest.mark.parametrize("gone", [1.0, MAX_INTEGRAL_AGE + 1.0])
def test_the_integral_is_taken_over_only_while_it_means_something(gone: float) -> None:
    team = lost(gone, SIX.under("paper"))
    kept = json.loads(team.drawers["robot3"].texts["state"])["integral"]
    team.begin("robot3")
    while team.agents["robot3"].here.stream.state.arrived is None:
        team.run(0.001)
    integral = team.agents["robot3"].state.integral
    assert (integral == complex(*kept)) is (gone < MAX_INTEGRAL_AGE)


@pytest.mark.slow
def test_realigned_odometry_persists_over_agent_death() -> None:
    team = Team(turning_back(odometry_frame="start")).after(8.0)
    reset_odometry(team.world._hosted["robot3"].plant)
    team.run(3.0)
    assert team.agents["robot3"].here.state.jumps == 1
    team.replace("robot3")
    team.run(6.0)
    assert team.error() < 0.05
    assert team.agents["robot3"].here.state.source.realigned == 1


@pytest.mark.slow
@pytest.mark.parametrize(("empty", "least", "most"), [(False, 0.0, 0.25), (True, 1.0, 100.0)])
def test_odometry_reset_without_agent_restores_approximate_position(
    empty: bool, least: float, most: float
) -> None:
    """To where its way was last kept; without that it is taken to be at its start."""
    team = Team(turning_back(odometry_frame="start")).after(8.0)
    team.lose("robot3", 1.0)
    reset_odometry(team.world._hosted["robot3"].plant)
    team.run(0.5)
    team.begin("robot3", empty=empty)
    team.run(6.0)
    assert least <= team.error() < most


def test_a_voted_term_survives_a_restart() -> None:
    team = lost(1.0)
    team.drawers["robot3"].change("state", voted_term=7)
    team.begin("robot3")
    assert team.agents["robot3"].orders.voter.state.voted_term == 7


@pytest.mark.slow
def test_unused_state_is_not_overwritten_by_dying_agent() -> None:
    team = lost(1.0)
    kept = team.drawers["robot3"].texts["state"]
    team.meddle = meddling.lost(ODOM.key("robot3"))
    team.begin("robot3")
    team.run(2.0)
    assert team.drawers["robot3"].texts["state"] == kept
