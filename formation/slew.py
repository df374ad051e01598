"""Commands that ramp: from rest to a limit takes at least so long. Not in the paper.

| property | why |
|---|---|
| no command is further from the one before than the time between them allows | nothing lurches |
| what is wanted is reached, and then followed to the last bit | nothing lags but what is too sudden |
| limits hold | between two numbers within them there are no others |
| rest is rest | zero velocity is sent at once, and what follows begins from there |

The law and its integral see the command before it comes here, as with the quantiser, which comes after.
"""

from __future__ import annotations

from formation.law import Limits
from formation.unicycle import Command


def slewed(before: Command, wanted: Command, limits: Limits, share: float) -> Command:
    """The command after `before`, as near to `wanted` as it gets by `share` of each limit; floats."""
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
