"""Commands for a robot that cuts them to multiples of a step: what is lost now is asked for with the next.

Not in the paper. A TurtleBot3 takes hundredths of m/s and rad/s as whole numbers, cut off towards zero
(`static_cast<int32_t>(x * 100)`): of 0.0549 m/s it drives 0.05, and below 0.01 it stands still. Error
feedback (first-order noise shaping) sends the nearest multiple, and what remains goes into the next command.

| property | why |
|---|---|
| what is sent survives the cut exactly | 0.29 · 100 is 28.999… in floats, so multiples are a few ulps long |
| the sums of what is wanted and sent differ by at most one step | nothing but the remainder is between them |
| limits hold strictly | the largest multiple is one within them |
| no wind-up at a limit | the remainder is never more than one step |
| rest is rest | a command of exactly zero is sent as it is, and the remainder forgotten |

The law and its integral see the command before it comes here, so they know nothing of steps.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from formation.law import Limits
from formation.plane import Reals, clip
from formation.unicycle import Command

LONGER = 1.0 + 4.0 * float(np.finfo(np.float64).eps)
"""Makes a multiple survive the rounding of whatever product or quotient the robot cuts off."""


class Grid(NamedTuple):
    """The multiples that one number of a command may be; scalars or arrays of one shape."""

    step: Reals
    """[m/s] or [rad/s]; 0 where the robot takes any number."""
    limit: Reals
    """[m/s] or [rad/s]"""
    most: Reals
    """The largest multiple within the limit, in steps: what the robot makes of the limit itself."""

    @staticmethod
    def of(step: Reals, limit: Reals) -> Grid:
        """The multiples of `step` within ± `limit`."""
        width = np.where(step > 0.0, step, 1.0)
        return Grid(step, limit, np.minimum(np.floor(limit / width), np.floor(limit * (1.0 / width))))

    def nearest(self, wanted: Reals) -> tuple[Any, Any]:
        """The nearest legal number to `wanted`, and what remains, at most one step."""
        width = np.where(self.step > 0.0, self.step, 1.0)
        sent = clip(np.rint(wanted / width), self.most) * width + 0.0  # no negative zero
        coarse, remainder = self.step > 0.0, clip(wanted - sent, width)
        survives = clip(sent * LONGER, self.limit)
        return np.where(coarse, survives, wanted)[()], np.where(coarse, remainder, 0.0)[()]


class Quantiser(NamedTuple):
    """The multiples of both numbers of a command."""

    speed: Grid
    turn_rate: Grid

    @staticmethod
    def of(steps: Command, limits: Limits) -> Quantiser | None:
        """For robots with these `steps` [m/s; rad/s]; None where no command is cut."""
        if not np.any(steps):
            return None
        return Quantiser(
            Grid.of(steps.speed, limits.max_speed), Grid.of(steps.turn_rate, limits.max_turn_rate)
        )

    def quantise(self, wanted: Command, remainder: Command) -> tuple[Command, Command]:
        """(command within limits, what remains of the commands before) -> (command to send, what remains)."""
        speed, speed_left = self.speed.nearest(wanted.speed + remainder.speed)
        turn_rate, turn_left = self.turn_rate.nearest(wanted.turn_rate + remainder.turn_rate)
        moving = np.where((wanted.speed == 0.0) & (wanted.turn_rate == 0.0), 0.0, 1.0)[()]
        return Command(moving * speed, moving * turn_rate), Command(moving * speed_left, moving * turn_left)
