"""Quantise commands to multiples of a step, and add the remainder to the next command.

Not in the paper. A TurtleBot3 takes hundredths of m/s and rad/s as whole numbers, cut off towards zero
(`static_cast<int32_t>(x * 100)`): of 0.0549 m/s it drives 0.05, and below 0.01 it stands still. Error
feedback (first-order noise shaping) sends the nearest multiple, and the remainder goes into the next
command.

| property | why |
|---|---|
| what is sent survives the cut exactly | 0.29 · 100 is 28.999… in floats, so multiples are a few ulps long |
| the sums of what is wanted and sent differ by at most one step | their difference is the remainder |
| limits hold strictly | the largest multiple is one within them |
| no wind-up at a limit | the remainder is never more than one step |
| zero is sent as zero | a command of exactly zero is sent unchanged, and the remainder forgotten |

The law and its integral use the command before quantisation, so they are independent of steps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from formation.control.controller import Limits
from formation.control.plane import clip
from formation.control.unicycle import Command

ROUNDING_FACTOR = 1.0 + 4.0 * math.ulp(1.0)
"""Factor with which a multiple survives the rounding of the robot's own product or quotient."""


class Grid(NamedTuple):
    """The legal multiples of one number of a command."""

    step: float
    """[m/s] or [rad/s]; 0 if the robot takes any number."""
    limit: float
    """[m/s] or [rad/s]"""
    most: float
    """The largest multiple within the limit, in steps."""

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
    def of(steps: Command, limits: Limits) -> Quantiser:
        """For a robot with these `steps` [m/s; rad/s], 0 if it takes any number."""
        return Quantiser(
            Grid.of(steps.speed, limits.max_speed), Grid.of(steps.turn_rate, limits.max_turn_rate)
        )


def quantise(quantiser: Quantiser, wanted: Command, remainder: Command) -> tuple[Command, Command]:
    """(command within limits, remainder before) -> (command to send, new remainder)."""
    if wanted.speed == 0.0 and wanted.turn_rate == 0.0:
        return Command(0.0, 0.0), Command(0.0, 0.0)
    speed, speed_left = nearest(quantiser.speed, wanted.speed + remainder.speed)
    turn_rate, turn_left = nearest(quantiser.turn_rate, wanted.turn_rate + remainder.turn_rate)
    return Command(speed, turn_rate), Command(speed_left, turn_left)


def nearest(grid: Grid, wanted: float) -> tuple[float, float]:
    """The legal number nearest to `wanted`, and the remainder, at most one step."""
    if grid.step <= 0.0 or math.isnan(wanted):  # NaN has no nearest integer
        return wanted, 0.0
    sent = clip(float(round(wanted / grid.step)), grid.most) * grid.step + 0.0  # no negative zero
    return clip(sent * ROUNDING_FACTOR, grid.limit), clip(wanted - sent, grid.step)
