"""The gains that one agent goes by: the mission's, or what the leader has tuned them to, taken on smoothly.

An order says where gains are to be in the end. Each robot goes there by its own time, straight in
(ln k_P, ln k_I): k_P grows or shrinks at most e-fold in a second, k_I twice as far.

| property | why |
|---|---|
| what the integral commands stays | ξ is rescaled, so that k_I ξ is what it was |
| no command jumps | a step of the gains that would change one by more than `JUMP` is shorter |
| between stable gains all are | for each eigenvalue stability is a half-plane there (`formation.stability`) |
| a message more or less is nothing | it goes by time, from where gains are to where they shall be |
| a forged order shakes nobody | what robots could not bear is no order, and nothing comes suddenly |
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

from formation.graph import cyclic_core
from formation.law import Gains, Measured, nominal
from formation.mission import Mission
from formation.order import LEAST_GAIN, Order, Tuned
from formation.unicycle import Command, saturate
from formation.wire import BadMessage

RATE = 1.0
"""ln k_P moves at most so fast [1/s]."""
INTEGRAL = 2.0
"""ln k_I so many times as fast: as stability has it, k_I goes with k_P²."""
JUMP = 0.05
"""So large a share of a limit a command may change because gains do, from one to the next."""
HALVINGS = 8
"""So often a step is halved that is too long; then it is left for the next time."""
ROUNDING = 1.0 + 1e-6
"""By so little the leader, who finds the eigenvalues otherwise, may judge otherwise."""


class Tuning:
    """The gains of one robot."""

    def __init__(self, mission: Mission, robot: str) -> None:
        law = mission.law
        self.k_p, self.k_i = law.k_p, law.k_i
        """In force [1/s], [1/s²]."""
        self._limits, self._gains = mission.robots[robot].limits, law.gains
        self._original = Tuned.model_construct(k_p=law.k_p, k_i=law.k_i)

    @property
    def told(self) -> str:
        """The gains in words, where they are not the mission's; empty else."""
        if (self.k_p, self.k_i) == (self._original.k_p, self._original.k_i):
            return ""
        return f"k_p = {self.k_p:.4g}, k_i = {self.k_i:.4g}"

    @property
    def gains(self) -> Gains:
        """As the law takes them."""
        return self._gains._replace(k_p=self.k_p, k_i=self.k_i)

    def follow(
        self, order: Order, dt: float, integral: complex, heading: complex, what: Measured
    ) -> tuple[Gains, complex]:
        """The gains `dt` [s] on towards those of the newest order, and the integral rescaled for them.

        The last two are what the law is to be given with them: see `formation.law`.
        """
        wanted = order.tuned or self._original
        if (self.k_p, self.k_i) == (wanted.k_p, wanted.k_i):
            return self.gains, integral
        before = self._command(self.gains, integral, heading, what)
        for halved in range(HALVINGS):
            gains = self._towards(wanted, RATE * dt * 0.5**halved)
            # towards no integral at all it fades with its gain
            rescaled = integral * (self.k_i / gains.k_i if wanted.k_i > 0.0 else 1.0)
            after = self._command(gains, rescaled, heading, what)
            if (
                abs(after.speed - before.speed) <= JUMP * self._limits.max_speed
                and abs(after.turn_rate - before.turn_rate) <= JUMP * self._limits.max_turn_rate
            ):
                self.k_p, self.k_i = gains.k_p, gains.k_i
                return gains, rescaled
        return self.gains, integral

    def _towards(self, wanted: Tuned, most: float) -> Gains:
        """The gains `most` along the way, by ln k_P, or at its end."""
        integral, aim = max(self.k_i, LEAST_GAIN), max(wanted.k_i, LEAST_GAIN)
        proportional = math.log(wanted.k_p / self.k_p)
        far = max(abs(proportional), abs(math.log(aim / integral)) / INTEGRAL)
        if far <= most:
            return self._gains._replace(k_p=wanted.k_p, k_i=wanted.k_i)
        part = most / far
        k_i = wanted.k_i if aim == integral else integral * (aim / integral) ** part
        return self._gains._replace(k_p=self.k_p * math.exp(part * proportional), k_i=k_i)

    def _command(self, gains: Gains, integral: complex, heading: complex, what: Measured) -> Command:
        wished = nominal(integral, heading, what, gains) + heading.conjugate() * what.velocity
        return saturate(wished, *self._limits)


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
            raise BadMessage(f"unbearable gains: {tuned.words}")


def _settles(tuned: Tuned, degree: int, period: float) -> bool:
    p, i = tuned.k_p * period, tuned.k_i * period**2
    return i < ROUNDING * p and p * degree < ROUNDING * (2.0 + 0.5 * i * degree)


def _may(tuned: Tuned, period: float) -> bool:
    return max(tuned.k_p * period, tuned.k_i * period**2) < ROUNDING * 4.0
