"""Ramp: limit how fast commands change. From rest to a limit takes at least `RampLimits.time`.

Not in the paper.

| property | why |
|---|---|
| the change between two commands is bounded by the time between them | no jerk, no slip of wheels |
| the wanted command is reached, and then followed to the last bit | only sudden changes lag |
| limits hold | between two numbers within them there are no others |
| zero is sent as zero | zero velocity is sent at once, and the next command starts from there |

The law and its integral use the command before the ramp, as with the quantiser, which comes after.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from formation.control.controller import Limits
from formation.control.tracker import FRESH_PERIODS
from formation.control.unicycle import AT_REST, Command

MAX_RAMP_PERIODS = 2.0
"""Longest time between two commands that counts for the ramp [periods of control]."""
MAX_CHANGE_SHARE = 0.45
"""Largest change from one command to the next, whatever the time between them [share of a limit]."""
GENTLE_PERIODS = 6.0
"""Time after a gap for which commands stay within `MAX_CHANGE_SHARE` of rest [periods of control]: the
watchdog may have stopped the robot, and its zero may still be on its way."""
FIRST_CHANGE_SHARE = 0.5
"""Largest change of the first command after a gap [share of a limit]: it may have to decrease."""


class RampLimits(NamedTuple):
    """How fast the commands of one robot may change."""

    time: float
    """From rest to a limit [s]; 0 for no ramp."""
    longest: float
    """Longest time between two commands that counts [s]."""
    gap: float
    """After a longer silence the watchdog may have stopped the robot [s]."""
    gentle: float
    """Time after a gap for which commands stay near rest [s]."""


class Ramp(NamedTuple):
    """The ramp's state."""

    before: Command
    """Newest command, before it was quantised."""
    moment: float
    """When that was sent [s]."""
    gentle_until: float
    """Until then commands stay near rest [s]."""


STARTING = Ramp(AT_REST, -math.inf, -math.inf)
"""State of a robot that has received no command yet."""


def ramp_limits(time: float, rate: float) -> RampLimits:
    """The limits of a ramp of `time` [s], 0 for none, for commands at `rate` [Hz]."""
    return RampLimits(
        time,
        min(MAX_RAMP_PERIODS / rate, MAX_CHANGE_SHARE * time),
        FRESH_PERIODS / rate,
        GENTLE_PERIODS * (1.0 / rate),
    )


def ramped(
    ramp: Ramp, wanted: Command, now: float, limits: Limits, most: RampLimits
) -> tuple[Command, float]:
    """The command at `now` [s] nearest to `wanted` (within limits); the new `Ramp.gentle_until`."""
    until = ramp.gentle_until
    if most.time <= 0.0 or (wanted.speed == 0.0 and wanted.turn_rate == 0.0):
        return wanted, until
    silence = now - ramp.moment
    share = min(silence, most.longest) / most.time
    if silence > most.gap:
        until = now + most.gentle
        rests = ramp.before.speed == 0.0 and ramp.before.turn_rate == 0.0
        share = share if rests else FIRST_CHANGE_SHARE
    if now <= until:
        wanted = slewed(AT_REST, wanted, limits, MAX_CHANGE_SHARE)
    return slewed(ramp.before, wanted, limits, share), until


def slewed(before: Command, wanted: Command, limits: Limits, share: float) -> Command:
    """The command nearest to `wanted` that changes from `before` by `share` of each limit at most; floats."""
    if wanted.speed == 0.0 == wanted.turn_rate:
        return wanted
    return Command(
        _nearer(before.speed, wanted.speed, share * limits.max_speed),
        _nearer(before.turn_rate, wanted.turn_rate, share * limits.max_turn_rate),
    )


def _nearer(before: float, wanted: float, most: float) -> float:
    if abs(wanted - before) <= most:
        return wanted
    return before + most if wanted > before else before - most
