"""Statistics of a quantity and of a robot's commands while a recording is read."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from formation.mission.model import Mission
from formation.monitor.report.thin import Extremes, Size
from formation.ros2.messages import Twist, TwistStamped, decode
from formation.wire import BadMessage

SATURATED_SHARE = 0.995
"""Share of a limit from which a command counts as at its limit."""
MAX_LINE_GAP = 1.0
"""Longest silence across which a line is drawn [s]."""


@dataclass(frozen=True, slots=True)
class Measured:
    """RMS and maximum of one quantity: over the whole run, and since the formation has settled."""

    whole: Size
    after: Size | None
    """None if it has not settled."""
    final: float | None
    """The newest known value."""


class Robot(NamedTuple):
    """One follower over the run."""

    error: Measured
    """Σ over its neighbours of |z_ij - z*_ij| [m]."""
    heading: Measured
    """Estimated less true heading [rad]; empty without ground truth."""
    commands: int
    saturated: tuple[float | None, float | None]
    """Shares of its commands at the limit of the speed and of the turn rate; None without a command."""


class Judge:
    """Statistics of one quantity, before and after settling."""

    def __init__(self) -> None:
        self._whole, self._after = Size(), Size()
        self._final: float | None = None

    def add(self, value: float | None) -> None:
        """Take one value; None means unknown."""
        if value is not None:
            self._whole.add(value)
            self._after.add(value)
            self._final = value

    def restart(self) -> None:
        """Start the second half: from now on it may be settled for good."""
        self._after = Size()

    def measured(self, *, settled: bool) -> Measured:
        """Return the statistics; the second half only if it has `settled`."""
        return Measured(self._whole, self._after if settled else None, self._final)


class Commands:
    """Commands of one follower."""

    def __init__(self, mission: Mission, name: str) -> None:
        spec = mission.robots[name]
        self._stamped = spec.cmd_vel == "twist_stamped"
        self.curves = Extremes(2)
        self.count = 0
        self.saturated = [0, 0]
        self._limits = SATURATED_SHARE * spec.max_speed, SATURATED_SHARE * spec.max_turn_rate
        self._last = -math.inf

    def process_command(self, payload: bytes, wall: float) -> None:
        """Take one command that arrived at `wall` [s]."""
        try:
            command = decode(TwistStamped, payload) if self._stamped else decode(Twist, payload)
        except BadMessage:
            return
        values = command.speed, command.turn_rate
        self.count += 1
        for i in range(2):
            self.saturated[i] += abs(values[i]) >= self._limits[i]
        if wall - self._last > MAX_LINE_GAP and self.count > 1:
            self.curves.add(self._last, (math.nan, math.nan))
        self._last = wall
        self.curves.add(wall, values)

    def share(self, which: int) -> float | None:
        """Return the share of commands at the limit of speed (0) or turn rate (1); None without a command."""
        return self.saturated[which] / self.count if self.count else None
