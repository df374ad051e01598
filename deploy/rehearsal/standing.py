"""Rule of robots that stand off their slots though they may drive: they take a detour."""

from __future__ import annotations

from typing import NamedTuple

from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.places import Discs, Tell
from formation.protocol.status import AgentState

STANDING_TIME = 10.0
"""Time after which a robot must have begun a detour [s]."""
OFF_SLOT_ERROR = 0.3
"""Error by its neighbours from which on a robot is off its slot [m]."""
MOTION = 0.01
"""Distance over which a robot has moved [m]."""


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
