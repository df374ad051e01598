"""Rules of the election: which agents vote, and which votes a leader may have."""

from __future__ import annotations

from formation.deploy.rehearsal.engine import UPTIME, VirtualProcess
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.places import Tell
from formation.deploy.rehearsal.received import Received
from formation.protocol.election import LEASE_TIME, VOTE_BOUND_TIME, quarantine
from formation.topics import POSITION

LOOK_TIME = 0.1
"""Longest time between two checks, and after what they check [s]."""
TOLERANCE = 1e-6
"""Of times, due to rounding [s]."""


class Voting:
    """The votes of one fleet."""

    def __init__(self, fleet: Fleet, received: Received, tell: Tell) -> None:
        self._fleet, self._received, self._tell = fleet, received, tell
        self._votes = bool(fleet.mission.standbys)
        self._began: dict[VirtualProcess, float] = {}  # when each agent was first seen [s]

    def look(self) -> None:
        """Check every agent and every leader, where there is an election."""
        if self._votes:
            self._check_agents()
            self._check_leaders()

    def _check_agents(self) -> None:
        now, least = self._fleet.engine.now, quarantine(self._fleet.mission) - LOOK_TIME
        for name, (agent, process) in self._fleet.agents.items():
            age = now - self._began.setdefault(process, now)
            if process.alive and agent.orders.voter.state.given and age < least:
                self._tell("votes", name, f"votes {age:.2f} s after its agent began")

    def _check_leaders(self) -> None:
        """Check that a lease rests on the votes of more than half of the robots.

        A vote counts if its agent has been received for long enough, and since the ballot that it names.
        """
        mission, now = self._fleet.mission, self._fleet.engine.now
        known_before = now - VOTE_BOUND_TIME * mission.takeover + TOLERANCE
        for name, (leader, process) in self._fleet.candidates.items():
            ballot = leader.lease_end - UPTIME - LEASE_TIME * mission.takeover - TOLERANCE
            if not process.runs or leader.lease_end <= UPTIME + now:
                continue
            publishers, newest = self._received.publishers[process], self._received.newest[process]
            keys = [POSITION.key(one) for one in mission.followers]
            counted = [
                key
                for key in keys
                if key in publishers and publishers[key][1] <= known_before and newest[key].arrived >= ballot
            ]
            if 2 * len(counted) <= len(keys):
                self._tell("votes", name, f"leads with {len(counted)} votes of {len(keys)} robots")
