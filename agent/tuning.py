"""The gains that one agent goes by: the mission's, or what the leader has tuned them to, taken on smoothly.

An order says where gains are to be in the end. Each robot goes there by its own time, straight in
(ln k_P, ln k_I) and at most so fast that k_P grows or shrinks e-fold in a second, and k_I twice as far:

| property | why |
|---|---|
| the command does not jump | k_I ξ stays, as ξ is rescaled, and k_P moves by 5 % a period at most |
| between stable gains all are stable | for each eigenvalue that is a half-plane there (`formation.stability`) |
| a message more or less is nothing | it goes by time, from where gains are to where an order has them |
| a forged order shakes nobody | what robots could not bear is no order, and nothing comes suddenly |
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

from formation.graph import cyclic_core
from formation.law import Gains
from formation.mission import Mission
from formation.order import LEAST_GAIN, Order, Tuned
from formation.wire import BadMessage

RATE = 1.0
"""ln k_P moves at most so fast [1/s]."""
INTEGRAL = 2.0
"""ln k_I so many times as fast: as stability has it, k_I goes with k_P²."""
MOST = 0.05
"""ln k_P moves at most so far between two commands, however slow the robot is."""


ROUNDING = 1.0 + 1e-6
"""By so little the leader, who finds the eigenvalues otherwise, may judge otherwise."""


class Tuning:
    """The gains of one robot."""

    def __init__(self, mission: Mission) -> None:
        law = mission.law
        self.k_p, self.k_i = law.k_p, law.k_i
        """In force [1/s], [1/s²]."""
        self._gains = law.gains
        self._original = Tuned.model_construct(k_p=law.k_p, k_i=law.k_i)

    @property
    def told(self) -> str:
        """The gains in words, where they are not the mission's; empty else."""
        if (self.k_p, self.k_i) == (self._original.k_p, self._original.k_i):
            return ""
        return f"k_p = {self.k_p:.4g}, k_i = {self.k_i:.4g}"

    def follow(self, order: Order, dt: float, integral: complex) -> tuple[Gains, complex]:
        """The gains `dt` [s] on towards those of the newest order, and the integral rescaled for them."""
        wanted = order.tuned or self._original
        if (self.k_p, self.k_i) != (wanted.k_p, wanted.k_i):
            before = self.k_i
            self._go(wanted, min(RATE * dt, MOST))
            if wanted.k_i > 0.0:  # else it fades with the gain
                integral *= before / self.k_i
        return self._gains._replace(k_p=self.k_p, k_i=self.k_i), integral

    def _go(self, wanted: Tuned, most: float) -> None:
        integral, aim = max(self.k_i, LEAST_GAIN), max(wanted.k_i, LEAST_GAIN)
        proportional = math.log(wanted.k_p / self.k_p)
        far = max(abs(proportional), abs(math.log(aim / integral)) / INTEGRAL)
        if far <= most:
            self.k_p, self.k_i = wanted.k_p, wanted.k_i
            return
        part = most / far
        self.k_p *= math.exp(part * proportional)
        self.k_i = integral * (aim / integral) ** part


class Bearable(NamedTuple):
    """What robots can bear, each by itself: whatever the leader of this mission may order is among it."""

    apart: frozenset[tuple[int, float]]
    """Degree, and period of control [s], of the robots outside the graph's cyclic core."""
    core: frozenset[float]
    """Periods of those inside [s]."""

    @classmethod
    def of(cls, mission: Mission) -> Self:
        """For all robots of a mission."""
        core = {mission.names[index] for index in cyclic_core(mission.graph)}
        robots = {name: mission.robots[name] for name in mission.followers}
        return cls(
            frozenset(
                (len(one.neighbours), 1.0 / one.rate) for name, one in robots.items() if name not in core
            ),
            frozenset(1.0 / one.rate for name, one in robots.items() if name in core),
        )

    def check(self, tuned: Tuned) -> None:
        """Raise BadMessage for gains by which a robot would swing whatever the others do.

        Outside the cyclic core its degree d is an eigenvalue of its own, for which the sampled loop settles
        exactly if k_I T < k_P and k_P d T < 2 + k_I d T²/2. Inside |z| < 1 needs k_P |μ| T < 4 and
        k_I |μ| T² < 4, and there is an eigenvalue of at least 1.
        """
        if not (
            all(_settles(tuned, *one) for one in self.apart) and all(_may(tuned, one) for one in self.core)
        ):
            raise BadMessage(f"unbearable gains: k_p = {tuned.k_p:g}, k_i = {tuned.k_i:g}")


def _settles(tuned: Tuned, degree: int, period: float) -> bool:
    p, i = tuned.k_p * period, tuned.k_i * period**2
    return i < ROUNDING * p and p * degree < ROUNDING * (2.0 + 0.5 * i * degree)


def _may(tuned: Tuned, period: float) -> bool:
    return max(tuned.k_p * period, tuned.k_i * period**2) < ROUNDING * 4.0
