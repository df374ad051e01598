"""The moving body of a simulated robot, as the code that publishes its messages sees it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from formation.control.unicycle import Command


class Disturbed(NamedTuple):
    """How the sensors of a robot are disturbed; the defaults are of good ones."""

    late: float = 0.0
    """How late its odometry and external pose are reported [s]."""
    restamped: float = 0.0
    """By how much their stamps are later than the measurements [s]."""
    pauses: bool = False
    """Whether they are not reported."""
    stuck: frozenset[str] = frozenset()
    """Sensors of its surroundings that repeat what they measured, of ``relative`` and ``scan``."""


class Moving(Protocol):
    """The moving body of a robot: a `Plant`, or a model with mass and wheels."""

    @property
    def position(self) -> complex:
        """True centre [m; world frame]."""

    @property
    def heading(self) -> complex:
        """True heading, unit complex [world frame]."""

    @property
    def moving(self) -> Command:
        """Forward speed and turn rate as odometry reports them."""

    @property
    def command(self) -> Command:
        """Its present command."""

    @property
    def disturbed(self) -> Disturbed:
        """How its sensors are disturbed now."""

    def obey(self, command: Command) -> None:
        """Follow `command` as the firmware rounds and limits it."""

    def go_to(self, time: float) -> None:
        """Simulate until `time` [s, monotonic]."""

    def odometry(self) -> tuple[complex, complex]:
        """Centre [m] and heading as this robot measures them [its own frame]; each call is a new sample."""

    def seen(self) -> tuple[complex, complex]:
        """Centre [m] and heading as a camera above sees them [world frame]; each call is a new sample."""

    def reset_odometry(self) -> None:
        """Restart odometry at the present pose, as a TurtleBot3's `reset_odometry` does."""

    def cast(self, at: complex, heading: complex, beams: int, farthest: float) -> Sequence[float] | None:
        """Ranges of the beams of a scanner on this robot [m], or None if its surroundings are unknown.

        The scanner is at `at` [m] and faces `heading` [unit complex; both robot's frame].
        """
