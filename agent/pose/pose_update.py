"""The pose update that one message gives, whatever its type."""

from __future__ import annotations

from typing import NamedTuple

from formation.control.observer import Travel
from formation.protocol.reasons import Reason


class PoseUpdate(NamedTuple):
    """A robot's position, and its motion since the one before."""

    position: complex
    """Centre [m; world frame]."""
    heading: complex
    """As it was measured, unit [world frame]."""
    travel: Travel | None
    """Since the message before; None for the first."""
    jumped: Reason | None = None
    """The impossible motion since then."""
    turned: complex = 1.0 + 0.0j
    """Its turn, as a unit complex number, where `jumped` means that `travel` does not contain it."""
