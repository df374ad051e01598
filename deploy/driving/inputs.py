"""What a driver wants now, from keys, a gamepad or Twist messages. Pure but for reading files.

Each input has `velocity`: a share of the greatest speed and turn rate, from -1 to 1, or `RELEASED` when the
driver lets go. None means that the input has failed.
"""

from __future__ import annotations

import math
import os
import re
import struct
from collections import deque
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from formation.control.plane import clip


class Share(NamedTuple):
    """A wanted velocity, as a share of the greatest."""

    forward: float = 0.0
    turn: float = 0.0
    """Counter-clockwise."""


RELEASED = Share()
KEYS: Mapping[str, Share] = MappingProxyType(
    {
        "u": Share(1.0, 1.0), "i": Share(1.0, 0.0), "o": Share(1.0, -1.0),
        "j": Share(0.0, 1.0), "k": RELEASED, "l": Share(0.0, -1.0),
        "m": Share(-1.0, -1.0), ",": Share(-1.0, 0.0), ".": Share(-1.0, 1.0), " ": RELEASED,
        "\x1b[A": Share(1.0, 0.0), "\x1b[B": Share(-1.0, 0.0),
        "\x1b[D": Share(0.0, 1.0), "\x1b[C": Share(0.0, -1.0),
    }
)  # fmt: skip
"""Keys as of ROS 2's teleop_twist_keyboard, and the arrow keys."""
KEY = re.compile(r"\x1b(?:\[M.{3}|\[[0-?]*[ -/]*[@-~]|O.)|.", re.DOTALL)
"""One key, or a whole sequence that a terminal sends, as of the mouse or of a key with Shift."""
QUIT = frozenset({"q", "\x03", "\x04"})
FIRST_KEY_SECONDS = 0.6
"""Time for which a first press counts [s]: a terminal repeats a held key after about half a second."""
KEY_SECONDS = 0.15
"""Time for which a repeated press counts [s]."""
DEAD_ZONE = 0.1
"""Deflection of a stick that counts as none."""
MIN_TWIST_SHARE = 1e-3
"""Share of the greatest speed up to which a Twist's counts as none: rounding, or noise of a stick."""
TWIST_SECONDS = 0.3
"""Time for which a Twist message counts [s]."""
REVERSAL_SHARE = 0.1
"""Change from one Twist to the next that counts, as a share of the greatest speed or turn rate."""
MAX_REVERSALS = 8
"""Most such changes back and forth within `REVERSAL_SECONDS`; a hand makes six, two nodes at 5 Hz ten."""
REVERSAL_SECONDS = 1.0
EVENT = struct.Struct("<IhBB")
"""An event of a Linux joystick: time [ms], value, type, number."""
BUTTON, AXIS, INITIAL = 0x01, 0x02, 0x80
FORWARD_AXIS, TURN_AXIS, DEAD_MAN_BUTTON = 1, 0, 4
"""Left stick and left shoulder button of a usual gamepad."""
MAX_AXIS = 32767.0


class Keys:
    """Keys of a terminal, which tells presses and not releases: a press counts for a moment."""

    def __init__(self) -> None:
        self.quits = False
        """Whether the driver wants to end."""
        self._wanted, self._until, self._pressed = RELEASED, -math.inf, ""

    def press(self, text: str, now: float) -> None:
        """Take what the terminal sent at `now` [s, monotonic]: one or more keys."""
        for key in KEY.findall(text):
            if key in QUIT:
                self.quits, self._wanted = True, RELEASED
            elif key in KEYS:
                repeated = key == self._pressed and now < self._until
                self._wanted, self._pressed = KEYS[key], key
                self._until = now + (KEY_SECONDS if repeated else FIRST_KEY_SECONDS)
            else:
                self._wanted = RELEASED  # any other key stops

    def velocity(self, now: float) -> Share:
        """Return the newest key's share while it counts at `now` [s, monotonic]."""
        return self._wanted if now < self._until and not self.quits else RELEASED


class Gamepad:
    """A gamepad: the left stick counts while its dead-man button is held."""

    def __init__(self) -> None:
        self.failed = False
        self._axes: dict[int, float] = {}
        self._held = False

    def events(self, data: bytes) -> None:
        """Take whole events as the device gives them."""
        for _, value, flags, number in EVENT.iter_unpack(data[: len(data) // EVENT.size * EVENT.size]):
            initial, kind = bool(flags & INITIAL), flags & ~INITIAL
            if kind == AXIS:
                self._axes[number] = clip(value / MAX_AXIS, 1.0)
            elif kind == BUTTON and number == DEAD_MAN_BUTTON:
                self._held = value == 1 and not initial  # held since before: press it anew

    def velocity(self, now: float) -> Share | None:  # noqa: ARG002
        """Return the stick's share; none without the button."""
        if self.failed:
            return None
        if not self._held:
            return RELEASED
        forward, turn = (_without_dead_zone(self._axes.get(axis, 0.0)) for axis in (FORWARD_AXIS, TURN_AXIS))
        return Share(-forward, -turn)

    def read(self, file: int) -> None:
        """Read from the open, non-blocking device; a failed read ends the drive."""
        try:
            while data := os.read(file, 64 * EVENT.size):
                self.events(data)
            self.failed = True
        except BlockingIOError:
            return
        except OSError:
            self.failed = True


def _without_dead_zone(value: float) -> float:
    if abs(value) <= DEAD_ZONE:
        return 0.0
    return math.copysign((abs(value) - DEAD_ZONE) / (1.0 - DEAD_ZONE), value)


class Twists:
    """Twist messages of a ROS topic."""

    def __init__(self, speed: float, turn_rate: float) -> None:
        """`speed` [m/s] and `turn_rate` [rad/s] are the greatest."""
        self._speed, self._turn_rate = speed, turn_rate
        self._newest, self._until = RELEASED, -math.inf
        self._change = RELEASED
        self._reversals: deque[float] = deque(maxlen=MAX_REVERSALS + 1)

    def add(self, forward: float, turn_rate: float, arrived: float) -> None:
        """Take a message that arrived then [s, monotonic]: its speeds [m/s; rad/s]."""
        shares = (clip(forward / self._speed, 1.0), clip(turn_rate / self._turn_rate, 1.0))
        share = Share(*(one if abs(one) > MIN_TWIST_SHARE else 0.0 for one in shares))
        change = Share(share.forward - self._newest.forward, share.turn - self._newest.turn)
        if max(map(abs, change)) > REVERSAL_SHARE:
            if change.forward * self._change.forward + change.turn * self._change.turn < 0.0:
                self._reversals.append(arrived)
            self._change = change
        self._newest, self._until = share, arrived + TWIST_SECONDS

    @property
    def contradict(self) -> bool:
        """Whether messages change back and forth faster than a hand, as those of two nodes do."""
        times = self._reversals
        return len(times) > MAX_REVERSALS and times[-1] - times[0] <= REVERSAL_SECONDS

    def velocity(self, now: float) -> Share:
        """Return the newest message's share while it counts at `now` [s, monotonic]."""
        return self._newest if now < self._until else RELEASED
