"""Data that a follower receives of a neighbour in a simulation: late, lost, or measured by a sensor.

Freshness and ages follow the agent's rules: a neighbour is followed while its newest sample arrived within
the limit, a sample is extrapolated by its age as far as its delay is believed, and after a long silence
the velocity is estimated afresh.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from formation.control.tracker import FORGETTING_SILENCE, Track, believed_delay, moved

TRACK = np.dtype([("stamp", "f8"), ("point", "c16"), ("velocity", "c16")], align=True)
"""`Track` of a neighbour."""
_ROUNDING = 1e-9
"""[s]"""


class Link(NamedTuple):
    """Quality of one edge of the graph."""

    late: float
    """Age of a sample when it is used [s]; 0 for measurements of the robot's own sensor."""
    limit: float
    """Longest silence of a fresh neighbour [s]."""
    longest_delay: float
    """Longest plausible delay of a sample [s]."""


def arrived(last: Track, stamp: float, sample: complex, share: float, top_speed: float) -> Track:
    """The track after one more sample: the first, if the last one is infinitely old.

    `share` is `formation.control.tracker.learned`, 0 for no velocity; velocities are limited to
    `top_speed` [m/s].
    """
    if stamp - last.stamp > FORGETTING_SILENCE:
        return Track(stamp, sample, 0j)
    return moved(last, stamp, sample, share, top_speed)


def is_fresh(track: Track, now: float, link: Link) -> bool:
    """Whether the neighbour may be followed at `now` [s]."""
    return now - track.stamp - link.late <= link.limit + _ROUNDING


def carried(track: Track, now: float, link: Link) -> complex:
    """The neighbour's control point extrapolated to `now` [s] [m; world frame]."""
    silence = now - track.stamp - link.late
    return track.point + (silence + believed_delay(link.late, link.longest_delay)) * track.velocity
