"""Rules of what an agent restores of the one before it: its vote, no old integral, nothing half written."""

from __future__ import annotations

import json
from typing import NamedTuple

from formation.agent.core import Agent
from formation.agent.persistence.restore import MAX_INTEGRAL_AGE, MAX_STATE_AGE
from formation.deploy.rehearsal.engine import UPTIME, VirtualProcess
from formation.deploy.rehearsal.fleet import AgentFiles, Fleet
from formation.deploy.rehearsal.rules.places import Tell

RESTORE_TIME = 1.0
"""Time after its start in which an agent restores what its robot's first message agrees with [s]."""


class Saved(NamedTuple):
    """What was on the disk when an agent began."""

    voted_term: int
    integral: complex
    """[m s]"""
    age: float
    """[s]"""
    began: float
    """When the agent began [s]."""


class Restarts:
    """The restarts of one fleet's agents."""

    def __init__(self, fleet: Fleet, tell: Tell) -> None:
        self._fleet, self._tell = fleet, tell
        self._known: dict[str, tuple[VirtualProcess, Saved | None]] = {}

    def look(self) -> None:
        """Check every agent; call this often."""
        for name, (agent, process) in self._fleet.agents.items():
            files = self._fleet.files[name]
            known = self._known.get(name)
            if known is None or known[0] is not process:
                saved = self._saved(agent, files) if isinstance(files, AgentFiles) else None
                self._known[name] = process, saved
                if saved is not None:
                    self._check_vote(name, agent, saved)
                self._check_stops(name, files)
            elif known[1] is not None:
                self._check_integral(name, agent, known[1])
            if isinstance(files, AgentFiles) and files.restored_torn:
                self._tell("restored", name, "took over a state that was half written")

    def _saved(self, agent: Agent, files: AgentFiles) -> Saved | None:
        now = self._fleet.engine.now
        try:
            state = json.loads((files.before or b"").partition(b"\n")[0].partition(b" ")[2])
        except ValueError:
            return None
        age = UPTIME + now - state["mono"]
        if state["mission"] != agent.mission.fingerprint or age > MAX_STATE_AGE:
            return None
        return Saved(state["voted_term"], complex(*state["integral"]), age, now)

    def _check_stops(self, name: str, files: object) -> None:
        stops = files.read_stops() if isinstance(files, AgentFiles) else None
        try:
            json.loads(b"{}" if stops is None else stops)
        except ValueError:
            self._tell("restored", name, "has half a file of stops on its disk")

    def _check_vote(self, name: str, agent: Agent, saved: Saved) -> None:
        known = agent.orders.voter.state.voted_term
        if known < saved.voted_term:
            self._tell("restored", name, f"has voted for term {saved.voted_term}, and knows {known}")

    def _check_integral(self, name: str, agent: Agent, saved: Saved) -> None:
        recent = self._fleet.engine.now - saved.began <= RESTORE_TIME
        if recent and saved.age > MAX_INTEGRAL_AGE and agent.state.integral == saved.integral != 0j:
            self._tell("restored", name, f"took over an integral of {saved.age:.1f} s ago")
