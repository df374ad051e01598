"""The moving body of a simulated robot: Eq. (1) behind wheels that lag, and odometry with small errors.

While the wheels change speed, time is divided into short steps on which speed and turn rate are replaced
by their exact means, and the pose moves along the resulting arc. Wheels without lag, or that have caught
up, move the pose along a single arc, which is exact.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np

from formation.control.unicycle import Command, advance, driven
from formation.simulation.body import Body, obeyed

MAX_STEP_TIME = 0.01
"""Longest step while the wheels change speed [s]; the pose's error falls with its square."""
MAX_TIME_CONSTANTS = 40.0
"""Number of time constants after which the rest of the lag is below the resolution of a float."""


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
    surroundings_late: Mapping[str, float] = MappingProxyType({})
    """How late those sensors report [s]; one that is not named is in time."""


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

    def cast(self, at: complex, heading: complex, beams: int, farthest: float) -> Sequence[float] | None:
        """Ranges of the beams of a scanner on this robot [m], or None if its surroundings are unknown.

        The scanner is at `at` [m] and faces `heading` [unit complex; both robot's frame].
        """


def measured(
    position: complex, heading: complex, body: Body, noise: np.random.Generator
) -> tuple[complex, complex]:
    """Return a position [m] and a heading with the noise of this body's sensors."""
    x, y, angle = noise.normal(size=3).tolist()
    return (
        position + body.position_noise * complex(x, y),
        heading * cmath.rect(1.0, body.heading_noise * angle),
    )


class Plant:
    """One robot's true motion and its odometry. It keeps its last command for ever."""

    def __init__(
        self,
        body: Body,
        position: complex,
        heading: complex,
        noise: np.random.Generator,
        *,
        counts_from_here: bool = False,
    ) -> None:
        """At rest, centre at `position` [m; world frame], with unit complex `heading` [world frame].

        Its odometry is in the world frame, or starts at zero here.
        """
        self.position = position
        """True centre [m; world frame]."""
        self.heading = heading
        """True heading, unit complex [world frame]."""
        self.moving = Command(0.0, 0.0)
        """True forward speed and turn rate."""
        self.command = Command(0.0, 0.0)
        """Command that the wheels follow."""
        self.path = 0.0
        """Length of the path so far [m]."""
        self._body = body
        self._noise = noise
        self._time: float | None = None
        # Odometry errs by a share of the path, in a direction of the world that is particular to this robot.
        self._drift = body.drift * cmath.rect(1.0, noise.uniform(-math.pi, math.pi))
        self._counts_from = (position, heading) if counts_from_here else (0j, 1.0 + 0.0j)

    def go_to(self, time: float) -> None:
        """Simulate until `time` [s, any clock], from the first such time on; time never runs backwards."""
        if self._time is None:
            self._time = time
        if time > self._time:
            self.advance(time - self._time)
            self._time = time

    @property
    def disturbed(self) -> Disturbed:
        """Return that its sensors are good."""
        return Disturbed()

    def obey(self, command: Command) -> None:
        """Follow `command` as the firmware rounds and limits it."""
        self.command = obeyed(self._body, command)

    def advance(self, elapsed: float) -> None:
        """Simulate `elapsed` [s]."""
        if elapsed <= 0.0:
            return
        changing = min(elapsed, MAX_TIME_CONSTANTS * self._body.lag) if self.moving != self.command else 0.0
        steps = math.ceil(changing / MAX_STEP_TIME)
        for _ in range(steps):
            mean, end = driven(self.moving, self.command, self._body.lag, changing / steps)
            self._go(mean, changing / steps)
            self.moving = end
        if elapsed > changing:
            self.moving = self.command
            self._go(self.command, elapsed - changing)

    def odometry(self) -> tuple[complex, complex]:
        """Centre [m] and heading as this robot measures them [its own frame]; each call is a new sample."""
        (position, heading), (origin, axis) = self._measured(self._believed), self._counts_from
        return (position - origin) * axis.conjugate(), heading * axis.conjugate()

    def seen(self) -> tuple[complex, complex]:
        """Centre [m] and heading as a camera above sees them [world frame]; each call is a new sample."""
        return self._measured(self.position)

    def cast(self, at: complex, heading: complex, beams: int, farthest: float) -> None:
        """Return None: the plant does not know its surroundings."""

    @property
    def _believed(self) -> complex:
        return self.position + self._drift * self.path

    def _measured(self, position: complex) -> tuple[complex, complex]:
        return measured(position, self.heading, self._body, self._noise)

    def _go(self, command: Command, elapsed: float) -> None:
        position, heading = advance(self.position, self.heading, *command, elapsed)
        self.position, self.heading = position, heading / abs(heading)
        self.path += abs(command.speed) * elapsed
