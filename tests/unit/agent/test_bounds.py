"""Robots stay inside the mission's bounds: production cores on a fake clock."""

from __future__ import annotations

from dataclasses import replace

import pytest

from formation.mission.file import load
from formation.mission.model import Bounds, Mission
from formation.mission.route import Straight
from formation.protocol.order import Place
from formation.protocol.status import AgentState
from formation.ros2.messages import Pose
from formation.slots.geofence import Geofence, size_of
from formation.topics import POSITION
from tests.support.fleet import Fleet, at
from tests.support.meddling import altered, reordered
from tests.support.missions import with_robots
from tests.unit.leader.leading import ask, leading, positions

SIX = load("six_robots")
AT_REST = (0.0, 0.0)


def within(mission: Mission, x: tuple[float, float], y: tuple[float, float]) -> Mission:
    return mission.model_copy(update={"bounds": Bounds(x=x, y=y)})


def on_straight_route(
    mission: Mission, speed: float, degrees: float = 0.0, duration: float | None = None
) -> Mission:
    leg = Straight(speed=speed, heading_deg=degrees, duration=duration)
    return mission.model_copy(update={"route": (leg,)})


STANDING = within(
    on_straight_route(with_robots("six_robots", localisation="external"), 0.0), (-5.0, 10.0), (-5.0, 5.0)
)
SQUARE = ((-6.0, 6.0), (-6.0, 6.0))


def farthest_outside(fleet: Fleet) -> float:
    """Greatest distance of a follower outside the bounds; negative inside [m]."""
    area = next(iter(fleet.agents.values()))._fence.area
    return max(area.breach(fleet.plant(name).position, "").excess for name in fleet.mission.followers)


@pytest.mark.slow
@pytest.mark.parametrize(
    "change", [{"scale": 1000.0, "slots": None}, {"place": Place(x=0.0, y=-29.0, heading=0.0)}]
)
def test_forged_order_outside_the_bounds_is_refused(change: dict[str, object]) -> None:
    fleet = Fleet.under_way(SIX, 10.0, seed=1)
    fleet.meddle = reordered(POSITION.key("robot1"), **change)
    before = fleet.points()
    fleet.run(10.0)
    assert max(abs(now - then) for now, then in zip(fleet.points()[1:], before[1:], strict=True)) < 0.5
    assert fleet.states == {AgentState.HOLD}
    assert "order outside the bounds" in fleet.status("robot2").dropped_last[POSITION.key("robot1")]


@pytest.mark.slow
def test_false_leader_position_leads_no_robot_out_of_bounds() -> None:
    """The leader's orders are inside the bounds; its position leaves them at 0.5 m/s."""
    fleet = Fleet(within(SIX, (-5.0, 12.0), (-4.0, 6.0)), seed=1).after(10.0)
    fleet.meddle = altered(
        POSITION.key("robot1"), Pose, lambda one: replace(one, position=one.position + 0.5 * fleet.now - 5.0)
    )
    fleet.run(30.0)
    assert farthest_outside(fleet) < 0.0
    assert fleet.states == {AgentState.HOLD}
    assert "outside the bounds: robot1" in fleet.message("robot2")


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [0.0, 135.0])
def test_leader_stops_its_team_inside_the_bounds(degrees: float) -> None:
    fleet = Fleet(within(on_straight_route(SIX, 0.6, degrees), *SQUARE), seed=2).after(20.0)
    assert farthest_outside(fleet) < 0.0
    assert fleet.error() < SIX.settled
    assert fleet.leader.plan.fenced
    assert fleet.states == {AgentState.RUN}
    stopped = fleet.leader.where(fleet.now)
    fleet.run(2.0)
    assert fleet.leader.where(fleet.now) == stopped


@pytest.mark.slow
def test_team_at_the_bounds_can_be_led_back() -> None:
    fleet = Fleet(within(on_straight_route(SIX, 0.6), *SQUARE), seed=2).after(14.0)
    assert fleet.leader.plan.fenced
    assert not fleet.ask("robot1", "speed", speed=1.0, degrees=0.0).ok
    assert fleet.ask("robot1", "speed", speed=0.5, degrees=180.0).ok
    fleet.run(5.0)
    assert fleet.leader.where(fleet.now).real < 4.0
    assert not fleet.leader.plan.fenced


@pytest.mark.slow
def test_robot_outside_bounds_holds_until_brought_back() -> None:
    fleet = Fleet(STANDING, seed=1).after(8.0)
    robot, home = fleet.plant("robot3"), fleet.plant("robot3").position
    robot.position = 0.0 + 7.5j
    fleet.run(5.0)
    assert fleet.status("robot3").state == "hold"
    assert "outside the bounds: y = 7.50 m, limit 5.00 m" in fleet.message("robot3")
    assert fleet.last_command("robot3") == AT_REST
    assert fleet.status("robot2").state == "run"
    robot.position = home.real + 4.95j  # inside, but not well inside
    fleet.run(5.0)
    assert "y = 4.95 m, limit 4.90 m" in fleet.message("robot3")
    robot.position = home.real + 4.7j
    fleet.run(20.0)
    assert fleet.status("robot3").state == "run"
    assert fleet.error() < SIX.settled


@pytest.mark.slow
def test_noise_at_bounds_keeps_robot_in_hold() -> None:
    noisy = STANDING.simulated_robot.model_copy(update={"position_noise": 0.005})
    fleet = Fleet(STANDING.model_copy(update={"simulated_robot": noisy}), seed=1).after(10.0)
    fleet.plant("robot3").position = -1.5 + 5.0j
    fleet.run(1.0)
    states = {fleet.agents["robot3"].decision.state for _ in fleet.every(0.05, 3.0)}
    assert states == {AgentState.HOLD}


def test_reply_names_slot_and_limit_of_bounds() -> None:
    fleet = Fleet(within(SIX, (-5.0, 25.0), (-4.0, 14.0)), seed=1).after(1.0)
    reply = fleet.ask("robot1", "scale", factor=3.0)
    assert not reply.ok
    assert reply.reason.startswith("out of bounds: robot4's slot at x = -5.8")
    assert reply.reason.endswith("limit -4.6 m")
    reply = fleet.ask("robot1", "route", legs=({"waypoints": ((5.0, 0.0), (5.0, 20.0)), "speed": 0.5},))
    assert not reply.ok
    assert reply.reason.startswith("out of bounds after ")
    assert "robot2's slot at y = 20.87 m, limit 13.6 m" in reply.reason
    reply = fleet.ask("robot1", "speed", speed=0.5, degrees=90.0)
    assert reply.ok
    assert reply.reason.startswith("on a route without an end from where it is; stops at the bounds in 25.")
    assert reply.reason.endswith("where robot2's slot reaches y = 13.6 m")


def test_rotation_that_leaves_bounds_later_on_route_is_refused() -> None:
    fleet = Fleet(
        within(on_straight_route(SIX, 0.5, duration=20.0), (-6.0, 12.0), (-6.0, 6.0)), seed=1
    ).after(1.0)
    reply = fleet.ask("robot1", "rotate", degrees=180.0)
    assert not reply.ok
    assert "robot4's slot at x = 12 m, limit 11.6 m" in reply.reason


@pytest.mark.slow
def test_turning_team_stops_before_slots_leave_bounds() -> None:
    fleet = Fleet(within(load("patrol"), (-4.0, 6.0), (-4.0, 6.0)), seed=1).after(45.0)
    assert farthest_outside(fleet) < 0.0
    assert fleet.leader.plan.fenced


@pytest.mark.parametrize("name", ["six_robots", "turtlebot3_pair", "two_chains"])
def test_robots_accept_every_rotation_at_largest_scale(name: str) -> None:
    """The slots of an order are rounded, those that the leader checks are not."""
    mission = load(name)
    fence = Geofence(mission)
    for degrees in range(0, 360, 5):
        leader = leading(mission)
        assert ask(leader, f'{{"do":"scale","factor":{fence.area.reach / size_of(mission)}}}').ok
        assert ask(leader, f'{{"do":"rotate","degrees":{degrees}}}').ok
        for one in positions(0.1, leader.step(at(0.1), [])):
            fence.check(one.order)  # raises BadMessage
