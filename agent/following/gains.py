"""The gains of one agent: the mission's, or those that the leader has ordered, approached smoothly.

An order contains the final gains. Each robot approaches them by its own time, along a straight line in
(ln k_P, ln k_I): k_P grows or shrinks at most e-fold in a second, k_I twice as far.

- The integral's part of the command stays: ξ is rescaled, so that k_I ξ is unchanged.
- No command jumps: a step of the gains that would change one by more than `MAX_COMMAND_STEP_SHARE` is cut.
- All gains on the line between two stable ones are stable: for each eigenvalue the stable gains are a
  half-plane (`formation.stability`).
- Lost messages do not matter: the path depends on time, from the present gains to the ordered ones.
- A forged order has little effect: gains that would be unstable are refused, and changes are slow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

from formation.control.controller import Controller, Gains, Measured
from formation.control.unicycle import Command
from formation.mission.graph import cyclic_core
from formation.mission.model import Mission
from formation.protocol.order import MIN_GAIN, Order, Tuned
from formation.wire import BadMessage

MAX_GAIN_RATE = 1.0
"""Greatest rate of ln k_P [1/s]."""
INTEGRAL_RATE_RATIO = 2.0
"""Rate of ln k_I in multiples of that of ln k_P: for stability k_I goes with k_P²."""
MAX_COMMAND_STEP_SHARE = 0.05
"""Greatest change of a command by one step of the gains, as a share of its limit."""
MAX_HALVINGS = 8
"""Number of times that a step which is too long is halved; then it waits for the next time."""
GAIN_TOLERANCE = 1.0 + 1e-6
"""Relative tolerance for the leader, which computes the eigenvalues in another way."""


@dataclass(slots=True)
class TuningState:
    """The gains in force."""

    k_p: float
    """[1/s]"""
    k_i: float
    """[1/s²]"""


class Tuning:
    """The gains of one robot."""

    def __init__(self, mission: Mission, robot: str, controller: Controller) -> None:
        law = mission.gains_for(controller)
        self.state = TuningState(law.k_p, law.k_i)
        self._law, self._limits, self._gains = controller.step, mission.robots[robot].limits, law
        self._original = Tuned.model_construct(k_p=law.k_p, k_i=law.k_i)

    @property
    def tuned(self) -> bool:
        """Whether the gains differ from the mission's."""
        return (self.state.k_p, self.state.k_i) != (self._original.k_p, self._original.k_i)

    @property
    def gains(self) -> Gains:
        """The gains in the form that the law takes."""
        return self._gains._replace(k_p=self.state.k_p, k_i=self.state.k_i)

    def follow(
        self, order: Order, dt: float, integral: complex, heading: complex, what: Measured
    ) -> tuple[Gains, complex]:
        """Return the gains `dt` [s] nearer to those of the newest order, and the integral rescaled for them.

        The last two arguments are the law's other inputs: see `formation.control.controller`.
        """
        state = self.state
        wanted = order.tuned or self._original
        if (state.k_p, state.k_i) == (wanted.k_p, wanted.k_i):
            return self.gains, integral
        before = self._command(self.gains, integral, heading, what)
        for halved in range(MAX_HALVINGS):
            gains = self._towards(wanted, MAX_GAIN_RATE * dt * 0.5**halved)
            # if no integral is wanted, it fades with its gain
            rescaled = integral * (state.k_i / gains.k_i if wanted.k_i > 0.0 else 1.0)
            after = self._command(gains, rescaled, heading, what)
            if (
                abs(after.speed - before.speed) <= MAX_COMMAND_STEP_SHARE * self._limits.max_speed
                and abs(after.turn_rate - before.turn_rate)
                <= MAX_COMMAND_STEP_SHARE * self._limits.max_turn_rate
            ):
                state.k_p, state.k_i = gains.k_p, gains.k_i
                return gains, rescaled
        return self.gains, integral

    def _towards(self, wanted: Tuned, most: float) -> Gains:
        """Return the gains `most` along the line, by ln k_P, or at its end."""
        state = self.state
        integral, aim = max(state.k_i, MIN_GAIN), max(wanted.k_i, MIN_GAIN)
        proportional = math.log(wanted.k_p / state.k_p)
        far = max(abs(proportional), abs(math.log(aim / integral)) / INTEGRAL_RATE_RATIO)
        if far <= most:
            return self._gains._replace(k_p=wanted.k_p, k_i=wanted.k_i)
        part = most / far
        k_i = wanted.k_i if aim == integral else integral * (aim / integral) ** part
        return self._gains._replace(k_p=state.k_p * math.exp(part * proportional), k_i=k_i)

    def _command(self, gains: Gains, integral: complex, heading: complex, what: Measured) -> Command:
        command, _ = self._law(integral, heading, what, gains, self._limits, 0.0)
        return command


class Bearable(NamedTuple):
    """The gains that are stable for each robot by itself; they include all that a leader may order."""

    apart: frozenset[tuple[int, float]]
    """Degree and control period [s] of the robots outside the graph's cyclic core."""
    core: frozenset[float]
    """Control periods of the robots inside it [s]."""
    integral: bool
    """Whether the law has one; if not, k_I has no effect."""

    @classmethod
    def of(cls, mission: Mission) -> Self:
        """Compute them for all robots of a mission."""
        core = {mission.names[index] for index in cyclic_core(mission.graph)}
        robots = {name: mission.robots[name] for name in mission.followers}
        law = mission.law.controller
        return cls(
            frozenset(
                (law.degree(len(one.neighbours)), 1.0 / one.rate)
                for name, one in robots.items()
                if name not in core
            ),
            frozenset(1.0 / one.rate for name, one in robots.items() if name in core),
            law.integral,
        )

    def check(self, tuned: Tuned) -> None:
        """Raise BadMessage for gains with which a robot would oscillate whatever the others do.

        Outside the cyclic core its degree d is an eigenvalue of its own, for which the sampled loop settles
        exactly if k_I T < k_P and k_P d T < 2 + k_I d T²/2. Inside |z| < 1 needs k_P |μ| T < 4 and
        k_I |μ| T² < 4, and there is an eigenvalue of at least 1.
        """
        gains = tuned if self.integral else tuned.model_copy(update={"k_i": 0.0})
        if not (
            all(_settles(gains, *one) for one in self.apart) and all(_may(gains, one) for one in self.core)
        ):
            raise BadMessage(f"unbearable gains: {tuned.words}")


def _settles(tuned: Tuned, degree: int, period: float) -> bool:
    p, i = tuned.k_p * period, tuned.k_i * period**2
    return i < GAIN_TOLERANCE * p and p * degree < GAIN_TOLERANCE * (2.0 + 0.5 * i * degree)


def _may(tuned: Tuned, period: float) -> bool:
    return max(tuned.k_p * period, tuned.k_i * period**2) < GAIN_TOLERANCE * 4.0
