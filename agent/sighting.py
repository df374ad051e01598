"""What one message says about where its robot is, whatever kind of message it was."""

from __future__ import annotations

from typing import NamedTuple

from formation.heading import Travel


class Sighting(NamedTuple):
    """A robot's place, and how it came there from the place before."""

    position: complex
    """Centre [m; world frame]."""
    heading: complex
    """As it was measured, unit [world frame]."""
    travel: Travel | None
    """Since the message before; None for the first."""
    jumped: str | None = None
    """What the robot cannot have done since then, in words."""
    turned: complex = 1.0 + 0.0j
    """By how much it has turned where `jumped` says that `travel` does not tell it; unit."""
