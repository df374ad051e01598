"""Shapes that move while the team drives: production cores, a fake clock, a network in memory."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, pairwise

import numpy as np
import pytest

from formation.mission.file import load
from formation.mission.model import Mission
from formation.mission.route import Waypoints
from formation.simulation.edges import Edges, formation_error
from tests.support.fleet import Fleet
from tests.unit.leader.leading import ask

SIX = load("six_robots")
ABREAST = {
    name: (-0.5, y) for name, y in zip(SIX.followers, (1.2, 2.0, 0.0, -2.0, -1.2), strict=True)
}  # fmt: skip
THREE = SIX.model_copy(update={"shapes": {**SIX.shapes, "line": ABREAST}})
TOUCHING = 2.0 * SIX.robot.radius
NEAR = 0.02


class Watched:
    """A fleet, and the worst that was seen of it."""

    def __init__(self, mission: Mission, **how: float) -> None:
        self.fleet = Fleet(mission, seed=2, **how)  # type: ignore[arg-type]
        self.closest, self.worst, self.near = float("inf"), 0.0, 0.0

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        fleet, mission = self.fleet, self.fleet.mission
        self.closest, self.worst, self.near, began = float("inf"), 0.0, 0.0, fleet.now
        while fleet.now < began + seconds and not until():
            fleet.run(0.05)
            bodies = [fleet.world._hosted[name].plant.position for name in mission.followers]
            self.closest = min(self.closest, *(abs(one - other) for one, other in combinations(bodies, 2)))
            self.worst = max(self.worst, self.lag())
            if fleet.error() >= NEAR:
                self.near = fleet.now - began

    def lag(self) -> float:
        """Formation error against where the shape is by now [m]."""
        slots = np.array(self.fleet.leader.plan.shape_transition.placed_shape.slots(self.fleet.mission))
        return float(formation_error(Edges(self.fleet.mission.graph), np.array(self.fleet.points()), slots))

    def within_limits(self) -> bool:
        mission = self.fleet.mission
        return all(
            abs(speed) <= mission.robots[name].max_speed
            and abs(turn_rate) <= mission.robots[name].max_turn_rate
            for name in mission.followers
            for _, speed, turn_rate in self.fleet.commands[name]
        )

    def largest_jump(self, since: float) -> float:
        """Between two commands in a row, as a share of the robot's limit."""
        spec = self.fleet.mission.robot
        return max(
            max(abs(after[1] - before[1]) / spec.max_speed, abs(after[2] - before[2]) / spec.max_turn_rate)
            for name in self.fleet.mission.followers
            for before, after in pairwise(one for one in self.fleet.commands[name] if one[0] >= since)
        )

    def want(self, request: str) -> None:
        reply = ask(self.fleet.leader, request.encode())
        assert reply.ok, reply.reason


@pytest.mark.slow
def test_from_hexagon_to_line_to_wedge_while_driving(record_property: Callable[[str, object], None]) -> None:
    watched = Watched(THREE)
    watched.run(15.0)
    for shape in ("line", "wedge"):
        since = watched.fleet.now
        watched.want(f'{{"do":"shape","shape":"{shape}"}}')
        watched.run(9.0)
        record_property(f"{shape}: under 2 cm after [s]", watched.near)
        record_property(f"{shape}: least distance of two robots [m]", watched.closest)
        assert watched.near < 7.0
        assert watched.closest > 2.0 * TOUCHING
        assert watched.worst < 0.8  # over nine edges; a jump of the slots would make it over 10 m
        assert watched.largest_jump(since) < 0.5
    assert watched.within_limits()


@pytest.mark.slow
def test_larger_turned_and_changed_over_while_it_changes() -> None:
    watched = Watched(THREE)
    watched.run(15.0)
    since = watched.fleet.now
    for request in (
        '{"do":"scale","factor":1.5}',
        '{"do":"shape","shape":"line"}',
        '{"do":"rotate","degrees":30.0}',
        '{"do":"shape","shape":"hexagon"}',
    ):
        watched.want(request)
        watched.run(0.8)
        assert watched.worst < 0.8
    watched.run(12.0)
    assert watched.near < 9.0
    assert watched.within_limits()
    assert watched.largest_jump(since) < 0.5


@pytest.mark.slow
def test_a_shape_that_turns_goes_round_a_corner_behind_its_leader() -> None:
    corner = Waypoints(waypoints=((4.0, 0.0), (4.0, 20.0)), speed=0.2)
    watched = Watched(THREE.model_copy(update={"turning": True, "route": (corner,)}))
    watched.run(17.0)
    assert watched.fleet.error() < NEAR
    ahead = watched.fleet.points()
    assert abs(ahead[3] - ahead[0] - (-2.0 + 0.0j)) < NEAR  # robot4 is right behind
    watched.run(18.0)  # the corner comes after 20 s
    assert watched.worst < 0.8
    assert watched.closest > 2.0 * TOUCHING
    ahead = watched.fleet.points()
    assert abs(ahead[3] - ahead[0] - (0.0 - 2.0j)) < NEAR
    assert watched.within_limits()


@pytest.mark.slow
def test_while_the_team_holds_no_slot_moves_and_then_none_jumps() -> None:
    watched = Watched(THREE)
    watched.run(15.0)
    watched.want('{"do":"hold"}')
    watched.run(1.0)
    placed_shape, where = watched.fleet.leader.plan.shape_transition.placed_shape, watched.fleet.points()
    reply = ask(watched.fleet.leader, b'{"do":"shape","shape":"line"}')
    assert reply.reason.endswith("s of running")
    watched.run(2.0)
    assert watched.fleet.leader.plan.shape_transition.placed_shape == placed_shape
    assert watched.fleet.points() == pytest.approx(where, abs=1e-3)
    since = watched.fleet.now
    watched.want('{"do":"run"}')
    watched.run(10.0)
    assert watched.worst < 0.8
    assert watched.fleet.error() < NEAR
    assert watched.largest_jump(since) < 0.5


@pytest.mark.slow
def test_leader_restarted_during_shape_transition_continues_it() -> None:
    watched = Watched(THREE)
    watched.run(15.0)
    watched.want('{"do":"shape","shape":"line"}')
    watched.run(1.5)
    before = watched.fleet.leader.where(watched.fleet.now)
    watched.fleet.kill("leader")
    watched.run(1.5)
    watched.fleet.restart("leader")
    watched.run(0.3, lambda: watched.fleet.leader.leads)
    assert abs(watched.fleet.leader.where(watched.fleet.now) - before) < 0.03
    watched.run(12.0)
    assert watched.worst < 9 * 0.4  # over nine edges; robots have rolled on for a moment, and come back
    assert watched.fleet.error() < NEAR
    assert watched.fleet.leader.plan.shape_transition.wish.shape == "line"
    assert watched.within_limits()


@pytest.mark.slow
@pytest.mark.parametrize("rest", ["hold", "stop"])
def test_restarted_leader_keeps_stop_and_hold(rest: str) -> None:
    watched = Watched(THREE)
    watched.run(8.0)
    watched.want(f'{{"do":"{rest}"}}')
    watched.run(1.0)
    where = watched.fleet.points()
    watched.fleet.restart("leader")
    watched.run(4.0)
    assert watched.fleet.leader.mode == rest
    assert watched.fleet.points() == pytest.approx(where, abs=0.02)
    watched.want('{"do":"release"}')
    watched.want('{"do":"run"}')
    watched.run(12.0)
    assert watched.fleet.error() < NEAR
    assert abs(watched.fleet.points()[0] - where[0]) > 2.0
