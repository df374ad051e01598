r"""Does the path that a camera sees turn to the side that was commanded? Without a heading, without a clock.

Where a camera's frame is mirrored (y downwards, as in an image), or the robot's motors are swapped, a robot
that observes its heading turns away from where it wants to go, ever faster. The displacements s that the
camera sees are those that were commanded, m, in a frame of their own: s = c m, or mirrored: s = c conj(m),
with an unknown rotation c. So of

    A = |Σ s conj(m)| / Σ |m|²        B = |Σ s m| / Σ |m|²

A is about 1 where all is well, and B where the path is mirrored; both are on a straight path. Noise, delays
and slip make both smaller. Sums fade with the path, as slip turns the frame of the commands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from formation.control.observer import Travel
from formation.control.plane import rotation, unit
from formation.protocol.reasons import Code, Reason

FADING_DISTANCE = 0.5
"""Path after which an interval counts for 1/e [m]."""
MIN_PATH = 0.25
"""Path from which on it is judged [m]."""
MIN_MIRRORED, MAX_ALIKE = 0.85, 0.25
"""The path is mirrored if B is at least this, and A at most that.

Looser limits take paths for mirrored in which a third of the turns is lost.
"""


@dataclass(slots=True, kw_only=True)
class MirrorState:
    """Sums over the path."""

    facing: complex = 1.0 + 0.0j
    """Heading by the commands, unit [frame of the first]."""
    alike: complex = 0j
    """Σ s conj(m) [m²]."""
    mirrored: complex = 0j
    """Σ s m [m²]."""
    squares: float = 0.0
    """Σ |m|² [m²]."""
    path: float = 0.0
    """Path since the sums began [m]."""
    found: bool = False
    """Whether the path was mirrored."""


class MirrorCheck:
    """Compares the path of one robot with its commands."""

    def __init__(self) -> None:
        self.state = MirrorState()

    @property
    def doubt(self) -> Reason | None:
        """Why positions are not believed, until `trust`; None if they are."""
        return Reason(Code.PATH_MIRRORED) if self.state.found else None

    def trust(self) -> None:
        """Believe positions again: an order holds the robot."""
        if self.state.found:
            self.interrupt()
            self.state.found = False

    def interrupt(self) -> None:
        """Begin anew: the robot's motion is unknown."""
        state = self.state
        state.alike, state.mirrored, state.squares, state.path = 0j, 0j, 0.0, 0.0

    def add(self, travel: Travel) -> None:
        """Add an interval; `travel` has the commanded path and turn, and the seen displacement."""
        state, half, path = self.state, rotation(0.5 * travel.turn), abs(travel.distance)
        commanded = travel.distance * half * state.facing
        state.facing = unit(half * half * state.facing)
        kept = math.exp(-path / FADING_DISTANCE)
        state.alike = kept * state.alike + travel.displacement * commanded.conjugate()
        state.mirrored = kept * state.mirrored + travel.displacement * commanded
        state.squares = kept * state.squares + path * path
        state.path += path
        if state.path >= MIN_PATH:
            mirrored = abs(state.mirrored) >= MIN_MIRRORED * state.squares
            state.found = state.found or (mirrored and abs(state.alike) <= MAX_ALIKE * state.squares)
