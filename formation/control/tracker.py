"""Position and velocity of a neighbour between its samples; not in the paper.

No velocity is communicated. It is the low-passed difference of successive positions, and extrapolates a
sample of age τ to h + v̂ τ. Without that every hop of the graph lags by v τ, and no integral can see it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from formation.control.plane import clip, shorten

FRESH_PERIODS = 3.0
"""A neighbour that has been silent for more than this many of its periods is stale."""
MAX_DELAY = 0.5
"""Longest plausible delay of a sample; a longer one, by its stamp, is rather a wrong clock [s]."""
FORGETTING_SILENCE = 1.0
"""Silence after which earlier samples are ignored [s]."""


EXTRAPOLATION_ERROR_SHARE = 0.5
"""Possible error of an extrapolated position, as a share of the robot's top speed."""


class Track(NamedTuple):
    """A neighbour's control point and velocity."""

    stamp: float
    """When it was there [s]."""
    point: complex
    """Control point [m; world frame]."""
    velocity: complex
    """Estimated velocity [m/s; world frame]."""


def longest_delay(rate: float) -> float:
    """Longest plausible delay of samples published at `rate` [Hz] [s]."""
    return max(MAX_DELAY, FRESH_PERIODS / rate)


def believed_delay(delay: float, longest: float) -> float:
    """Delay that is assumed for a sample [s] with the delay `delay` [s] by its stamp.

    All of it up to `longest`, then less and less, none from twice as long on, and none for a stamp from
    the future. So it never changes by more than the stamps do, nor by more than `longest`: neither uneven
    delays nor a clock that is set make a neighbour jump.
    """
    return max(0.0, min(delay, 2.0 * longest - delay))


def first_seen(stamp: float, point: complex) -> Track:
    """A track from its first sample: assumed to stand still until a second sample arrives."""
    return Track(stamp, point, 0j)


def seen(track: Track, stamp: float, point: complex, time_constant: float, max_speed: float) -> Track:
    """The track with one more sample, later than the last.

    `time_constant` [s] is the velocity's low pass; a single difference is cut to `max_speed` [m/s], so
    that a jump of position does not give a high velocity.
    """
    elapsed = stamp - track.stamp
    return moved(track, stamp, point, learned(elapsed, time_constant), max_speed)


def learned(elapsed: float, time_constant: float) -> float:
    """Share of a change that the low pass adopts in `elapsed` [s], from 0 to 1."""
    return -math.expm1(-elapsed / time_constant)


def moved(track: Track, stamp: float, point: complex, share: float, max_speed: float) -> Track:
    """`seen` with a known `share` of the low pass: it is equal for equal intervals."""
    difference = shorten((point - track.point) * (1.0 / (stamp - track.stamp)), max_speed)
    return Track(stamp, point, track.velocity + share * (difference - track.velocity))


def carried_to(track: Track, moment: float, longest: float) -> complex:
    """Control point at `moment` [s], extrapolated by at most `longest` [s] either way.

    Backwards too: a neighbour's sample may be a little younger than the measurement it is compared with.
    """
    return track.point + track.velocity * clip(moment - track.stamp, longest)


def uncertain(age: float, top_speed: float) -> float:
    """Possible error of a position extrapolated by `age` [s] [m]."""
    return EXTRAPOLATION_ERROR_SHARE * top_speed * min(age, MAX_DELAY)


class Unknown(NamedTuple):
    """Possible motion of another robot since its last sample; not in the paper."""

    age: float
    """Time for which its own brake bounds its motion [s]."""
    aside: float
    """Possible sideways error of its extrapolated position [m]."""
    nearer: float
    """Possible approach [m]."""


def unknown(age: float, expected: float, top_speed: float, last: complex, carried: complex) -> Unknown:
    """Possible motion of a robot of `top_speed` [m/s] since it was measured at `last`, `age` [s] ago.

    `carried` is its extrapolated position; both are relative to this robot [m]. Up to the `expected` age
    [s] it may have stopped, or moved sideways; a greater age enlarges its body.
    """
    known = min(age, expected)
    aside = uncertain(known, top_speed)
    stopped = max(0.0, abs(carried) - abs(last)) * (known / age if age > 0.0 else 0.0)
    return Unknown(known, aside, uncertain(age, top_speed) - aside + stopped)


def somewhere(last: complex, carried: complex, unsure: float) -> tuple[complex, float]:
    """Disc in which a silent robot may be: centre and radius [m], with both ends of its path in it.

    It may have stood still at `last`, or have moved to `carried`, plus or minus `unsure` [m].
    """
    return 0.5 * (last + carried), max(unsure, 0.5 * abs(carried - last))
