"""What moves for a simulated robot, as those see it who say on the wire what it does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from formation.unicycle import Command


class Moving(Protocol):
    """What moves for a robot: a `Plant`, or something with mass and wheels."""

    @property
    def position(self) -> complex:
        """True centre [m; world frame]."""

    @property
    def heading(self) -> complex:
        """True heading, unit complex [world frame]."""

    @property
    def moving(self) -> Command:
        """Forward speed and turn rate as odometry tells them."""

    @property
    def command(self) -> Command:
        """What it strives for."""

    def obey(self, command: Command) -> None:
        """Strive for what the firmware makes of `command`."""

    def go_to(self, time: float) -> None:
        """Live up to `time` [s, monotonic]."""

    def odometry(self) -> tuple[complex, complex]:
        """Centre [m] and heading as this robot measures them [its own frame]; each call is a new sample."""

    def seen(self) -> tuple[complex, complex]:
        """Centre [m] and heading as a camera above sees them [world frame]; each call is a new sample."""

    def reset_odometry(self) -> None:
        """Have odometry count from here, as a TurtleBot3's `reset_odometry` does."""

    def cast(self, at: complex, heading: complex, beams: int, farthest: float) -> Sequence[float] | None:
        """How far the beams of a scanner on this robot go [m], or None if it knows nothing of what is around.

        The scanner is at `at` [m] and looks to `heading` [unit complex; both robot's frame].
        """
