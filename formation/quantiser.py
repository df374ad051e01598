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

import math
from typing import NamedTuple

from formation.law import Limits
from formation.plane import clip
from formation.unicycle import Command

LONGER = 1.0 + 4.0 * math.ulp(1.0)
"""Makes a multiple survive the rounding of whatever product or quotient the robot cuts off."""


class Grid(NamedTuple):
    """The multiples that one number of a command may be."""

    step: float
    """[m/s] or [rad/s]; 0 where the robot takes any number."""
    limit: float
    """[m/s] or [rad/s]"""
    most: float
    """The largest multiple within the limit, in steps: what the robot makes of the limit itself."""

    @staticmethod
    def of(step: float, limit: float) -> Grid:
        """The multiples of `step` within ± `limit`."""
        if step <= 0.0:
            return Grid(0.0, limit, 0.0)
        return Grid(step, limit, float(min(math.floor(limit / step), math.floor(limit * (1.0 / step)))))


class Quantiser(NamedTuple):
    """The multiples of both numbers of a command."""

    speed: Grid
    turn_rate: Grid

    @staticmethod
    def of(steps: Command, limits: Limits) -> Quantiser | None:
        """For a robot with these `steps` [m/s; rad/s]; None if it takes every command as it is."""
        if steps.speed <= 0.0 and steps.turn_rate <= 0.0:
            return None
        return Quantiser(
            Grid.of(steps.speed, limits.max_speed), Grid.of(steps.turn_rate, limits.max_turn_rate)
        )


def quantise(quantiser: Quantiser, wanted: Command, remainder: Command) -> tuple[Command, Command]:
    """(command within limits, what remains of the commands before) -> (command to send, what remains)."""
    if wanted.speed == 0.0 and wanted.turn_rate == 0.0:
        return Command(0.0, 0.0), Command(0.0, 0.0)
    speed, speed_left = nearest(quantiser.speed, wanted.speed + remainder.speed)
    turn_rate, turn_left = nearest(quantiser.turn_rate, wanted.turn_rate + remainder.turn_rate)
    return Command(speed, turn_rate), Command(speed_left, turn_left)


def nearest(grid: Grid, wanted: float) -> tuple[float, float]:
    """The nearest legal number to `wanted`, and what remains, at most one step."""
    if grid.step <= 0.0 or math.isnan(wanted):  # no whole number is the nearest to none
        return wanted, 0.0
    sent = clip(float(round(wanted / grid.step)), grid.most) * grid.step + 0.0  # no negative zero
    return clip(sent * LONGER, grid.limit), clip(wanted - sent, grid.step)
