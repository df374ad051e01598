"""What must hold in every rehearsal, checked while it runs.

| rule | what must hold |
|---|---|
| exception | no process ends by an exception |
| limits | commands are finite and within the robot's limits |
| ramp | no command is faster than the one before by more than the ramp allows |
| zero | an agent not in state `run` commands zero, or a slow probe; a leader that orders a rest stands |
| access | no process sends another what the access rules of the field refuse |
| orders | no robot follows repeated positions, nor late, replaced, repeated or (where signed) forged orders |
| stop | a robot that acknowledged a stop has saved it, and stands until it is released, whatever restarts |
| release | a robot that acknowledged a release or a hold stands until run is ordered |
| mission | without other faults a robot that receives one of another mission stands after two seconds |
| alone | a robot that two agents command stands after a second |
| hold | without faults no robot holds by itself once it drives |
| leaders | at most one candidate may lead at any time, and no order follows one of a later leader |
| watchdog | a robot stands a second after its agent was killed or suspended, if its watchdog runs |
| blind | a robot with a frozen or late position drives less than 0.1 m |
| touch | no two bodies touch, nor a body what its scanner sees, where the filter promises it |
| follow | a robot that runs receives its own position and all that it follows; without a leader it says so |
| answer | a robot that is stopped refuses run, and each refuses what a newer stop or hold has overtaken |
| named | a robot names its fault once that shows, if faults are of one kind |
| restored | a restarted agent knows its vote, and takes over neither an old integral nor half a state |
| votes | agents vote, and their votes count, only after they were received for long enough |
| wait | a leader waits for a robot no longer than its patience |
| led | some time after the last fault every robot receives a leader |
| detour | a robot that stands off its slot for ten seconds, though it may drive, takes a detour |
| brake | a command, and what the robot still rolls, use up at most half of the room to another robot |
| steps | rounding to a robot's steps adds up to no more than one and a half steps |
| bounds | without faults of sensors every robot stays within the mission's bounds |
| formation | after the last fault all robots run, none is unavailable, and the formation settles in time |
| record | an ended recording has every message that its monitor read or published |
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

from formation.agent.simulated.faults import Fault
from formation.deploy.rehearsal.engine import UPTIME, VirtualProcess
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.rules.answers import Answers
from formation.deploy.rehearsal.rules.blind import BlindPaths
from formation.deploy.rehearsal.rules.bodies import Braking, Standing
from formation.deploy.rehearsal.rules.commands import Commands
from formation.deploy.rehearsal.rules.following import Following
from formation.deploy.rehearsal.rules.leading import Leading, Voting
from formation.deploy.rehearsal.rules.naming import Naming
from formation.deploy.rehearsal.rules.places import Places
from formation.deploy.rehearsal.rules.received import Received, attachment_of
from formation.deploy.rehearsal.rules.recorded import wrong
from formation.deploy.rehearsal.rules.restarts import Restarts
from formation.deploy.rehearsal.rules.settling import Settling
from formation.monitor.recording.recorder import Recorder
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.protocol.status import AgentState
from formation.simulation.body import Body
from formation.topics import POSITION
from formation.wire import Outgoing

RULES = (
    "exception",
    "limits",
    "ramp",
    "zero",
    "access",
    "orders",
    "stop",
    "release",
    "mission",
    "alone",
    "hold",
    "leaders",
    "watchdog",
    "blind",
    "follow",
    "answer",
    "named",
    "restored",
    "votes",
    "wait",
    "led",
    "detour",
    "brake",
    "steps",
    "touch",
    "bounds",
    "formation",
    "record",
)
MIXED_TIME = 2.0
"""Time after which a robot that receives one of another mission must stand [s]."""
LOOK_PERIOD = 0.05
"""Period of the checks that are not of messages [s]."""
TOUCH_PROMISED = frozenset(("kill", "reset", "torn", "unwatched", "hold", "stop", "full", "twice", "again"))
"""Kinds of faults under which the filter's promise holds: positions stay true and in time."""


class Violation(NamedTuple):
    """A rule that was broken."""

    rule: str
    time: float
    """[s]"""
    robot: str
    """Empty for the fleet."""
    what: str


class Judge:
    """Watches one fleet."""

    def __init__(self, fleet: Fleet, faults: Sequence[Fault], max_delay: float) -> None:
        """`max_delay` is the greatest delay of the network without faults [s]."""
        self.violations: list[Violation] = []
        """The first of each rule and robot."""
        self.nearest = math.inf
        """Least distance between two bodies [m]."""
        mission = fleet.mission
        self._fleet, self._mission = fleet, mission
        filtered = mission.collisions.mode == "on" and mission.law.controller.collision_filter
        truthful = all(one.kind in TOUCH_PROMISED for one in faults)
        self._faultless = not faults
        self._only_mixed = {one.kind for one in faults} == {"mixed"}
        self._mixed_since: dict[str, float] = {}  # since when each robot runs another mission [s]
        self._driven: set[str] = set()  # robots that have been in state run
        self._blind = BlindPaths(fleet, faults, self._tell)
        self._commands = Commands(fleet, faults, self._tell)
        slipping = fleet.slips and any(spec.localisation == "odometry" for spec in mission.robots.values())
        self._drift = Body.of(mission.simulated_robot).drift
        self._paths: dict[str, tuple[complex, float]] = {}  # newest true position and path of each robot [m]
        in_time = max_delay <= mission.collisions.delay
        self._sees_truly = truthful and in_time and not slipping
        self._no_touch = filtered and self._sees_truly
        self._places = Places(fleet, faults, self._tell)
        self._settling = Settling(fleet, faults, self._drifted, self._tell)
        received = Received(fleet)
        self._leading = Leading(fleet, received, faults, self._tell)
        self._looks: tuple[Callable[[], None], ...] = (
            Following(fleet, received, faults, self._tell).look,
            Naming(fleet, received, faults, self._tell).look,
            Restarts(fleet, self._tell).look,
            Voting(fleet, received, self._tell).look,
            self._leading.look,
        )
        self._standing = Standing(fleet, self._tell)
        self._braking = Braking(fleet, max_delay, self._tell)
        self._answers = Answers(fleet, self._tell)
        self._position = POSITION.key(mission.leader)
        self._given: set[str] = set()  # the text of each order that a candidate has signed
        self._term, self._ended = 0, set[int]()  # the newest order's, and those that others have followed
        fleet.fleet.watchers.append(self._order)

    @property
    def broken(self) -> set[str]:
        """The broken rules."""
        return {one.rule for one in self.violations}

    @property
    def settled_at(self) -> float | None:
        """When the formation settled after the last fault [s]."""
        return self._settling.at

    @property
    def blind_path(self) -> float:
        """Longest path of a robot with a frozen or late position [m]."""
        return self._blind.longest

    def expect(self, kind: str) -> None:
        """Take into account a fault of this kind, or an order, that happens from now on."""
        self._faultless = False
        self._settling.disturbed()
        self._leading.disturbed()
        self._sees_truly = self._sees_truly and kind in TOUCH_PROMISED
        self._no_touch = self._no_touch and self._sees_truly

    def look(self) -> None:
        """Check what is not a message; call it often."""
        self._check_failures()
        self._check_leaders()
        self._check_bodies()
        self._blind.look()
        self._commands.look()
        for check in self._looks:
            check()
        for sender, receiver, key in self._fleet.fleet.refused:
            self._tell("access", sender, f"sends {key} to {receiver}: the rules of the field refuse it")
        if self._only_mixed:
            self._check_missions()
        if self._fleet.keys is not None:
            self._check_orders()
        if self._faultless:
            self._check_holds()

    def look_settled(self, since: float) -> bool:
        """Whether the formation has settled; `since` is when the last fault ended [s]."""
        return self._settling.look(since)

    def look_recorded(self, recorder: Recorder) -> None:
        """Check that an ended recording has every message that its monitor read or published.

        What arrived after the monitor's last step was never read.
        """
        watched = self._fleet.watched
        if watched is None:
            return
        mailbox = watched.process.mailbox
        lost, unread = mailbox.overflowed, Counter(one.key for one in mailbox.drain())
        expected = mailbox.received + watched.bus.published - unread
        missing = expected - recorder.recorded
        if recorder.failure is not None or recorder.lost or missing.total() > lost:
            what = recorder.failure or f"{recorder.lost} messages lost, not recorded: {dict(missing)}"
            self._tell("record", "", what)
        for path in recorder.paths:
            for what in wrong(path, self._fleet.engine.now):
                self._tell("record", "", what)

    def answered(self, name: str, request: OperatorRequest, reply: OperatorReply) -> None:
        """Note a robot's answer to an operator."""
        self._commands.answered(name, request, reply)

    def ordered(self, request: OperatorRequest) -> None:
        """Note what an operator orders."""
        self._leading.ordered(request)
        self._commands.ordered(request)

    def _order(self, process: VirtualProcess, out: Outgoing) -> None:
        if out.key != self._position or out.attachment is None:
            return
        attachment = attachment_of(out.attachment)
        if attachment.signed:
            self._given.add(attachment.signed)
        term = attachment.term if attachment.order is None else attachment.order.term
        if term in self._ended:
            self._tell("leaders", process.name, "gives orders in a term after which another has led")
        elif term != self._term:
            self._ended.add(self._term)
            self._term = term

    def _check_orders(self) -> None:
        for name, (agent, _) in self._fleet.agents.items():
            followed, (text, _) = agent.state.orders.newest, agent.state.orders.signed
            if followed is not None and text not in self._given:
                self._tell("orders", name, f"follows an order that no candidate gave: {text[:200]}")

    def _check_failures(self) -> None:
        for process in self._fleet.processes:
            if process.failure is not None:
                failure, process.failure = process.failure, None
                self._tell("exception", process.name, f"{type(failure).__name__}: {failure}")

    def _check_holds(self) -> None:
        for name, (agent, _) in self._fleet.agents.items():
            if agent.decision.state is AgentState.RUN:
                self._driven.add(name)
            elif name in self._driven and self._fleet.leading.mode == "run":
                self._tell("hold", name, str(agent.decision.reason))

    def _check_missions(self) -> None:
        now, since, agents = self._fleet.engine.now, self._mixed_since, self._fleet.agents
        mixed = {name for name, (agent, _) in agents.items() if agent.mission.tag != self._mission.tag}
        self._mixed_since = {name: since.get(name, now) for name in mixed}
        long = {name for name, began in self._mixed_since.items() if now - began > MIXED_TIME}
        for name, (agent, _) in agents.items():
            received = long.intersection(one.name for one in agent.others)
            if name not in mixed and received and agent.decision.state is AgentState.RUN:
                self._tell("mission", name, f"drives though {', '.join(received)} runs another mission")

    def _check_leaders(self) -> None:
        now = UPTIME + self._fleet.engine.now
        leaders = [
            name
            for name, (leader, process) in self._fleet.candidates.items()
            if process.alive and leader.lease_end > now
        ]
        if len(leaders) > 1:
            self._tell("leaders", "", " and ".join(leaders))

    def _check_bodies(self) -> None:
        discs = self._fleet.discs()
        self._places.look(discs, touches=self._sees_truly)
        if self._no_touch:
            self._standing.look(discs)
            self._braking.look(discs)
        for name, here, _ in discs:
            before, path = self._paths.get(name, (here, 0.0))
            self._paths[name] = here, path + abs(here - before)
        for (one, here, radius), (other, there, width) in itertools.combinations(discs, 2):
            free = abs(here - there) - radius - width
            self.nearest = min(self.nearest, free)
            drifted = self._drifted(one) + self._drifted(other)
            if free < 0.0 and self._no_touch and drifted <= self._mission.collisions.room:
                self._tell("touch", f"{one} and {other}", f"bodies overlap by {-free:.3f} m")

    def _drifted(self, name: str) -> float:
        """By how much a robot's odometry may have drifted on its way [m]; 0 with positions from outside."""
        spec = self._mission.robots[name]
        return (
            self._drift * self._paths[name][1]
            if name in self._paths and spec.localisation == "odometry"
            else 0.0
        )

    def _tell(self, rule: str, robot: str, what: str) -> None:
        if not any((rule, robot) == (one.rule, one.robot) for one in self.violations):
            self.violations.append(Violation(rule, self._fleet.engine.now, robot, what))
