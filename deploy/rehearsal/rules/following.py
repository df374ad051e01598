"""Rules of what robots follow: what they receive now, a leader that is alive, its newest order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from formation.agent.core import Agent
from formation.agent.simulated.faults import Fault
from formation.control.tracker import FRESH_PERIODS, longest_delay
from formation.deploy.rehearsal.engine import UPTIME, VirtualProcess
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.rules.places import Tell
from formation.deploy.rehearsal.rules.received import Newest, Received
from formation.protocol.election import expiry
from formation.protocol.lateness import MAX_BEAT_LATENESS
from formation.protocol.order import Order
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from formation.topics import ODOM, POSE, POSITION, RELATIVE

STEP_TIME = 0.6
"""Time in which every agent that is not slow takes a step, and that is looked at [s]."""
SHIFTS = frozenset(("clock", "drift"))
"""Faults by which stamps do not tell how late a message is."""
NOT_LOST = frozenset((Code.RUNNING, Code.NO_NEIGHBOUR))
"""What a robot without a leader must not say: that row of the failsafe table comes later."""


class Followed(NamedTuple):
    """The newest order of one agent, and when that was noticed [s]."""

    order: Order
    since: float


class Following:
    """What the robots of one fleet follow."""

    def __init__(self, fleet: Fleet, received: Received, faults: Sequence[Fault], tell: Tell) -> None:
        self._fleet, self._received, self._tell = fleet, received, tell
        self._slack = STEP_TIME + max((one.size for one in faults if one.kind == "slow"), default=0.0)
        self._stamped = not any(one.kind in SHIFTS for one in faults)
        self._expiry = expiry(fleet.mission)
        self._followed: dict[VirtualProcess, Followed] = {}
        self._quickest: dict[tuple[VirtualProcess, int], Newest] = {}  # orders of a term
        self._counts: dict[tuple[VirtualProcess, str, str], int] = {}  # of each robot and publisher

    def look(self) -> None:
        """Check every agent that runs."""
        for name, (agent, process) in self._fleet.agents.items():
            if process.runs:
                self._check_counts(name, agent, process)
                self._check_leader(name, agent, process)
                self._check_order(name, agent, process)
                if agent.decision.state is AgentState.RUN:
                    self._check_sources(name, agent, process)

    def _check_sources(self, name: str, agent: Agent, process: VirtualProcess) -> None:
        now, newest = self._fleet.engine.now, self._received.newest[process]
        for key, rate, judges_delay in self._sources(name, agent):
            known, limit = newest.get(key, Newest()), FRESH_PERIODS / rate + self._slack
            if now - known.arrived > limit:
                self._tell("follow", name, f"runs without {key} for {now - known.arrived:.1f} s")
            elif judges_delay and now - known.sent > known.quickest + longest_delay(rate) + limit:
                self._tell("follow", name, f"runs by {key} of {now - known.sent:.1f} s ago")

    def _sources(self, name: str, agent: Agent) -> Iterator[tuple[str, float, bool]]:
        """The keys that a robot acts on, their rates [Hz], and whether late messages are refused."""
        spec = self._fleet.mission.robots[name]
        yield (ODOM if spec.localisation == "odometry" else POSE).key(name), spec.rate, False
        for other in agent.neighbours.guides:
            if spec.measurement == "local":
                yield RELATIVE.key(name, other), spec.rate, False
            else:
                yield POSITION.key(other), self._fleet.mission.robots[other].rate, self._stamped

    def _check_counts(self, name: str, agent: Agent, process: VirtualProcess) -> None:
        for other, neighbour in agent.neighbours.each.items():
            bound = neighbour.publisher.state.bound
            if bound is not None:
                key = process, other, bound.publisher_id
                if bound.count < self._counts.get(key, 0):
                    self._tell(
                        "orders", name, f"accepts position {bound.count} of {other} after {self._counts[key]}"
                    )
                self._counts[key] = bound.count

    def _check_leader(self, name: str, agent: Agent, process: VirtualProcess) -> None:
        followed, reason = agent.orders.newest, agent.decision.reason.code
        silence = self._fleet.engine.now - self._received.orders[process].rose
        if followed is not None and silence > followed.timeout + self._slack and reason in NOT_LOST:
            self._tell("follow", name, f"{reason} though its leader's newest order is {silence:.1f} s old")

    def _check_order(self, name: str, agent: Agent, process: VirtualProcess) -> None:
        followed, before = agent.orders.newest, self._followed.get(process)
        if followed is None or (before is not None and followed == before.order):
            return
        now = self._fleet.engine.now
        self._followed[process] = Followed(followed, now)
        if followed.term not in self._received.orders[process].risen:
            self._tell("orders", name, "follows an order before its beat has risen")
        replaced = before is not None and followed.term < before.order.term
        if replaced and before is not None and now - before.since < self._expiry - self._slack:
            self._tell("orders", name, "follows a leader that another had replaced")
        ordered = self._received.ordered.get((followed.term, followed.beat))
        if ordered is not None:
            arrived = min(now, agent.state.orders.lived - UPTIME)  # it may have been frozen since
            known = self._quickest.get((process, followed.term), Newest()).after(ordered, arrived)
            self._quickest[process, followed.term] = known
            if arrived - ordered > known.quickest + MAX_BEAT_LATENESS + self._slack:
                self._tell("orders", name, f"follows an order of {arrived - ordered:.1f} s before")
