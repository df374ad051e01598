"""Rule `formation`: after the last fault all robots run, none is unavailable, the formation settles in time.

That time is `RECOVERY_TIME`; without faults and obstacles four times what the longest way at top speed takes.

Odometry cannot tell where a robot is where its wheels slip (the physics world), nor, if it counts from the
start, after a fault of `formation.agent.simulated.faults`: the formation is not judged then, only that all
robots run again, but for that one if its scans contradict its odometry. Where it drifts, touches are judged
while that is less than the filter's room, and the formation by so much less strictly.
A robot that was carried to within its margin of a wall or a post, where no probe has room, holds until a
person moves it; the others must run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from formation.agent.core import Agent
from formation.agent.simulated.faults import LATE, STUCK, Fault
from formation.agent.simulated.faults import SIZES as SENSOR_KINDS
from formation.deploy.rehearsal.faults import STATE_LOSING
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.rules.places import Tell, room
from formation.mission.model import Mission
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from formation.slots.shape import PlacedShape

UNPLACED = (Code.SIGHT_CONTRADICTED, Code.SIGHT_SEARCHING, Code.SIGHT_LOST)
"""Reasons of a robot that holds until it finds its neighbours, or a person places it."""
RECOVERY_TIME = 60.0
"""Time after the last fault within which the formation must settle [s]."""
RECOVERY_TIME_AMONG_OBSTACLES = 120.0
"""The same among posts and walls: a robot that held for long drives around them before it catches up [s]."""
MIN_SETTLING_TIME, SETTLING_FACTOR = 10.0, 4.0
"""Without faults: at least this time [s], and by how much longer than the longest path at top speed takes."""


class Settling:
    """Whether one fleet's formation settles."""

    def __init__(
        self, fleet: Fleet, faults: Sequence[Fault], drifted: Callable[[str], float], tell: Tell
    ) -> None:
        """`drifted` returns by how much a robot's odometry may have drifted on its way [m]."""
        self.at: float | None = None
        """When the formation settled after the last fault [s]."""
        mission = fleet.mission
        self._fleet, self._mission, self._drifted, self._tell = fleet, mission, drifted, tell
        among = mission.simulation.posts or mission.simulation.walls
        self._recovery_time = RECOVERY_TIME_AMONG_OBSTACLES if among else RECOVERY_TIME
        free = fleet.air.undisturbed and not (among or faults)
        self._limit = _settling_time(mission) if free else self._recovery_time
        slipping = fleet.slips and any(spec.localisation == "odometry" for spec in mission.robots.values())
        self._lost = {one.robot for one in faults if _is_lost_by(one, mission)} | _misplaced(faults, mission)
        self._carried = {one.robot for one in faults if one.kind == "carried"}
        self._can_settle = not slipping and not self._lost

    def disturbed(self) -> None:
        """Allow the time that it takes after a fault."""
        self._limit = self._recovery_time

    def look(self, since: float) -> bool:
        """Whether the formation has settled; `since` is when the last fault ended [s]."""
        if self.at is None and self._is_settled():
            self.at = self._fleet.engine.now
        if self.at is None and self._fleet.engine.now > since + self._limit:
            error = self._fleet.error()
            why = "; ".join(f"{name}: {_state(self._fleet, name)}" for name in self._mission.followers)
            self._tell("formation", "", f"error {error:.3f} m after {self._limit:.0f} s; {why}")
        return self.at is not None

    def _is_settled(self) -> bool:
        every = [agent for agent, _ in self._fleet.agents.values()]
        cramped = [agent for agent in every if self._asks_for_room(agent)]
        agents = [agent for agent in every if agent not in cramped and not self._asks_to_be_placed(agent)]
        runs = all(agent.decision.state is AgentState.RUN for agent in agents)
        back = not any(agent.state.availability.published for agent in agents)
        return (runs and back) and (
            bool(cramped)
            or not self._can_settle
            or self._fleet.error() <= self._mission.settled + self._drifted_edges()
        )

    def _asks_to_be_placed(self, agent: Agent) -> bool:
        """Whether a robot with wrong odometry holds because its scans contradict that: a person must help."""
        decision = agent.decision
        holds = decision.state is AgentState.HOLD and decision.reason.code in UNPLACED
        return holds and agent.robot in self._lost

    def _asks_for_room(self, agent: Agent) -> bool:
        """Whether a robot that was carried beside a wall or a post holds: a person must move it away."""
        if agent.decision.reason.code is not Code.PROBE_BLOCKED or agent.robot not in self._carried:
            return False
        spec, (world, _) = self._mission.robots[agent.robot], self._fleet.robots[agent.robot]
        return room(self._mission, world.plant(agent.robot).position) < spec.radius + spec.margin

    def _drifted_edges(self) -> float:
        """By how much drift may add to the formation error, summed over all edges [m]."""
        return sum(
            self._drifted(name) + self._drifted(other)
            for name, spec in self._mission.robots.items()
            for other in spec.neighbours
        )


def _settling_time(mission: Mission) -> float:
    """Time in which the formation settles without any fault [s], from the longest path of a robot."""
    shape, leader = PlacedShape(((mission.first_shape, 1.0),), 0.0, 1.0), mission.robots[mission.leader].start
    longest = max(
        abs(spec.start.position - leader.position - shape.slot(mission, name)) / spec.max_speed
        for name, spec in ((name, mission.robots[name]) for name in mission.followers)
    )
    return min(RECOVERY_TIME, max(MIN_SETTLING_TIME, SETTLING_FACTOR * longest))


def _is_lost_by(fault: Fault, mission: Mission) -> bool:
    """Whether a robot's odometry, its only source, is wrong after `fault` in the frame that it counts in."""
    spec = mission.robots.get(fault.robot)
    if spec is not None and fault.kind == "restart":
        return spec.localisation == "odometry" and spec.odometry_frame == "world"
    if spec is None or fault.kind not in SENSOR_KINDS or fault.kind in STUCK or fault.kind in LATE:
        return False
    return spec.localisation == "odometry" and spec.odometry_frame == "start"


def _misplaced(faults: Sequence[Fault], mission: Mission) -> set[str]:
    """Robots with odometry that began anew, while the agent that knew it lost its state."""
    begun_anew = {one.robot for one in faults if one.kind == "restart"}
    forgot = {one.robot for one in faults if one.kind in {"reset", *STATE_LOSING}}
    return {name for name in begun_anew & forgot if mission.robots[name].odometry_frame == "start"}


def _state(fleet: Fleet, name: str) -> str:
    decision = fleet.agents[name][0].decision
    return f"{decision.state}, {decision.reason}"
