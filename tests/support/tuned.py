"""Gains that an operator changes while a fleet drives, and what is felt of that."""

from __future__ import annotations

from formation.agent.core import Agent
from formation.control.controller import Gains, Limits, Measured
from formation.control.unicycle import Command
from formation.mission.model import Mission
from formation.protocol.order import OperatorReply, OperatorRequest, Order, Tuned, decode, encode
from tests.support.fleet import Fleet


def tune(fleet: Fleet, **gains: float) -> OperatorReply:
    request = OperatorRequest.model_validate({"do": "tune", **gains})
    return decode(OperatorReply, fleet.in_charge.request(encode(request), fleet.now))


def limited(command: Command, limits: Limits) -> tuple[float, float]:
    return command.speed / limits.max_speed, command.turn_rate / limits.max_turn_rate


class Watch:
    """How far each command of an agent's law is from what the gains of the step before would have it."""

    def __init__(self, agent: Agent) -> None:
        self.most = 0.0
        """[share of a limit]"""
        self._follow, self._law = agent.tuning.follow, agent._params.law
        self._gains, self._integral = agent.mission.law.gains, 0j
        agent.tuning.follow = self.follow  # type: ignore[method-assign]
        agent._params = agent._params._replace(law=self.law)

    def follow(
        self, order: Order, dt: float, integral: complex, heading: complex, what: Measured
    ) -> tuple[Gains, complex]:
        self._integral = integral
        return self._follow(order, dt, integral, heading, what)

    def law(
        self, integral: complex, heading: complex, what: Measured, gains: Gains, limits: Limits, dt: float
    ) -> tuple[Command, complex]:
        was, _ = self._law(self._integral, heading, what, self._gains, limits, dt)
        command, after = self._law(integral, heading, what, gains, limits, dt)
        pairs = zip(limited(was, limits), limited(command, limits), strict=True)
        self.most = max(self.most, *(abs(one - other) for one, other in pairs))
        self._gains = gains
        return command, after


def changed(mission: Mission, law: str) -> tuple[Fleet, float]:
    """A fleet whose gains were changed seven times, and the most that was felt of it [share of a limit].

    Right after the start, on the way, in formation; a little more, much more, and back at once.
    """
    fleet = Fleet(mission, law=law, seed=3)
    fleet.run(3.0 if mission.standbys else 0.3)
    watched = [Watch(agent) for agent in fleet.agents.values()]
    k_p, k_i = mission.law.k_p, mission.law.k_i
    for after, gains in (
        (0.0, Tuned(k_p=2.0 * k_p, k_i=k_i)),
        (1.0, Tuned(k_p=0.4 * k_p, k_i=0.1 * k_i)),
        (0.4, Tuned(k_p=3.0 * k_p, k_i=4.0 * k_i)),
        (4.0, Tuned(k_p=k_p, k_i=k_i)),
        (6.0, Tuned(k_p=3.0 * k_p, k_i=0.05)),
        (6.0, Tuned(k_p=0.7 * k_p, k_i=0.0)),
        (4.0, Tuned(k_p=1.2 * k_p, k_i=k_i)),
    ):
        fleet.run(after)
        assert tune(fleet, k_p=gains.k_p, k_i=gains.k_i).ok
    fleet.run(4.0)
    return fleet, max(one.most for one in watched)
