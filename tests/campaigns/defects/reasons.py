"""Why some defects are not found, as it is supposed from the source: removing two at once would show it."""

from __future__ import annotations

from collections.abc import Mapping

SECOND = "another safeguard has the same effect: "
REASONS: Mapping[str, str] = {
    "beat-binds-no-vote": "a standby that receives enough robots to run for the lead learns of its leader",
    "lateness-unchecked": f"{SECOND}positions that are as late look frozen at first",
    "speed-not-clipped": f"{SECOND}every command of a law is cut to the limits",
    "closing-beyond-top-speed": "robots come to their slots as well, and the brake keeps them apart",
    "trust-reversed": "neighbours that are off their slots become unavailable, and count no more",
}
"""By name of the defect, as far as it was looked into."""
