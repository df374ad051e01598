"""What a follower knows of others in a simulation: its neighbours' samples, robots to avoid, and contacts.

Samples are late, lost, or measured by a sensor. Freshness and ages follow the agent's rules: a neighbour is
followed while its newest sample arrived within the limit, a sample is extrapolated by its age as far as its
delay is believed, and after a long silence the velocity is estimated afresh.

Like `formation.simulation.closed_loop`, one number at a time, for `formation.simulation.compiled`. M is
the number of (follower, avoided robot) pairs.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from formation.control.arrays import ComplexArray
from formation.control.avoidance import heading_doubt
from formation.control.plane import unit
from formation.control.tracker import (
    FORGETTING_SILENCE,
    FRESH_PERIODS,
    Track,
    believed_delay,
    learned,
    longest_delay,
    moved,
    unknown,
)
from formation.control.unicycle import control_point
from formation.mission.model import Mission

TRACK = np.dtype([("stamp", "f8"), ("point", "c16"), ("velocity", "c16")], align=True)
"""`Track` of a neighbour."""
_ROUNDING = 1e-9
"""[s]"""
AVOIDED = np.dtype(
    [
        ("head", "i8"), ("radius", "f8"), ("offset", "f8"), ("first", "b1"),
        ("late", "f8"), ("limit", "f8"), ("longest_delay", "f8"), ("top_speed", "f8"),
    ],
    align=True,
)  # fmt: skip
"""An avoided robot: index among followers, its body, whether it has right of way, `Link`."""
OBSTACLE = np.dtype(
    [
        ("at", "c16"), ("radius", "f8"), ("velocity", "c16"), ("first", "b1"), ("stands", "b1"),
        ("doubt", "f8"), ("age", "f8"), ("unsure", "f8"),
    ],
    align=True,
)  # fmt: skip
"""`formation.control.avoidance.Obstacle`."""


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


class Avoided(NamedTuple):
    """Which robots avoid which; arrays of records."""

    avoids: bool
    """Whether any robot avoids another."""
    watches: bool
    """Whether contacts are detected: not if the mission has collisions off."""
    margin: float
    """[m]"""
    blind: float
    """The same while a robot does not know its heading [m]."""
    delay: float
    """Delay that the mission expects [s]."""
    whom: Any
    """Records of `AVOIDED`, robot by robot; shape (M,)."""
    tracks: Any
    """`links.TRACK` of each one's centre; shape (M,), or (R, M) of all runs."""
    published: Any
    """Recently published centres, in a ring [m; world frame]; shape (K, F), or (R, K, F)."""
    around: Any
    """Buffer for the obstacles of one robot, records of `OBSTACLE`."""
    order: Any
    """Followers from west to east, as of the last check; shape (F,), or (R, F)."""


def avoided_of(all_runs: Avoided, run: int) -> Avoided:
    """Return the part of one run."""
    avoids, watches, margin, blind, delay, whom, tracks, published, around, order = all_runs
    return Avoided(
        avoids, watches, margin, blind, delay, whom, tracks[run], published[run], around, order[run]
    )


def avoided_in(
    mission: Mission,
    measurement: str | None,
    late: float,
    shape: tuple[int, ...],
    starts: ComplexArray,
    *,
    avoids: bool,
) -> Avoided:
    """Return which robots avoid which in a mission; none if not `avoids`.

    `measurement` is how all measure, by default as the mission says; `late` the age of received data [s];
    `shape` (R, K, N) that of a ring of what all publish, `starts` (R, F) the initial positions [m; world
    frame].
    """
    pairs = (
        [(name, other) for name in mission.followers for other in mission.avoided_by(name)] if avoids else []
    )
    whom = np.zeros(len(pairs), AVOIDED)
    for m, (name, other) in enumerate(pairs):
        spec, local = mission.robots[other], (measurement or mission.robots[name].measurement) == "local"
        whom[m] = (
            *(mission.followers.index(other), spec.radius, spec.control_point_offset),
            mission.has_right_of_way(other, name),
            *(0.0 if local else late, FRESH_PERIODS / spec.rate, longest_delay(spec.rate), spec.top_speed),
        )
    runs, moments, robots = shape
    tracks = np.zeros((runs, len(whom)), TRACK)
    tracks["stamp"] = -np.inf
    published = np.zeros((runs, moments, robots - 1 if pairs else 0), dtype=np.complex128)
    around, rules = np.zeros(robots, OBSTACLE), mission.collisions
    order, watches = np.argsort(starts.real, axis=1), rules.mode != "off"
    return Avoided(
        len(pairs) > 0,
        *(watches, rules.room, rules.blind, rules.delay),
        *(whom, tracks, published, around, order),
    )


def look(
    run: Any, i: int, robots: Any, avoided: Avoided, oldest: int, now: float, world: Any, draw: Any
) -> int:
    """Fill `avoided.around` with the obstacles of robot i; return their number."""
    me, robot = run[i], robots[i]
    doubt = 0.0 if robot.local else heading_doubt(me.travelled, world.course_gain, world.noise)
    count = 0
    for m in range(robot.avoided, robot.avoided_end):
        whom, track, known = avoided.whom[m], avoided.tracks[m], avoided.around[count]
        link = Link(whom.late, whom.limit, whom.longest_delay)
        elapsed = now - whom.late - track.stamp
        if robot.local or not (world.loss > 0.0 and draw.random() < world.loss and now > 0.0):
            sample = avoided.published[oldest, whom.head]
            if robot.local:
                there = run[whom.head]
                sample = control_point(there.position, there.heading, whom.offset)
            share = learned(elapsed, world.time_constant) if world.time_constant > 0.0 else 0.0
            newest = arrived(
                Track(track.stamp, track.point, track.velocity),
                now - whom.late,
                sample,
                share,
                whom.top_speed,
            )
            track.stamp, track.point, track.velocity = newest.stamp, newest.point, newest.velocity
        newest = Track(track.stamp, track.point, track.velocity)
        if robot.local:
            known.at = me.heading.conjugate() * (newest.point - me.position)
            known.radius = whom.radius + whom.offset
            known.velocity = me.heading.conjugate() * newest.velocity
        else:
            age, there = now - track.stamp, carried(newest, now, link)
            since = unknown(
                age, avoided.delay, whom.top_speed, newest.point - me.believed, there - me.believed
            )
            known.at = unit(me.course).conjugate() * (there - me.believed)
            known.radius = whom.radius + since.nearer
            known.velocity = unit(me.course).conjugate() * newest.velocity
            known.age, known.unsure = since.age, since.aside
        known.first = whom.first
        known.doubt = doubt
        count += 1
    return count


def clearance(run: Any, robots: Any, order: Any, least: float) -> float:
    """Least distance between two bodies of one run [m], negative if they touch; `least` if that is less.

    `order` is sorted again. Only pairs that are near enough from west to east are checked.
    """
    widest = 0.0
    for k in range(len(order)):
        i = order[k]
        widest = max(widest, robots[i].radius)
        m = k
        while m > 0 and run[order[m - 1]].position.real > run[i].position.real:
            order[m] = order[m - 1]
            m -= 1
        order[m] = i
    for k in range(len(order)):
        here, radius = run[order[k]].position, robots[order[k]].radius
        m = k - 1
        while m >= 0 and here.real - run[order[m]].position.real < least + radius + widest:
            away, radii = here - run[order[m]].position, radius + robots[order[m]].radius
            squared, near = away.real * away.real + away.imag * away.imag, least + radii
            if near > 0.0 and squared < near * near:  # compute roots only for the few near pairs
                least = math.sqrt(squared) - radii
            m -= 1
    return least
