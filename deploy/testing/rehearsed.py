"""Every process of a mission in memory on a virtual clock, driven by a test."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import Any, get_args

from formation.control.unicycle import AT_REST, Command
from formation.deploy.rehearsal.air import Weather
from formation.deploy.rehearsal.engine import EPOCH, VirtualProcess
from formation.deploy.rehearsal.faults import SENSORS, inject, parse
from formation.deploy.rehearsal.fleet import Fleet, WorldName
from formation.deploy.rehearsal.operator import DESK, Operator
from formation.deploy.rehearsal.rules.commands import command_in
from formation.deploy.rehearsal.rules.judge import LOOK_PERIOD, Judge, Violation
from formation.deploy.testing.fleet import DrivenFleet, check_name, group, mission_of, several
from formation.protocol.outcome import Answer, Outcome
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.stability import intent
from formation.topics import CMD_VEL
from formation.transport import asking, wiring
from formation.wire import Outgoing

ORDER_TIMEOUT_SECONDS = 3.0
"""Wait for the answers to an order [s]."""
MAX_DELAY = 60.0
"""Greatest delay of all links [s]."""


class BrokenRuleError(AssertionError):
    """A rule of rehearsals is broken; `violation` says which."""

    def __init__(self, violation: Violation, seed: int) -> None:
        rule, time, robot, what = violation
        super().__init__(f"{rule}: {time:.2f} s, {robot or 'the fleet'}: {what} (seed {seed})")
        self.violation = violation


class RehearsedFleet(DrivenFleet):
    """All processes of `mission`: robots, watchdogs, agents, leader and standbys; the time is virtual.

    `mission` is a file, the name of a shipped mission, or the text of one. The same arguments and calls give
    the same run. `faults` are those of ``formation rehearse --fault``, such as ``robot2:frozen@3+5``; `loss`
    and `delay` [s] those of all links; `signed`: orders are signed and verified. After every step the rules
    of rehearsals are checked, and the first broken one raises `BrokenRuleError`; if not `strict`,
    `violations` has them.

    Raises ValueError for what is not legal.
    """

    def __init__(
        self,
        mission: str | Path,
        *,
        seed: int = 0,
        law: str | None = None,
        faults: Sequence[str] = (),
        loss: float = 0.0,
        delay: float = 0.0,
        world: WorldName = "kinematic",
        signed: bool = False,
        strict: bool = True,
    ) -> None:
        self.mission = mission_of(mission, law)
        self.seed, self.strict = seed, strict
        check_name(world, get_args(WorldName))
        _check_range("loss", loss, 1.0)
        _check_range("delay", delay, MAX_DELAY, " s")
        given = [parse(text, self.mission) for text in several(faults)]
        of_sensors = [one for one in given if one.kind in SENSORS]
        self._fleet = Fleet(self.mission, seed, Weather(loss, delay), of_sensors, world, signed=signed)
        self._operator = Operator(self._fleet)
        self._judge = Judge(self._fleet, given, delay)
        self._operator.listeners.append(self._judge.answered)
        self._operator.order_listeners.append(self._judge.ordered)
        self._cuts: list[list[tuple[str, str]]] = []
        self._commands: dict[str, Command] = {}
        self._keys = {CMD_VEL.key(name): name for name in self.mission.followers}
        self._fleet.local.watchers.append(self._note)
        inject(given, self._fleet, self._operator)

    @property
    def now(self) -> float:
        """Virtual time since the start [s]."""
        return self._fleet.engine.now

    @property
    def violations(self) -> Sequence[Violation]:
        """The broken rules, the first of each rule and robot."""
        return self._judge.violations

    @property
    def leader(self) -> str:
        """Name of the candidate that leads, or that did last."""
        return self._fleet.leading.name

    def run(self, seconds: float) -> None:
        """Let the fleet run. Raises BrokenRuleError."""
        end = self.now + seconds
        while self.now < end:
            before = len(self._judge.violations)
            self._fleet.engine.run(min(end, self.now + LOOK_PERIOD))
            self._judge.look()
            if self.strict and len(self._judge.violations) > before:
                raise BrokenRuleError(self._judge.violations[before], self.seed)

    def error(self) -> float:
        """Return the true formation error, summed over all edges, in the shape that is ordered [m]."""
        return self._fleet.error()

    def position(self, robot: str) -> complex:
        """Return the true centre of a follower [m; world frame]. Raises ValueError for other names."""
        check_name(robot, self.mission.followers)
        return next(place for name, place, _ in self._fleet.discs() if name == robot)

    def nearest(self) -> float:
        """Return the least distance between two bodies so far [m]; infinite for one robot."""
        return self._judge.nearest

    def state(self, robot: str) -> str:
        """Return the state of a follower's agent, such as ``run`` or ``hold``."""
        check_name(robot, self.mission.followers)
        return self._fleet.agents[robot][0].decision.state.value

    def reason(self, robot: str) -> str:
        """Return why a follower's agent is in its state, in words."""
        check_name(robot, self.mission.followers)
        return str(self._fleet.agents[robot][0].decision.reason)

    def command(self, robot: str) -> Command:
        """Return the newest command to a follower: forward speed [m/s] and turn rate [rad/s]."""
        check_name(robot, self.mission.followers)
        return self._commands.get(robot, AT_REST)

    def kill(self, name: str) -> None:
        """Kill the agent of a follower, or a candidate, as SIGKILL does. Raises ValueError for others."""
        check_name(name, wiring.members(self.mission))
        self._judge.expect("kill")
        self._fleet.kill(name)

    def start(self, name: str) -> None:
        """Start it again, with what is on its disk."""
        check_name(name, wiring.members(self.mission))
        self._fleet.start(name)

    def freeze(self, name: str) -> None:
        """Suspend it, as SIGSTOP does."""
        check_name(name, wiring.members(self.mission))
        self._judge.expect("freeze")
        self._fleet.process_of(name).freeze()

    def thaw(self, name: str) -> None:
        """Let it continue."""
        check_name(name, wiring.members(self.mission))
        self._fleet.process_of(name).thaw()

    def cut(self, some: Iterable[str], others: Iterable[str]) -> None:
        """Lose all messages between two groups of robots, leader and standbys, until `heal`.

        Raises ValueError for an unknown name.
        """
        known = (*wiring.members(self.mission), DESK)
        pairs = list(product(group(some, known), group(others, known)))
        self._judge.expect("cut")
        self._cuts.append(pairs + [(other, one) for one, other in pairs])
        self._fleet.air.cut(self._cuts[-1])

    def heal(self) -> None:
        """End all cuts."""
        while self._cuts:
            self._fleet.air.mend(self._cuts.pop())

    def order(self, order: str, **what: Any) -> Outcome:
        """Order as an operator does, such as ``order("rotate", degrees=30)``; run until all have answered.

        Raises ValueError for an order that is not legal.
        """
        do = intent.request_for(self.mission, order, **what).do
        self._judge.expect("stop" if do == "stop" else "hold")
        answers: dict[str, Answer] = {}
        began = self.now

        def take_reply(name: str, answered: OperatorRequest, reply: OperatorReply) -> None:
            if answered.id == request.id:
                answers[name] = Answer(reply, 1e3 * (self.now - began))

        self._operator.listeners.append(take_reply)
        request = self._operator.order(do, **what)
        recipients = asking.addressed(self.mission, do)
        outcome = Outcome(request, recipients, answers, EPOCH + began, ORDER_TIMEOUT_SECONDS)
        while not outcome.whole and self.now < began + ORDER_TIMEOUT_SECONDS:
            self.run(LOOK_PERIOD)
        self._operator.listeners.remove(take_reply)
        return outcome

    def drive(self, forward: float, turn_rate: float = 0.0, *, seconds: float) -> None:
        """Drive the leader by hand as `formation drive` does [m/s; rad/s], for `seconds`, and let go."""
        self._judge.expect("hold")
        self._operator.drive(forward, turn_rate, seconds)
        self.run(seconds)

    def close(self) -> None:
        """End all processes."""
        for process in self._fleet.processes:
            process.kill()

    def _time(self) -> float:
        return self.now

    def _step(self) -> None:
        self.run(LOOK_PERIOD)

    def _origin(self) -> str:
        return f" (seed {self.seed})"

    def _note(self, _process: VirtualProcess, out: Outgoing) -> None:
        if name := self._keys.get(out.key):
            self._commands[name] = command_in(self.mission, name, out.payload)


def _check_range(name: str, value: float, highest: float, unit: str = "") -> None:
    if not 0.0 <= value <= highest:
        raise ValueError(f"{name} = {value:g}: must be from 0 to {highest:g}{unit}")
