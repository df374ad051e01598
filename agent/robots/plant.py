"""The body of a simulated robot: Eq. (1) behind wheels that lag, and odometry that is a little wrong.

Wheels follow the command to first order: u(t) = u_c + (u_0 - u_c) e^{-t/T}, the turn rate likewise. On short
steps both are replaced by their exact means, and the pose moves along the arc that these make. With wheels
that do not lag, or that have caught up, one arc is exact for any time.
"""

from __future__ import annotations

import cmath
import math

import numpy as np

from agent.robots.profiles import Body
from formation.plane import FloatArray
from formation.unicycle import Command, advance

STEP = 0.005
"""Longest step while the wheels change speed [s]; the pose's error falls with its square."""
CAUGHT_UP = 40.0
"""After so many time constants what is left of the lag is below the resolution of a float."""


class Plant:
    """One robot's true motion and what its odometry makes of it. It keeps to its last command for ever."""

    def __init__(self, body: Body, position: complex, heading: complex, noise: np.random.Generator) -> None:
        """At rest, centre at `position` [m; world frame], with unit complex `heading` [world frame]."""
        self.position = position
        """True centre [m; world frame]."""
        self.heading = heading
        """True heading, unit complex [world frame]."""
        self.speed = 0.0
        """True forward speed [m/s]."""
        self.turn_rate = 0.0
        """True turn rate [rad/s]."""
        self.command = Command(0.0, 0.0)
        """What the wheels strive for."""
        self._body = body
        self._noise = noise
        self.path = 0.0
        """Length of the way so far [m]."""
        # Odometry errs by a share of the path, to a side of the world that is this robot's own.
        self._drift = body.drift * cmath.rect(1.0, noise.uniform(-math.pi, math.pi))

    def obey(self, speed: float, turn_rate: float) -> None:
        """Take a command: cut to steps, as it is on its way to the firmware, then clamped there."""
        body = self._body
        self.command = Command(
            _clamp(_cut(speed, body.speed_step), body.max_speed),
            _clamp(_cut(turn_rate, body.turn_rate_step), body.max_turn_rate),
        )

    def advance(self, elapsed: float) -> None:
        """Let `elapsed` [s] go by."""
        if elapsed <= 0.0:
            return
        changing = 0.0
        if (self.speed, self.turn_rate) != self.command:
            changing = min(elapsed, CAUGHT_UP * self._body.lag)
        if changing > 0.0:
            self._drive(*self._wheels(changing))
        if elapsed > changing:
            self.speed, self.turn_rate = self.command
            self._drive(np.array([self.speed]), np.array([self.turn_rate]), elapsed - changing)

    def odometry(self) -> tuple[complex, complex]:
        """Centre [m] and heading as this robot measures them [world frame]; each call is a new sample."""
        x, y, angle = self._noise.normal(size=3)
        position = self.position + self._drift * self.path + self._body.position_noise * complex(x, y)
        return position, self.heading * cmath.rect(1.0, self._body.heading_noise * angle)

    def _wheels(self, elapsed: float) -> tuple[FloatArray, FloatArray, float]:
        """Mean speeds and turn rates on equal steps, shapes (steps,), and their length; the wheels go on."""
        steps = math.ceil(elapsed / STEP)
        step = elapsed / steps
        left = np.exp(
            np.arange(steps + 1) * (-step / self._body.lag)
        )  # of the way to the command, (steps + 1,)
        mean = -np.diff(left) * (self._body.lag / step)  # (steps,)
        target = self.command
        speeds = target.speed + (self.speed - target.speed) * mean
        turn_rates = target.turn_rate + (self.turn_rate - target.turn_rate) * mean
        self.speed = float(target.speed + (self.speed - target.speed) * left[-1])
        self.turn_rate = float(target.turn_rate + (self.turn_rate - target.turn_rate) * left[-1])
        return speeds, turn_rates, step

    def _drive(self, speeds: FloatArray, turn_rates: FloatArray, step: float) -> None:
        """Go along one arc after the other; arrays of shape (steps,)."""
        turned = np.cumsum(turn_rates) * step
        before = self.heading * np.exp(1j * (turned - turn_rates * step))
        moves, after = advance(np.zeros_like(before), before, speeds, turn_rates, step)
        self.position += complex(moves.sum())
        self.path += float(np.abs(speeds).sum()) * step
        self.heading = complex(after[-1]) / abs(after[-1])


def _cut(value: float, step: float) -> float:
    return math.trunc(value / step) * step if step > 0.0 else value


def _clamp(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
