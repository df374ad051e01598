"""One robot is lost: the others follow their remaining neighbours until it follows again."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from formation.agent.following import attachment
from formation.agent.following.attachment import FAULT_FREE_TIME
from formation.control.unicycle import AT_REST
from formation.mission.file import load
from formation.mission.model import Collisions, Mission
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState, MotionFault
from formation.stability.losses import losing
from formation.topics import ODOM, POSITION
from formation.wire import Sample
from tests.support.examples import slow
from tests.support.fleet import Fleet
from tests.support.meddling import lost, on
from tests.support.missions import team, teams, with_robots
from tests.unit.agent.sudden import largest_command_change

PATROL = with_robots("patrol", scanner="none").model_copy(
    update={"cohesion": None, "collisions": Collisions(mode="off")}
)
"""Without cohesion the leader drives evenly; without collision filter no robot drives round another."""
SIX = load("six_robots")
BEHIND = {"robot1": "robot2", "robot5": "robot4"}
"""The robot behind each of two: it measures only that one, and has the leader as fallback neighbour."""


def under_way(mission: Mission = PATROL, seconds: float = 9.0) -> Fleet:
    return Fleet.under_way(mission, seconds)


def ask_all(fleet: Fleet, names: Iterable[str], do: str) -> None:
    for name in names:
        assert fleet.ask(name, do).ok


def slot_errors(fleet: Fleet) -> dict[str, float]:
    """True distance of each follower from its slot [m]."""
    leader, *points = fleet.points()
    slots = fleet.leader.plan.shape_transition.placed_shape.slots(fleet.mission)[1:]
    followers = fleet.mission.followers
    return {n: abs(point - leader - slot) for n, point, slot in zip(followers, points, slots, strict=True)}


def unavailable(fleet: Fleet) -> list[str]:
    """The robots that publish that they are unavailable."""
    return [name for name, agent in fleet.agents.items() if agent.state.availability.published]


def assert_own_neighbours_followed(fleet: Fleet, mission: Mission) -> None:
    """Assert that all robots soon run again and follow their own neighbours."""
    fleet.run(2.0 * FAULT_FREE_TIME)
    assert fleet.states == {AgentState.RUN}
    assert unavailable(fleet) == []
    for name in mission.followers:
        assert fleet.agents[name].neighbours.guides == mission.robots[name].neighbours


def dead(fleet: Fleet, name: str) -> Callable[[], None]:
    """Kill the agent; the robot stands, as by its watchdog."""
    fleet.kill(name)
    fleet.world._hosted[name].plant.obey(AT_REST)
    return lambda: fleet.restart(name)


def stopped(fleet: Fleet, name: str) -> Callable[[], None]:
    assert fleet.ask(name, "stop").ok
    return lambda: None if fleet.set_going(name).ok else pytest.fail("not released")


def held(fleet: Fleet, name: str) -> Callable[[], None]:
    assert fleet.ask(name, "hold").ok
    return lambda: None if fleet.ask(name, "run").ok else pytest.fail("still held")


def without_odometry(fleet: Fleet, name: str) -> Callable[[], None]:
    fleet.meddle = lost(ODOM.key(name))
    return lambda: setattr(fleet, "meddle", lambda sample: (sample,))


def blocked(fleet: Fleet, name: str) -> Callable[[], None]:
    """Block the wheels: the robot ignores all commands."""
    plant = fleet.world._hosted[name].plant
    obey = plant.obey
    plant.obey = lambda _: obey(AT_REST)  # type: ignore[method-assign, assignment]
    obey(AT_REST)
    return lambda: setattr(plant, "obey", obey)


LOSSES = [dead, stopped, held, without_odometry, blocked]


@pytest.mark.parametrize(
    ("lose", "name"),
    [
        (blocked, "robot1"),
        *slow(*((lose, "robot1") for lose in LOSSES if lose is not blocked)),
        *slow(*((lose, "robot5") for lose in LOSSES)),
    ],
)
def test_other_robots_stay_in_formation_when_one_is_lost(
    lose: Callable[[Fleet, str], Callable[[], None]], name: str
) -> None:
    fleet = under_way()
    others = [other for other in PATROL.followers if other != name]
    since = fleet.now
    restore = lose(fleet, name)
    worst = max(slot_errors(fleet)[other] for _ in fleet.every(0.1, 4.0) for other in others)
    assert {fleet.agents[other].decision.state for other in others} == {AgentState.RUN}
    assert fleet.agents[BEHIND[name]].neighbours.guides == ("leader",)
    assert fleet.status(BEHIND[name]).follows == ("leader",)
    # others follow a blocked robot until its agent detects that it does not move
    assert worst < (0.35 if lose is blocked else 0.02)
    assert max(slot_errors(fleet)[other] for other in others) < 0.02
    assert largest_command_change(fleet, since) < (0.25 if lose is blocked else 0.1)
    since = fleet.now
    restore()
    seconds = 8.0 if lose is blocked else 6.0  # a probe waits longer, to see late motion
    assert max(slot_errors(fleet)[other] for _ in fleet.every(0.1, seconds) for other in others) < 0.02
    assert max(slot_errors(fleet).values()) < 0.02
    assert fleet.agents[BEHIND[name]].neighbours.guides == (name,)
    assert largest_command_change(fleet, since) < 0.25


def test_blocked_robot_holds_reports_frozen_motion_and_probes() -> None:
    fleet = under_way()
    blocked(fleet, "robot1")
    since = fleet.now
    fleet.run(6.0)
    status = fleet.status("robot1")
    assert status.state == "hold"
    assert status.reason.code is Code.MOTION_FROZEN
    assert status.motion is MotionFault.FROZEN
    assert status.unavailable
    probes = [speed for moment, speed, _ in fleet.commands["robot1"] if moment > since + 1.0]
    assert 0.0 < max(map(abs, probes)) <= 0.05 * PATROL.robot.max_speed + 1e-9


@pytest.mark.slow
def test_robots_behind_held_robot_hold_until_it_runs() -> None:
    fleet = under_way(load("two_chains"))
    fleet.ask("left3", "hold")
    fleet.run(3.0)
    assert fleet.last_command("left4") == AT_REST
    assert fleet.status("left4").state == "hold"
    assert str(fleet.status("left4").reason) == "no neighbour can be followed; unavailable: left3"
    assert {fleet.status(f"left{k}").state for k in (4, 5, 6)} == {"hold"}
    assert {fleet.status(f"left{k}").state for k in (1, 2)} == {"run"}
    fleet.ask("left3", "run")
    fleet.run(1.0)
    assert {fleet.agents[f"left{k}"].decision.state for k in range(1, 7)} == {AgentState.RUN}
    fleet.run(14.0)
    assert max(slot_errors(fleet).values()) < 0.1
    assert unavailable(fleet) == []


@pytest.mark.slow
@pytest.mark.parametrize("do", ["hold", "stop"])
def test_standing_team_has_no_unavailable_robot(do: str) -> None:
    fleet = under_way()
    ask_all(fleet, PATROL.names, do)
    fleet.run(1.0)
    assert unavailable(fleet) == []


def test_starting_team_has_no_unavailable_robot() -> None:
    assert not any(unavailable(fleet) for fleet in Fleet(SIX).every(0.1, 6.0))


@pytest.mark.slow
def test_robot_off_slot_is_available_after_fault_free_time(monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = under_way()
    fleet.ask("robot1", "hold")
    fleet.run(1.0)
    monkeypatch.setattr(attachment, "FOLLOWING_EDGE_ERROR", -1.0)
    fleet.ask("robot1", "run")
    fleet.run(FAULT_FREE_TIME - 1.0)
    assert fleet.agents["robot1"].state.availability.published
    fleet.run(1.5)
    assert not fleet.agents["robot1"].state.availability.published


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(teams(), st.data())
def test_robots_predicted_by_losing_hold_and_resume(mission: Mission, data: st.DataObject) -> None:
    lost = data.draw(st.sampled_from(mission.followers))
    lose = data.draw(st.sampled_from([dead, held]))
    fleet = under_way(mission, 2.0)
    assert fleet.states == {AgentState.RUN}
    restore = lose(fleet, lost)
    fleet.run(2.5)
    predicted = losing(mission, lost)
    stand = {name for name, agent in fleet.agents.items() if agent.decision.state is not AgentState.RUN}
    assert stand - {lost} == set(predicted.holding)
    for name, guides in predicted.instead.items():
        assert fleet.agents[name].neighbours.guides == guides
    restore()
    assert_own_neighbours_followed(fleet, mission)


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(teams(most=5), st.data())
def test_all_robots_resume_after_run_in_any_order(mission: Mission, data: st.DataObject) -> None:
    some = data.draw(st.lists(st.sampled_from(mission.followers), min_size=1, unique=True))
    fleet = under_way(mission, 2.0)
    ask_all(fleet, some, "hold")
    fleet.run(2.0)
    for name in data.draw(st.permutations(some)):
        fleet.ask(name, "run")
        fleet.run(data.draw(st.sampled_from([0.0, 0.3, 2.0])))
    assert_own_neighbours_followed(fleet, mission)


@pytest.mark.slow
def test_two_unavailable_robots_do_not_wait_for_each_other() -> None:
    mission = team({"a": ["leader", "b"], "b": ["leader", "a"], "c": ["a", "b"]})
    fleet = under_way(mission, 3.0)
    for do, seconds in (("hold", 3.0), ("run", 8.0)):
        ask_all(fleet, mission.followers, do)
        fleet.run(seconds)
    assert max(slot_errors(fleet).values()) < 0.02
    assert unavailable(fleet) == []


@pytest.mark.slow
def test_forged_unavailability_stops_no_robot_with_another_neighbour() -> None:
    def forged(sample: Sample) -> tuple[Sample]:
        return (sample._replace(attachment=(sample.attachment or b"")[:-1] + b',"unavailable":true}'),)

    fleet = under_way(SIX)
    fleet.meddle = on(POSITION.key("robot2"), forged)
    fleet.run(3.0)
    assert fleet.states == {AgentState.RUN}
    assert max(slot_errors(fleet).values()) < 0.02
    assert fleet.agents["robot3"].neighbours.guides == ("robot1",)
