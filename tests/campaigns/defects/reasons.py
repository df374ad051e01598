"""Why some defects are not found, as it is supposed from the source: removing two at once would show it."""

from __future__ import annotations

from collections.abc import Mapping

SECOND = "another safeguard has the same effect: "
REASONS: Mapping[str, str] = {
    "repeated-position-accepted": f"{SECOND}a count that falls is refused as a leap",
    "beat-binds-no-vote": f"{SECOND}votes are bound for longer than a lease lasts",
    "stops-file-not-atomic": "disks are in memory: a rehearsal writes no files",
    "nobody-yields": f"{SECOND}both brake, and evade",
    "lateness-unchecked": f"{SECOND}positions that are as late look frozen at first",
    "closing-beyond-top-speed": "robots come to their slots as well, and the brake keeps them apart",
    "trust-reversed": "neighbours that are off their slots become unavailable, and count no more",
}
"""By name of the defect, as far as it was looked into."""
