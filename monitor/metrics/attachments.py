"""The attachments of a follower's positions: publisher id, and whether it follows.

One comes with every position, so it is fully decoded only if it looks unlike the one before.
"""

from __future__ import annotations

from formation.protocol import order
from formation.protocol.order import PositionAttachment

UNAVAILABLE = b'"unavailable":true'
"""As `formation.protocol.order.encode` writes it; left out if false."""
MAX_PUBLISHER_IDS = 16
"""Number of publisher ids that are remembered."""


class PositionAttachments:
    """What one robot's position attachments contain."""

    def __init__(self) -> None:
        self.unavailable = False
        """Whether it is unavailable: it does not follow, or not closely yet."""
        self.publishers = 0
        """Number of publishers so far; each start is another."""
        self._looks: tuple[bytes, bool] | None = None
        self._known: dict[str, None] = {}

    def process_attachment(self, attachment: bytes) -> None:
        """Take in one attachment. Raises BadMessage."""
        looks = attachment.partition(b",")[0], UNAVAILABLE in attachment
        if looks == self._looks:
            return
        decoded = order.decode(PositionAttachment, attachment)
        self._looks, self.unavailable = looks, decoded.unavailable
        if decoded.publisher_id in self._known:
            return
        self.publishers += 1
        self._known[decoded.publisher_id] = None
        if len(self._known) > MAX_PUBLISHER_IDS:
            self._known.pop(next(iter(self._known)))
