"""Rules of what robots are commanded: limits, ramps, steps, rests, stops, and one agent at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence

from formation.agent.core import Agent
from formation.agent.pose.probe import PROBE_SPEED_SHARE
from formation.agent.simulated.faults import Fault
from formation.control.ramp import FIRST_CHANGE_SHARE, RampLimits, ramp_limits
from formation.control.unicycle import AT_REST, Command
from formation.deploy.rehearsal.engine import VirtualProcess
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.rules.places import Tell
from formation.mission.model import Mission
from formation.mission.robot import RobotSpec
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.protocol.status import AgentState
from formation.ros2.messages import Twist, TwistStamped, decode
from formation.topics import CMD_VEL
from formation.wire import Outgoing

STOP_DELAY = 0.1
"""Time from the acknowledgement of a stop to the last command that may move the robot [s]."""
SECOND_AGENT_TIME = 1.0
"""Time after which a robot that two agents command must stand [s]."""
TOLERANCE = 1e-6
"""Relative excess of a limit that counts as rounding."""
MAX_ROUNDED_STEPS = 1.5
"""By how many steps the sums of what is wanted and what is commanded may differ; one remains."""


class Commands:
    """The commands of one fleet's agents, and what its operator ordered them."""

    def __init__(self, fleet: Fleet, faults: Sequence[Fault], tell: Tell) -> None:
        mission = fleet.mission
        self._fleet, self._mission, self._tell = fleet, mission, tell
        self._rounding = Rounding(mission, tell)
        self._ramps = {name: _ramp_of(mission, name) for name in mission.followers}
        self._newest: dict[str, tuple[float, Command]] = {}
        self._keys = {CMD_VEL.key(name): name for name in mission.followers}
        self._stopped: dict[str, float] = {}  # when each robot acknowledged a stop [s]
        self._resting: dict[str, float] = {}  # when each robot acknowledged a release or a hold [s]
        self._newest_order = ""  # id of the newest order
        self._ordered: dict[str, float] = {}  # when each request was ordered, by its id [s]
        self._newest_run = self._newest_release = 0.0  # when they were ordered [s]
        self._contested: dict[str, float] = {}  # since when each robot has two agents [s]
        self._resets = {one.robot for one in faults if one.kind == "reset"}
        fleet.local.watchers.append(self._command)

    def answered(self, name: str, request: OperatorRequest, reply: OperatorReply) -> None:
        """Note a robot's answer to an operator."""
        if name not in self._mission.followers or not reply.ok:
            return
        if request.do == "stop":
            self._check_saved(name, request, reply)
            if self._ordered[request.id] > self._newest_release:
                self._stopped.setdefault(name, self._fleet.engine.now)
        rests = request.do == "hold" or (request.do == "release" and reply.code != "nothing")
        if rests and self._ordered[request.id] > self._newest_run:
            self._resting.setdefault(name, self._fleet.engine.now)

    def ordered(self, request: OperatorRequest) -> None:
        """Note what an operator orders."""
        now = self._fleet.engine.now
        self._ordered[request.id] = now
        if request.do != "query":
            self._newest_order = request.id
        if request.do == "release":  # robots may obey it although their answers are lost
            self._newest_release = now
            self._stopped.clear()
        if request.do == "run":
            self._newest_run = now
            self._resting.clear()

    def look(self) -> None:
        """Note which robots have two agents; call this often."""
        for name, rival in self._fleet.rivals.items():
            if rival.runs and self._fleet.agents[name][1].runs:
                self._contested.setdefault(name, self._fleet.engine.now)
            else:
                self._contested.pop(name, None)

    def _command(self, process: VirtualProcess, out: Outgoing) -> None:
        name = self._keys.get(out.key)
        if name is None or "agent " not in process.name:
            return
        now, command = self._fleet.engine.now, command_in(self._mission, name, out.payload)
        if command != AT_REST and now - self._contested.get(name, now) > SECOND_AGENT_TIME:
            self._tell("alone", name, f"{command.speed:g} m/s from {process.name}, beside another agent")
        if not process.name.startswith("agent "):
            return
        agent, _ = self._fleet.agents[name]
        self._check_limits(name, command)
        if command != AT_REST:
            self._check_rests(name, agent, command, now)
        self._check_ramp(name, now, command)
        self._rounding.check(name, agent, command)
        self._newest[name] = now, command

    def _check_limits(self, name: str, command: Command) -> None:
        spec = self._mission.robots[name]
        shares = command.speed / spec.max_speed, command.turn_rate / spec.max_turn_rate
        if not all(abs(share) <= 1.0 + TOLERANCE for share in shares):  # NaN is not within limits
            self._tell("limits", name, f"{command.speed:g} m/s, {command.turn_rate:g} rad/s")

    def _check_rests(self, name: str, agent: Agent, command: Command, now: float) -> None:
        """Check that a robot may move."""
        decision = agent.decision
        slow = decision.probes and _as_slow_as_a_probe(self._mission.robots[name], command)
        if decision.state is not AgentState.RUN and not slow:
            self._tell("zero", name, f"{command.speed:g} m/s in state {decision.state}")
        if name in self._resets:
            return
        stopped, resting = self._stopped.get(name), self._resting.get(name)
        if stopped is not None and now > stopped + STOP_DELAY:
            self._tell("stop", name, f"{command.speed:g} m/s {now - stopped:.2f} s after it was stopped")
        if resting is not None and now > resting + STOP_DELAY:
            self._tell("release", name, f"{command.speed:g} m/s {now - resting:.2f} s after it was to rest")

    def _check_ramp(self, name: str, now: float, command: Command) -> None:
        time, before = self._newest.get(name, (-math.inf, AT_REST))
        spec, most = self._mission.robots[name], self._ramps[name]
        if most.time <= 0.0:
            return
        silence = now - time
        share = FIRST_CHANGE_SHARE if silence > most.gap else min(silence, most.longest) / most.time
        for new, old, limit, step in (
            (command.speed, before.speed, spec.max_speed, spec.speed_step),
            (command.turn_rate, before.turn_rate, spec.max_turn_rate, spec.turn_rate_step),
        ):
            if abs(new) > abs(old) + (share + 1e-3) * limit + 2.0 * step:
                self._tell("ramp", name, f"from {old:g} to {new:g} within {silence:.3f} s")

    def _check_saved(self, name: str, request: OperatorRequest, reply: OperatorReply) -> None:
        """Check that an acknowledged stop is on the disk, unless the answer says that it may not be."""
        replaced = name in self._resets or name in self._fleet.rivals or request.id != self._newest_order
        saved = self._fleet.disks[name].files.get(f"{name}.stops.json", b"")
        if not replaced and not reply.reason and request.id.encode() not in saved:
            self._tell("stop", name, f"acknowledged {request.id} and has not saved it")


def command_in(mission: Mission, name: str, payload: bytes) -> Command:
    """Decode a command to the robot `name`."""
    stamped = mission.robots[name].cmd_vel == "twist_stamped"
    twist = decode(TwistStamped, payload) if stamped else decode(Twist, payload)
    return Command(twist.speed, twist.turn_rate)


def _ramp_of(mission: Mission, name: str) -> RampLimits:
    spec = mission.robots[name]
    return ramp_limits(spec.ramp if mission.law.controller.ramp else 0.0, spec.rate)


def _as_slow_as_a_probe(spec: RobotSpec, command: Command) -> bool:
    """Whether `command` is slow enough for a probe; rounding may add one step."""
    return all(
        abs(value) <= max(PROBE_SPEED_SHARE * limit, step) + step + TOLERANCE
        for value, limit, step in (
            (command.speed, spec.max_speed, spec.speed_step),
            (command.turn_rate, spec.max_turn_rate, spec.turn_rate_step),
        )
    )


class Rounding:
    """What rounding has left out of the commands of a mission's robots."""

    def __init__(self, mission: Mission, tell: Tell) -> None:
        self._mission, self._tell = mission, tell
        self._left: dict[str, Command] = {}  # since each robot was commanded to stand [m/s; rad/s]

    def check(self, name: str, agent: Agent, command: Command) -> None:
        """Check an agent's newest command."""
        spec, state = self._mission.robots[name], agent.commander.state
        before, self._left[name] = self._left.get(name, AT_REST), AT_REST
        if command == AT_REST:
            return
        steps, limits = (spec.speed_step, spec.turn_rate_step), (spec.max_speed, spec.max_turn_rate)
        each = zip(before, state.ramp.before, command, state.remainder, steps, limits, strict=True)
        left = [
            remainder if abs(sent) > limit - step else was + wanted - sent  # at a limit it is cut off
            for was, wanted, sent, remainder, step, limit in each
        ]
        self._left[name] = Command(*left)
        for rounded, step in zip(left, steps, strict=True):
            if step > 0.0 and abs(rounded) > MAX_ROUNDED_STEPS * step:
                self._tell("steps", name, f"commands are {rounded:g} less than wanted, in steps of {step:g}")
