"""Rules of bodies: they brake before others, and a robot that stands off its slot takes a detour."""

from __future__ import annotations

from typing import NamedTuple

from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.rules.places import Discs, Tell
from formation.protocol.status import AgentState

LOOK_PERIOD = 0.05
"""Longest time from a command to the check [s], beside a period of the robot."""
TOLERANCE = 0.03
"""Distance by which robots may be nearer than is known, beside their motion meanwhile [m]."""
STANDING_TIME = 10.0
"""Time after which a robot must have begun a detour [s]."""
OFF_SLOT_ERROR = 0.3
"""Error by its neighbours from which on a robot is off its slot [m]."""
MOTION = 0.01
"""Distance over which a robot has moved [m]."""


class Braking:
    """The approaches of one fleet's robots."""

    def __init__(self, fleet: Fleet, delay: float, tell: Tell) -> None:
        """`delay` [s] is the greatest of the network without faults."""
        self._fleet, self._tell, self._delay = fleet, tell, delay
        mission = fleet.mission
        law = mission.law.controller
        self._holds = {name: mission.control(name, law).avoidance.hold for name in mission.followers}

    def look(self, discs: Discs) -> None:
        """Check the robots at `discs`."""
        for name, here, radius in discs:
            agent, process = self._fleet.agents.get(name, (None, None))
            if agent is None or process is None or not process.runs or agent.command.speed == 0.0:
                continue
            spec = self._fleet.mission.robots[name]
            known = {**agent.neighbours.each, **agent.avoiding.others}
            age = LOOK_PERIOD + 1.0 / spec.rate + self._delay
            for other, there, width in discs:
                one = known.get(other)
                if other not in agent.avoiding.avoids or one is None or one.stream.state.arrived is None:
                    continue
                towards = (there - here) / abs(there - here)
                nearer = self._speed(name, towards)
                closing = max(0.0, nearer + self._speed(other, -towards))
                room = abs(there - here) - radius - width + closing * age + TOLERANCE
                free = max(0.0, 0.5 * room - self._rolling(name, towards))
                if nearer > free / self._holds[name] + spec.speed_step:
                    self._tell("brake", name, f"{nearer:.2f} m/s towards {other}, {room:.2f} m away")

    def _rolling(self, name: str, towards: complex) -> float:
        """How far a robot would still go in a direction if it were commanded to stop now [m]."""
        plant = self._fleet.robots[name][0].plant(name)
        speed = plant.moving.speed * (plant.heading * towards.conjugate()).real
        return self._fleet.mission.collisions.lag * max(0.0, speed)

    def _speed(self, name: str, towards: complex) -> float:
        """Speed at which a robot is commanded to move in a direction [m/s]."""
        world, _ = self._fleet.robots[name]
        agent, _ = self._fleet.agents.get(name, (None, None))
        if agent is None:
            return 0.0
        return agent.command.speed * (world.plant(name).heading * towards.conjugate()).real


class Stand(NamedTuple):
    """Where a robot stands off its slot."""

    at: complex
    """[m]"""
    since: float
    """[s]"""
    deadlocks: int
    """How often it had taken a detour before."""


class Standing:
    """The robots of one fleet that stand off their slots."""

    def __init__(self, fleet: Fleet, tell: Tell) -> None:
        self._fleet, self._tell = fleet, tell
        self._stands: dict[str, Stand] = {}

    def look(self, discs: Discs) -> None:
        """Check the robots at `discs`."""
        for name, here, _ in discs:
            agent, process = self._fleet.agents.get(name, (None, None))
            if agent is None or process is None:
                continue
            off = process.runs and agent.decision.state is AgentState.RUN
            off = off and agent.state.availability.error > OFF_SLOT_ERROR
            now, deadlocks = self._fleet.engine.now, agent.avoiding.state.avoidance.deadlocks
            stand = self._stands.get(name)
            if not off or stand is None or abs(here - stand.at) > MOTION or deadlocks != stand.deadlocks:
                self._stands[name] = Stand(here, now, deadlocks)
            elif now - stand.since > STANDING_TIME:
                self._tell("detour", name, f"has stood off its slot for {now - stand.since:.0f} s")
