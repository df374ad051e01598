"""What a follower hears of a neighbour in a simulation: samples late, lost, or measured on the spot.

Freshness and ages follow the agent's rules: a neighbour is followed while its newest sample arrived within
the limit, a sample is carried forward by its age as far as its way can be believed, and after a long silence
the velocity is learned anew.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from formation.neighbour import FORGOTTEN, Track, believed_way, moved

TRACK = np.dtype([("stamp", "f8"), ("point", "c16"), ("velocity", "c16")], align=True)
"""`Track` of a neighbour."""
_ROUNDING = 1e-9
"""[s]"""


class Link(NamedTuple):
    """How well one edge of the graph works."""

    late: float
    """Age of a sample when it is used [s]; 0 for what a sensor on the robot measures."""
    limit: float
    """Longest silence of a fresh neighbour [s]."""
    longest_way: float
    """How long a sample can well have been on the way [s]."""


def arrived(last: Track, stamp: float, sample: complex, share: float, top_speed: float) -> Track:
    """The track once one more sample has come: the first, if the last one is infinitely old.

    `share` is `formation.neighbour.learned`, 0 for no velocity; nobody is faster than `top_speed` [m/s].
    """
    if stamp - last.stamp > FORGOTTEN:
        return Track(stamp, sample, 0j)
    return moved(last, stamp, sample, share, top_speed)


def is_fresh(track: Track, now: float, link: Link) -> bool:
    """Whether the neighbour may be followed at `now` [s]."""
    return now - track.stamp - link.late <= link.limit + _ROUNDING


def carried(track: Track, now: float, link: Link) -> complex:
    """Where the neighbour's control point is by `now` [s], as far as its samples tell [m; world frame]."""
    silence = now - track.stamp - link.late
    return track.point + (silence + believed_way(link.late, link.longest_way)) * track.velocity
