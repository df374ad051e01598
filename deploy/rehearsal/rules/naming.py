"""Rule of what robots say of faults: each one that was injected is named in the robot's status.

A fault is judged only if no other kind is injected, operators' orders aside, and its robot has no other; and
only once it shows: a sensor that repeats what it measured while the robot stands is nothing to notice.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from formation.agent.core import Agent
from formation.agent.inbox import MAX_PAUSE
from formation.agent.simulated.faults import Fault
from formation.control.unicycle import AT_REST
from formation.deploy.rehearsal.engine import UPTIME, VirtualProcess
from formation.deploy.rehearsal.faults import OPERATOR
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.rules.places import Tell
from formation.deploy.rehearsal.rules.received import Received
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from formation.topics import ODOM, POSE, POSITION
from formation.wire import Now

START_TIME = 1.0
"""Faults that begin earlier are not judged: agents are just starting [s]."""
STEP_TIME = 0.1
"""Longest time between two steps of an agent that receives its robot [s]."""
FROZEN_MIN_DISTANCE, FROZEN_TIME = 0.8, 2.0
"""Distance [m] and time [s] after which a robot must have noticed a sensor that repeats its measurement."""
SPEEDS_MIN_DISTANCE, MAX_SPEEDS_SIZE = 0.8, 0.3
"""Distance [m] after which odometry must be doubted that reports at most this share of its speeds."""
CARRIED_MIN_DISTANCE, MAX_CARRIED_SIZE, REST_TIME = 0.4, 0.3, 1.5
"""Distance [m] of a robot that is carried, at most so fast [m/s], and that stood for so long before [s]."""
NAMING_TIME = 0.3
"""Time after a freeze within which an agent says that it was frozen [s]."""
MAX_UNCOUNTED = 3
"""Number of repeated messages that may be waiting."""
CONTEST_TIME = 1.0
"""Time with two publishers of a robot within which its neighbours name it [s]."""


class Naming:
    """The faults that the robots of one fleet must name."""

    def __init__(self, fleet: Fleet, received: Received, faults: Sequence[Fault], tell: Tell) -> None:
        self._fleet, self._received, self._tell = fleet, received, tell
        given = [one for one in faults if one.kind not in OPERATOR]
        often = Counter(one.robot for one in given)
        alone = len({one.kind for one in given}) == 1
        self._open = [one for one in given if alone and often[one.robot] == 1 and one.since > START_TIME]
        self._began: dict[Fault, complex] = {}  # where each robot was when its fault began [m]
        self._moving: dict[str, float] = {}  # when each robot was last commanded to move [s]

    def look(self) -> None:
        """Check every fault that has not been named yet; call this often."""
        now = self._fleet.engine.now
        for fault in tuple(self._open):
            if now < fault.since or fault.robot not in self._fleet.agents:
                continue
            agent, process = self._fleet.agents[fault.robot]
            if agent.command != AT_REST:
                self._moving[fault.robot] = now
            if fault.kind == "second":
                self._check_publishers(fault, now)
            elif fault.kind != "repeat" and _named(fault, agent, process.clock()):
                self._open.remove(fault)
            elif fault.kind == "repeat":
                self._check_repeated(fault.robot, agent, process)
            elif self._shows(fault, agent, now):
                self._tell("named", fault.robot, f"does not say that it has a fault of kind {fault.kind}")

    def _shows(self, fault: Fault, agent: Agent, now: float) -> bool:
        """Whether a fault has had so much effect that its robot must have noticed it."""
        end = fault.since + fault.lasts
        if fault.kind == "freeze":
            return fault.lasts > MAX_PAUSE + STEP_TIME and now > end + NAMING_TIME
        if now > end:
            return False
        if self._is_hidden(fault, agent, now):
            self._began.pop(fault, None)
            return False
        least = {"speeds": SPEEDS_MIN_DISTANCE, "carried": CARRIED_MIN_DISTANCE}.get(
            fault.kind, FROZEN_MIN_DISTANCE
        )
        return self._distance(fault) > least

    def _is_hidden(self, fault: Fault, agent: Agent, now: float) -> bool:
        """Whether a fault need not show at present."""
        spec, scanner = self._fleet.mission.robots[fault.robot], agent.avoiding.scanner
        match fault.kind:
            case "speeds":
                return spec.localisation != "odometry" or abs(fault.size) > MAX_SPEEDS_SIZE
            case "scan_frozen":
                empty = scanner is None or scanner.state.empty_since < now + UPTIME
                return empty or now < fault.since + FROZEN_TIME
            case "relative_frozen":
                return spec.measurement != "local" or now < fault.since + FROZEN_TIME
            case "carried":
                moves = now < self._moving.get(fault.robot, 0.0) + REST_TIME
                return moves or abs(fault.size) > MAX_CARRIED_SIZE
        return True

    def _distance(self, fault: Fault) -> float:
        """Distance of a robot from where it was when its fault was judged first [m]."""
        world, _ = self._fleet.robots[fault.robot]
        here = world.plant(fault.robot).position
        return abs(here - self._began.setdefault(fault, here))

    def _check_publishers(self, fault: Fault, now: float) -> None:
        """Check that those that receive a robot with two agents name it."""
        if not fault.since + CONTEST_TIME < now < fault.since + fault.lasts:
            return
        for name, (agent, process) in self._fleet.agents.items():
            around = agent.neighbours
            _, changed = self._received.publishers[process].get(POSITION.key(fault.robot), ("", 0.0))
            receives = fault.robot in around.each and now - changed < CONTEST_TIME
            if receives and fault.robot not in around.contested(process.clock()):
                self._tell("named", name, f"does not say that {fault.robot} has two publishers")

    def _check_repeated(self, name: str, agent: Agent, process: VirtualProcess) -> None:
        """Check that a robot counts the measurements that it received again."""
        for topic in (ODOM, POSE):
            again = self._received.repeated[process, topic.key(name)]
            if (
                agent.dropped[topic.key(name)] < again - MAX_UNCOUNTED
                and topic.key(name) in agent.subscriptions
            ):
                self._tell("named", name, f"has received {again} measurements again, and does not say so")


def _named(fault: Fault, agent: Agent, now: Now) -> bool:
    """Whether an agent names a fault that it has."""
    match fault.kind:
        case "freeze":
            code, over = agent.decision.reason.code, now.mono - UPTIME > fault.since + fault.lasts
            return over and (code is Code.PROCESS_FROZEN or agent.decision.state is AgentState.STOP)
        case "speeds" | "carried":
            return agent.state.motion.doubt is not None
        case "scan_frozen":
            scanner = agent.avoiding.scanner
            doubt = None if scanner is None else scanner.doubt
            return doubt is not None and doubt.code is Code.SCAN_FROZEN
        case "relative_frozen":
            return bool(agent.neighbours.doubts(now))
    return False
