"""Rules of leaders: which votes count, what a leader orders, and how long it waits for robots."""

from __future__ import annotations

import math
from collections.abc import Sequence

from formation.agent.simulated.faults import Fault
from formation.deploy.rehearsal.engine import UPTIME, VirtualProcess
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.rules.places import Tell
from formation.deploy.rehearsal.rules.received import Received
from formation.protocol.election import LEASE_TIME, VOTE_BOUND_TIME, quarantine
from formation.protocol.request import OperatorRequest
from formation.topics import POSITION

LEADERLESS_TIME = 4.0
"""Time in which a fleet is led again once nothing is wrong [s], or [takeover] where that is over 1 s."""
WAIT_TOLERANCE = 2.0
"""Time beyond its patience for which a leader may still wait [s]."""
LOOK_TIME = 0.1
"""Longest time between two checks, and after what they check [s]."""
TOLERANCE = 1e-6
"""Of times, due to rounding [s]."""


class Leading:
    """What the leader of one fleet does."""

    def __init__(self, fleet: Fleet, received: Received, faults: Sequence[Fault], tell: Tell) -> None:
        self._fleet, self._received, self._tell = fleet, received, tell
        ends = max((one.since + one.lasts for one in faults), default=0.0)
        self._led_from = ends + LEADERLESS_TIME * max(1.0, fleet.mission.takeover)
        cohesion = fleet.mission.cohesion
        self._patience = cohesion.patience if cohesion is not None else None
        self._waits: dict[tuple[VirtualProcess, str], float] = {}  # since when it waits for each robot [s]
        self._stopped = math.inf  # since when an operator's stop is in force [s]

    def ordered(self, request: OperatorRequest) -> None:
        """Note what an operator orders."""
        if request.do == "stop":
            self._stopped = self._fleet.engine.now
        elif request.do == "release":
            self._stopped = math.inf

    def disturbed(self) -> None:
        """Note a disturbance that is no fault of the list."""
        self._led_from = math.inf

    def look(self) -> None:
        """Check the leader, and that there is one."""
        self._check_led()
        leader = self._fleet.leading
        _, process = self._fleet.candidates.get(leader.name, (leader, None))
        if process is None or not process.runs or not leader.leads:
            self._waits.clear()
            return
        now = self._fleet.engine.now
        waits = {(process, name) for name in leader.plan.waits_for}
        self._waits = {one: self._waits.get(one, now) for one in waits}
        for (_, name), since in self._waits.items():
            if self._patience is not None and now - since > self._patience + WAIT_TOLERANCE:
                self._tell("wait", leader.name, f"waits for {name} for {now - since:.1f} s")
        before = self._received.orders[process].newest
        if before is None or before.mode != "stop" or before.term >= leader.term or leader.mode == "stop":
            return
        if self._received.ordered.get((before.term, before.beat), 0.0) > self._stopped:
            self._tell("stop", leader.name, f"orders {leader.mode}, though the leader before it was stopped")

    def _check_led(self) -> None:
        """Check that every robot receives rising beats some time after the last fault."""
        now = self._fleet.engine.now
        if now < self._led_from or not self._fleet.air.undisturbed:
            return
        limit = LEADERLESS_TIME * max(1.0, self._fleet.mission.takeover)
        for name, (_, process) in self._fleet.agents.items():
            silence = now - self._received.orders[process].rose
            if process.runs and silence > limit:
                self._tell("led", name, f"has received no leader for {silence:.1f} s")


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
