"""A neighbour between its samples: where it is by now, and how fast it goes; not in the paper.

No velocity is communicated. It is the low-passed difference of successive positions, and it carries a sample
of age τ forward to h + v̂ τ. Without that every hop of the graph lags by v τ, and no integral can see it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from formation.plane import clip, shorten

FRESH_PERIODS = 3.0
"""A neighbour that has been silent for more than this many of its periods is stale."""
LONGEST_WAY = 0.5
"""Bad air holds a sample up for so long; more, by its stamp, is rather a clock that is wrong [s]."""
FORGOTTEN = 1.0
"""After so long a silence what came before says nothing about what comes now [s]."""


UNSEEN = 0.5
"""Share of its top speed by which a robot may be elsewhere than where its velocity carries it."""


class Track(NamedTuple):
    """What is known of a neighbour's control point."""

    stamp: float
    """When it was there [s]."""
    point: complex
    """Control point [m; world frame]."""
    velocity: complex
    """Estimated velocity [m/s; world frame]."""


def longest_way(rate: float) -> float:
    """How long a sample of whoever speaks at `rate` [Hz] can well have been on the way [s]."""
    return max(LONGEST_WAY, FRESH_PERIODS / rate)


def believed_way(way: float, longest: float) -> float:
    """How long a sample is taken to have been on the way [s] that was so for `way` [s] by its stamp.

    All of that up to `longest`, then less and less, nothing from twice as long on, and nothing of a stamp
    from the future. So it never changes by more than the stamps do, nor by more than `longest`: neither
    uneven air nor a clock that is set makes a neighbour leap.
    """
    return max(0.0, min(way, 2.0 * longest - way))


def first_seen(stamp: float, point: complex) -> Track:
    """A track from its first sample: taken to stand still until a second sample says otherwise."""
    return Track(stamp, point, 0j)


def seen(track: Track, stamp: float, point: complex, time_constant: float, max_speed: float) -> Track:
    """The track with one more sample, later than the last.

    `time_constant` [s] is the velocity's low pass; a single difference is cut to `max_speed` [m/s], so that
    a jump of position is not taken for a sprint.
    """
    elapsed = stamp - track.stamp
    return moved(track, stamp, point, learned(elapsed, time_constant), max_speed)


def learned(elapsed: float, time_constant: float) -> float:
    """How much of a change the low pass takes over in `elapsed` [s], from 0 to 1."""
    return -math.expm1(-elapsed / time_constant)


def moved(track: Track, stamp: float, point: complex, share: float, max_speed: float) -> Track:
    """`seen` where the `share` that is learned is known already: it is the same for whoever is as late."""
    difference = shorten((point - track.point) * (1.0 / (stamp - track.stamp)), max_speed)
    return Track(stamp, point, track.velocity + share * (difference - track.velocity))


def carried_to(track: Track, moment: float, longest: float) -> complex:
    """Control point at `moment` [s], carried over at most `longest` [s] either way.

    Backwards too: a neighbour's sample may be a little younger than the measurement it is compared with.
    """
    return track.point + track.velocity * clip(moment - track.stamp, longest)


def uncertain(age: float, top_speed: float) -> float:
    """How far one last seen `age` [s] ago may be from where it is carried to [m]; so far also who is lost."""
    return UNSEEN * top_speed * min(age, LONGEST_WAY)


class Unknown(NamedTuple):
    """What another robot may have done since it was seen; not in the paper."""

    age: float
    """For so long its own brake bounds what it did [s]."""
    aside: float
    """How far aside of where it is carried to it may be [m]."""
    nearer: float
    """How much nearer it may be [m]."""


def unknown(age: float, expected: float, top_speed: float, last: complex, carried: complex) -> Unknown:
    """What a robot of `top_speed` [m/s] may have done since it was seen at `last`, `age` [s] ago.

    `carried` is where its velocity leads to; both are relative to the robot that asks [m]. Up to the age that
    is `expected` [s] it may have stopped, or gone aside; what is older makes its body count as larger.
    """
    known = min(age, expected)
    aside = uncertain(known, top_speed)
    stopped = max(0.0, abs(carried) - abs(last)) * (known / age if age > 0.0 else 0.0)
    return Unknown(known, aside, uncertain(age, top_speed) - aside + stopped)


def somewhere(last: complex, carried: complex, unsure: float) -> tuple[complex, float]:
    """Where whoever fell silent may be: middle and radius [m] of a disc with both ends of its way in it.

    It may have stood still where it was seen `last`, or have gone on to where it is `carried`, give or take
    `unsure` [m].
    """
    return 0.5 * (last + carried), max(unsure, 0.5 * abs(carried - last))
