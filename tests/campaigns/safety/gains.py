"""Gains that are ordered while robots drive: which are refused, and what is felt of those that are not."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np

from formation.agent.core import Agent
from formation.control.arrays import ComplexArray
from formation.control.controller import Gains, Limits, Measured
from formation.control.unicycle import Command
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.json_message import decode, encode
from formation.protocol.order import Order, Tuned
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.simulation.edges import Edges
from formation.stability import spectrum, tuning
from tests.campaigns.document import Found
from tests.campaigns.parts import table
from tests.campaigns.safety.part import Options, bar, reported
from tests.support.fleet import Fleet
from tests.unit.formation import scenarios

MARGIN = 0.01  # gains are drawn so near to the boundary


def drawn(random: np.random.Generator, rate: float = 20.0, **law: Any) -> Mission:
    """A random graph of 2 to 9 followers with a path to the leader for each, with cycles or without."""
    size = int(random.integers(3, 11))
    neighbours: list[list[int]] = [[]]
    for i in range(1, size):
        others = [j for j in range(size) if j != i and random.random() < 0.25]
        neighbours.append(sorted({int(random.integers(0, i)), *others}))
    slots: ComplexArray = np.arange(size, dtype=np.complex128)
    return scenarios.build(slots, neighbours, law=law, robot={"rate": rate})


def held(mission: Mission, gains: Tuned, period: float) -> float:
    """Largest |z| of the whole sampled loop, from its matrix: what the eigenvalues μ must lead to as well."""
    laplacian = Edges(mission.graph).follower_laplacian()
    unit = np.eye(len(laplacian))
    loop = np.block(
        [[unit - period * gains.k_p * laplacian, -period * gains.k_i * laplacian], [period * unit, unit]]
    )
    return float(np.abs(np.linalg.eigvals(loop)).max())


def growth(mission: Mission, gains: Tuned) -> float:
    """Largest real part of the continuous loop's poles, from its matrix [1/s]."""
    laplacian = Edges(mission.graph).follower_laplacian()
    zero = np.zeros_like(laplacian)
    loop = np.block([[-gains.k_p * laplacian, -gains.k_i * laplacian], [np.eye(len(laplacian)), zero]])
    return float(np.linalg.eigvals(loop).real.max())


def most(mu: ComplexArray, k_p: float) -> float:
    """k_I up to which the continuous loop is stable; infinite for real eigenvalues."""
    with np.errstate(divide="ignore"):
        return float((k_p**2 * mu.real * np.abs(mu) ** 2 / mu.imag**2).min())


def turning(random: np.random.Generator) -> tuple[Mission, float, float]:
    """A mission of some graph with complex eigenvalues, a k_P, and the k_I at which it becomes unstable."""
    while True:
        mission = drawn(random, 200.0, kind="paper")
        k_p, mu = float(random.uniform(0.3, 3.0)), spectrum.laplacian(mission.graph)
        bound = most(mu, k_p)
        if bound < 5.0 and held(mission, Tuned(k_p=k_p, k_i=bound * 0.9), 1 / 200.0) < 1.0:
            return mission, k_p, bound


def unstable(draws: int) -> Iterator[tuple[Mission, Tuned]]:
    """Gains a little beyond the exact bound, by the poles of the loop's own matrix."""
    random = np.random.default_rng(7)
    for _ in range(draws):
        mission, k_p, bound = turning(random)
        gains = Tuned(k_p=k_p, k_i=bound * (1.0 + MARGIN))
        assert growth(mission, gains) > 0.0
        yield mission, gains


def stable(draws: int) -> Iterator[tuple[Mission, Tuned, bool]]:
    """Gains below the bound, and whether they are within a tenth of it: one of two is, or nearly."""
    random = np.random.default_rng(8)
    for number in range(draws):
        mission, k_p, bound = turning(random)
        share = 1.0 - MARGIN * float(random.uniform(1.0, 10.0)) if number % 2 else float(random.random())
        gains = Tuned(k_p=k_p, k_i=bound * share)
        if held(mission, gains, 1 / 200.0) >= 1.0:  # the sampled loop ends a little before
            gains = Tuned(k_p=k_p, k_i=bound * 0.5)
        assert growth(mission, gains) < 0.0
        assert held(mission, gains, 1 / 200.0) < 1.0
        yield mission, gains, gains.k_i > 0.9 * bound


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
        self._gains, self._integral = agent.mission.gains, 0j
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
    mission = mission.under(law)
    fleet = Fleet(mission, seed=3)
    fleet.run(3.0 if mission.standbys else 0.7)
    watched = [Watch(agent) for agent in fleet.agents.values()]
    k_p, k_i = mission.gains
    for after, proportional, integral in (
        (0.0, 2.0, k_i), (1.0, 0.4, 0.1 * k_i), (0.4, 3.0, 4.0 * k_i), (4.0, 1.0, k_i),
        (6.0, 3.0, 0.05), (6.0, 0.7, 0.0), (4.0, 1.2, k_i),
    ):  # fmt: skip
        fleet.run(after)
        assert tune(fleet, k_p=proportional * k_p, k_i=integral).ok
    fleet.run(4.0)
    return fleet, max(one.most for one in watched)


TITLE = "Live gains"
ABOUT = """\
Random graphs of 2 to 9 followers with complex eigenvalues, a random k_p, and k_i 1 % above the bound at which
the loop becomes unstable, or below it, every second one by 1 to 10 % only; what is stable is decided by the
eigenvalues of the whole loop's matrix, which the command does not use. *Jump*: of every command of the law,
how far it is from what the gains and the integral of the step before would have made it, the largest over all
robots and seven changes of up to four times as much, right after the start, on the way and in formation;
production cores on a fake clock."""
DRAWS, MOST = 100, 0.1  # of each kind; share of a limit
MISSIONS, LAWS = ("six_robots", "turtlebot3_pair", "patrol"), ("field", "paper")


def run(options: Options) -> Found:
    """Both kinds of draws, and the jumps of every mission by both laws."""
    draws = 10 if options.quick else DRAWS
    refused = sum(tuning.refusal(mission, gains) is not None for mission, gains in unstable(draws))
    accepted = sum(tuning.refusal(mission, gains) is None for mission, gains, _ in stable(draws))
    cases = list(product(MISSIONS[:1] if options.quick else MISSIONS, LAWS))
    jumps = {f"{name}, {law}": changed(load(name), law)[1] for name, law in reported("gains", cases)}
    most = max(jumps.values())
    bars = [
        bar("unstable gains are refused", f"{refused} of {draws}", refused == draws),
        bar("stable gains are accepted", f"{accepted} of {draws}", accepted == draws),
        bar("no command jumps by over 10 % of a limit", f"{100 * most:.1f} %", most <= MOST),
    ]
    return {"draws": draws, "jumps": jumps, "bars": bars}


def section(found: Found) -> str:
    rows = [f"{name} | {100 * jump:.1f} %" for name, jump in found["jumps"].items()]
    return table("mission, law | largest jump, of a limit", rows)
