"""What rides on a follower's positions: whose voice that is, and whether it follows.

It comes with every position, so it is read as a whole only where it looks unlike the one before.
"""

from __future__ import annotations

from formation import order
from formation.order import Told

ASIDE = b'"aside":true'
"""As `formation.order.encode` spells it; otherwise nothing is said of it."""
REMEMBERED = 16
"""Voices that are known again."""


class Riding:
    """What one robot's positions say beside where it is."""

    def __init__(self) -> None:
        self.aside = False
        """It says that it does not follow, or not closely yet."""
        self.voices = 0
        """How many processes have spoken for it; each start is another."""
        self._looks: tuple[bytes, bool] | None = None
        self._known: dict[str, None] = {}

    def take(self, attachment: bytes) -> None:
        """Learn from one. Raises BadMessage."""
        looks = attachment.partition(b",")[0], ASIDE in attachment
        if looks == self._looks:
            return
        told = order.decode(Told, attachment)
        self._looks, self.aside = looks, told.aside
        if told.voice in self._known:
            return
        self.voices += 1
        self._known[told.voice] = None
        if len(self._known) > REMEMBERED:
            self._known.pop(next(iter(self._known)))
