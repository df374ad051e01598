"""An agent that is killed or fails: the next one knows which sensors are in doubt, or holds."""

from __future__ import annotations

from dataclasses import replace

import pytest

from formation.agent.following.relative_check import MAX_EQUAL_MOTION
from formation.agent.perception.perception import MAX_LOST_LOCKS
from formation.agent.persistence import restore
from formation.agent.simulated.faults import Fault, with_faults
from formation.agent.simulated.simulated import kinematic
from formation.control.observer import Travel
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState, MotionFault
from formation.ros2.messages import Displacement
from formation.topics import RELATIVE
from tests.support.examples import slow
from tests.support.meddling import altered
from tests.support.missions import with_robots
from tests.support.recorded import all_alike, verify
from tests.support.restarting import SIX, Drawer, Team, driving, turning_back
from tests.support.seeing import TRIANGLE, hexagon
from tests.support.sensing import reset_odometry
from tests.unit.agent.test_sensing import AHEAD, Watched, still

POSTS = load("posts")
MEASURED = with_robots("six_robots", measurement="local")
COUNTING = turning_back(odometry_frame="start")


def frozen(mission: Mission, name: str, kind: str) -> Team:
    """A team in which a sensor of that robot froze 3 s after the start, 2 s ago."""
    fault = Fault(name, kind, 0.0, 3.0, 1e9)
    return Team(mission, plants=with_faults(kinematic, [fault])).after(5.0)


def path_over_restarts(team: Team, name: str, number: int, lives: float) -> float:
    """Distance that a robot drives while its agent is killed so often, each time `lives` [s] later [m]."""
    before = team.plant(name).path
    for _ in range(number):
        team.replace(name, 0.5)
        team.run(lives)
    return team.plant(name).path - before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mission", "name", "kind", "code"),
    [
        (POSTS, "robot1", "scan_frozen", Code.SCAN_FROZEN),
        (MEASURED, "robot3", "relative_frozen", Code.RELATIVE_FROZEN),
        (SIX, "robot3", "frozen", Code.MOTION_FROZEN),
    ],
    ids=["scanner", "sensor of neighbours", "odometry"],
)
def test_robot_with_frozen_sensor_stands_over_restarts(
    mission: Mission, name: str, kind: str, code: Code
) -> None:
    team = frozen(mission, name, kind)
    assert team.status(name).reason.code is code
    assert path_over_restarts(team, name, 4, 2.0) < 0.03
    assert team.status(name).reason.code is code
    assert all_alike(verify(mission, team.record))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mission", "name", "kind"), [(POSTS, "robot1", "scan_frozen"), (MEASURED, "robot3", "relative_frozen")]
)
def test_frozen_sensor_is_noticed_by_agents_that_live_shortly(mission: Mission, name: str, kind: str) -> None:
    fault = Fault(name, kind, 0.0, 3.0, 1e9)
    team = Team(mission, plants=with_faults(kinematic, [fault])).after(3.0)
    path_over_restarts(team, name, 4, 0.8)
    assert path_over_restarts(team, name, 1, 3.0) < 0.1
    assert team.status(name).reason.code in {Code.SCAN_FROZEN, Code.RELATIVE_FROZEN}


def test_robot_with_lost_locks_waits_for_operator_over_restarts() -> None:
    team = Team(hexagon(robots=TRIANGLE)).after(8.0)
    assert team.status("robot7").state is AgentState.RUN
    seeing = team.agents["robot7"].perception
    assert seeing is not None
    seeing.state.lost_locks = [seeing.state.travelled] * MAX_LOST_LOCKS
    team.run(1.0)
    assert path_over_restarts(team, "robot7", 2, 4.0) < 0.02
    assert team.status("robot7").reason.code is Code.SIGHT_UNRELIABLE
    for do in ("hold", "run"):
        team.ask("robot7", do)
        team.run(2.0)
    team.replace("robot7", 0.5)
    assert team.driven("robot7", 10.0) > 0.3


def test_frozen_odometry_is_noticed_by_agents_that_live_shortly() -> None:
    fault = Fault("robot3", "frozen", 0.0, 3.0, 1e9)
    team = Team(SIX, plants=with_faults(kinematic, [fault])).after(3.0)
    assert path_over_restarts(team, "robot3", 3, 0.5) < 0.55
    team.replace("robot3", 0.5)
    assert path_over_restarts(team, "robot3", 1, 1.0) < 0.03
    assert team.status("robot3").reason.code is Code.MOTION_FROZEN
    assert all_alike(verify(SIX, team.record))


@pytest.mark.slow
@pytest.mark.parametrize("lives", [0.2, 0.24])
def test_frozen_odometry_is_noticed_by_agents_that_crash_at_once(lives: float) -> None:
    """Where only the first state and one a quarter of a second later were saved, it drove 0.92 and 1.24 m."""
    fault = Fault("robot3", "frozen", 0.0, 3.0, 1e9)
    team = Team(SIX, plants=with_faults(kinematic, [fault])).after(3.0)
    assert path_over_restarts(team, "robot3", 6, lives) < 0.5
    doubt = team.agents["robot3"].motion.state.doubt
    assert doubt is not None
    assert doubt.kind is MotionFault.FROZEN


@pytest.mark.slow
@pytest.mark.parametrize("gap", [0.1, 1.0])
def test_working_odometry_of_agents_that_live_shortly_is_in_no_doubt(
    monkeypatch: pytest.MonkeyPatch, gap: float
) -> None:
    monkeypatch.setattr(restore, "MAX_STARTS", 100)
    team = Team(SIX).after(3.0)
    for lives in (0.2, 0.3, 0.5, 0.8, 1.5, 3.0) * 2:
        team.replace("robot3", gap)
        team.run(lives)
        assert team.status("robot3").reason.code is Code.RUNNING


def test_equal_displacements_are_counted_across_gaps_and_agents() -> None:
    watched = Watched()
    for _ in range(4):
        watched.move(AHEAD, int(0.5 * MAX_EQUAL_MOTION / abs(AHEAD.displacement)), still)
        watched.move(None, 1, still)
        kept = watched.check.memory
        if kept.doubt is not None:
            break
        watched = Watched()
        watched.check.restore(kept)
    assert kept.doubt is not None
    watched = Watched()
    watched.check.restore(kept)
    assert watched.move(Travel(0.0, 0.0, 0j), 100, still)
    assert not watched.move(AHEAD, 1, lambda _: 2.0 + 0j)
    assert not watched.move(AHEAD, 5, lambda _: 2.0 + 0j)


@pytest.mark.slow
def test_agent_that_begins_again_and_again_holds_until_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restore, "MAX_STARTS", 2)
    monkeypatch.setattr(restore, "RESTARTS_TIME", 3.0)
    team = driving(seconds=4.0)
    for _ in range(3):
        assert team.agents["robot3"].decision.state is AgentState.RUN
        team.replace("robot3", 0.2)
        team.run(1.0)
    decision = team.status("robot3")
    assert decision.reason.code is Code.AGENT_FAILS
    assert "began more than 2 times within 3 s: check its log" in str(decision.reason)
    assert team.last_command("robot3") == (0.0, 0.0)
    team.run(3.0)
    team.replace("robot3", 0.2)  # the hold outlives that, and its reason
    team.run(1.0)
    assert team.status("robot3").reason.code is Code.AGENT_FAILS
    assert team.tell("robot3", "run").ok
    team.run(1.0)
    assert team.agents["robot3"].decision.state is AgentState.RUN
    assert all_alike(verify(SIX, team.record))


@pytest.mark.slow
def test_agents_that_live_for_a_moment_are_counted() -> None:
    team = frozen(SIX, "robot3", "frozen")
    assert path_over_restarts(team, "robot3", 12, 0.2) < 0.2
    why = team.agents["robot3"].latch.state.why
    assert why is not None
    assert why.code is Code.AGENT_FAILS


def test_own_hold_is_saved_once_the_disk_has_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restore, "MAX_STARTS", 0)
    team = driving(seconds=3.0)
    drawer = team.drawers["robot3"]
    team.lose("robot3", 0.2)
    kept = drawer.texts["state"]
    with monkeypatch.context() as disk:  # takes the state, but no stops
        disk.setattr(Drawer, "write_stops", lambda full, _: setattr(full, "stops_failed", True))
        team.begin("robot3")
        team.run(1.0)
        assert team.status("robot3").reason.code is Code.AGENT_FAILS
        assert drawer.texts["state"] == kept
    team.run(0.5)
    assert "stops" in drawer.texts
    assert drawer.texts["state"] != kept


@pytest.mark.slow
def test_own_reason_of_a_stop_outlives_restarts() -> None:
    team = driving(seconds=3.0)
    team.lose("robot3", 0.5)
    team.drawers["robot3"].texts["stops"] = b"{torn"
    for _ in range(2):
        team.begin("robot3")
        team.run(0.3)
        assert team.tell("robot3", "query").ok
        assert team.status("robot3").reason.code is Code.STOP_UNKNOWN
        team.lose("robot3", 0.5)


@pytest.mark.slow
def test_robot_with_mirrored_sensor_stands_over_restarts() -> None:
    team = Team(MEASURED)
    keys = {RELATIVE.key("robot3", other) for other in MEASURED.robots["robot3"].measurable}

    def mirrored(one: Displacement) -> Displacement:
        return replace(one, displacement=one.displacement.conjugate())

    meddles = {key: altered(key, Displacement, mirrored) for key in keys}
    team.meddle = lambda one: meddles[one.key](one) if one.key in keys else (one,)
    team.run(5.0)
    assert team.status("robot3").reason.code is Code.RELATIVE_CONTRADICTED
    assert path_over_restarts(team, "robot3", 2, 3.0) < 0.01
    assert team.status("robot3").reason.code is Code.RELATIVE_CONTRADICTED


@pytest.mark.slow
def test_own_hold_of_an_agent_clears_no_doubt() -> None:
    team = frozen(MEASURED, "robot3", "relative_frozen")
    path_over_restarts(team, "robot3", restore.MAX_STARTS + 1, 1.0)
    assert team.status("robot3").reason.code is Code.AGENT_FAILS
    assert team.agents["robot3"].neighbours.doubts(team.moment)
    assert team.tell("robot3", "run").ok
    before = team.plant("robot3").path
    team.run(2.0)
    assert team.status("robot3").reason.code is Code.RELATIVE_FROZEN
    assert team.plant("robot3").path == before


@pytest.mark.slow
def test_run_sent_before_a_failure_does_not_end_its_hold() -> None:
    team = driving(COUNTING, 4.0)
    reset_odometry(team.world._hosted["robot3"].plant)
    team.run(1.0)
    assert team.ask("robot3", "hold", id="before").ok
    failed_after_restart(team)
    team.replace("robot3", 0.5)
    team.run(1.0)
    assert team.status("robot3").reason.code is Code.AGENT_FAILS
    assert not team.ask("robot3", "run", ends=("before",)).ok
    assert not team.ask("robot3", "release", id="late", age=4.0).ok
    assert team.tell("robot3", "query").hold.startswith("agent_fails-")


def failed_after_restart(team: Team) -> None:
    """Have the agent of robot3 restart, and fail by an exception 2 s later."""
    team.replace("robot3", 0.5)
    team.run(2.0)
    sides = team.loop("robot3").sides
    for out in sides.halt(team.moment, "failed"):
        assert out.payload
    sides.failed(team.moment)
    sides.end(team.moment)


@pytest.mark.parametrize("times", [1, *slow(2)])
def test_robot_holds_after_failure_with_odometry_placed_anew(times: int) -> None:
    team = driving(COUNTING, 4.0)
    reset_odometry(team.world._hosted["robot3"].plant)
    team.run(1.0)
    for _ in range(times):
        failed_after_restart(team)
        assert "state" not in team.drawers["robot3"].texts
        team.replace("robot3", 0.5)
        team.run(1.0)
        assert team.status("robot3").reason.code is Code.AGENT_FAILS
        assert team.last_command("robot3") == (0.0, 0.0)


@pytest.mark.slow
def test_failure_keeps_the_stop_in_force() -> None:
    team = driving()
    assert team.tell("robot3", "stop").ok
    failed_after_restart(team)
    team.replace("robot3", 0.5)
    team.run(1.0)
    assert team.status("robot3").reason.code is Code.STOPPED_BEFORE_START
    assert team.tell("robot3", "release").ok
    team.run(0.2)
    assert team.status("robot3").reason.code is Code.AGENT_FAILS


@pytest.mark.slow
def test_state_stays_while_the_hold_of_a_failure_cannot_be_saved() -> None:
    team = driving()
    team.drawers["robot3"].failure = "no space left on device"
    failed_after_restart(team)
    assert "state" in team.drawers["robot3"].texts
