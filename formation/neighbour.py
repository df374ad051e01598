"""A neighbour between its samples: where it is by now, and how fast it goes; not in the paper.

No velocity is communicated. It is the low-passed difference of successive positions, and it carries a sample
of age τ forward to h + v̂ τ. Without that every hop of the graph lags by v τ, and no integral can see it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from formation.plane import Reals, Vectors, clip, shorten

FRESH_PERIODS = 3.0
"""A neighbour that has been silent for more than this many of its periods is stale."""
FORGOTTEN = 1.0
"""After so long a silence what came before says nothing about what comes now [s]."""


class Track(NamedTuple):
    """What is known of a neighbour's control point; scalars or arrays of one shape."""

    stamp: Any
    """When it was there [s]."""
    point: Any
    """Control point [m; world frame]."""
    velocity: Any
    """Estimated velocity [m/s; world frame]."""


def first_seen(stamp: Reals, point: Vectors) -> Track:
    """A track from its first sample: taken to stand still until a second sample says otherwise."""
    return Track(stamp, point, 0.0 * point)


def seen(track: Track, stamp: Reals, point: Vectors, time_constant: float, max_speed: Reals) -> Track:
    """The track with one more sample, later than the last.

    `time_constant` [s] is the velocity's low pass; a single difference is cut to `max_speed` [m/s], so that
    a jump of position is not taken for a sprint.
    """
    elapsed = stamp - track.stamp
    difference = shorten((point - track.point) / elapsed, max_speed)
    share = -np.expm1(-elapsed / time_constant)
    return Track(stamp, point, track.velocity + share * (difference - track.velocity))


def carried_to(track: Track, moment: Reals, longest: Reals) -> Any:
    """Control point at `moment` [s], carried over at most `longest` [s] either way.

    Backwards too: a neighbour's sample may be a little younger than the measurement it is compared with.
    """
    return track.point + track.velocity * clip(moment - track.stamp, longest)
