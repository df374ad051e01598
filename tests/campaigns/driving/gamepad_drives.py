"""Drives with a gamepad: stick and button events as a Linux joystick sends them, drawn from a seed.

No gamepad was recorded. A drive is a sequence of manoeuvres, such as a curve, a way backwards or a full stop;
the thumb moves to each new place within a quarter of a second, overshoots a little and trembles.
"""

from __future__ import annotations

import math
import random
from bisect import bisect_right
from collections.abc import Callable, Iterator

from formation.deploy.driving import inputs
from formation.deploy.driving.inputs import Gamepad, Share

EVENT_SECONDS = 0.02
"""Time between two events of an axis [s]."""
THUMB_SECONDS = 0.08
"""Time constant with which a thumb reaches its place [s]."""
TREMBLE = 0.015
"""Standard deviation of a held stick, as a share of its way."""
Place = tuple[float, float]
"""Where the stick is held: forward and to the left, from -1 to 1."""


def manoeuvre(chance: random.Random) -> tuple[str, Place, float]:
    """Draw a manoeuvre: its name, the stick's place, and how long it is held [s]."""
    speed, turn, side = chance.uniform(0.5, 1.0), chance.uniform(0.15, 0.35), chance.choice((-1.0, 1.0))
    kinds: dict[str, tuple[Place, float]] = {
        "straight": ((speed, 0.0), chance.uniform(3.0, 8.0)),
        "curve": ((speed, side * turn), chance.uniform(2.0, 6.0)),
        "reverse": ((-chance.uniform(0.3, 0.7), side * chance.choice((0.0, turn))), chance.uniform(1.5, 4.0)),
        "stop": ((0.0, 0.0), chance.uniform(1.0, 4.0)),
    }
    name = chance.choices(tuple(kinds), (4, 4, 1, 1))[0]
    return name, *kinds[name]


def events(seed: int, seconds: float) -> Iterator[tuple[float, bytes]]:
    """Time [s] and data of each event of a drive."""
    chance, time, stick = random.Random(f"gamepad {seed}"), 0.0, [0.0, 0.0]
    while time < seconds:
        name, place, duration = manoeuvre(chance)
        yield time, _event(time, int(name != "stop"), inputs.BUTTON, inputs.DEAD_MAN_BUTTON)
        end = min(time + duration, seconds)
        while time < end:
            share = 1.0 - math.exp(-EVENT_SECONDS / THUMB_SECONDS)
            for number, (axis, wanted) in enumerate(
                zip((inputs.FORWARD_AXIS, inputs.TURN_AXIS), place, strict=True)
            ):
                stick[number] += share * (wanted + chance.gauss(0.0, TREMBLE) * bool(wanted) - stick[number])
                value = -round(inputs.MAX_AXIS * min(max(stick[number], -1.0), 1.0))
                yield time, _event(time, value, inputs.AXIS, axis)
            time += EVENT_SECONDS


def _event(time: float, value: int, kind: int, number: int) -> bytes:
    return inputs.EVENT.pack(round(1000.0 * time), value, kind, number)


def drive(seed: int, seconds: float) -> Callable[[float], Share]:
    """Return what the driver wants at a time [s], as `formation drive --gamepad` understands the events."""
    gamepad, times, shares = Gamepad(), [-math.inf], [Share()]
    for time, data in events(seed, seconds):
        gamepad.events(data)
        times.append(time)
        shares.append(gamepad.velocity(time) or Share())
    return lambda time: shares[bisect_right(times, time) - 1] if time < seconds else Share()
