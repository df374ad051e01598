"""Whom a follower minds in a simulation, and what the collision filter makes of them; bodies that touch.

Like `formation.simulation.loop`, one number at a time, for `formation.simulation.compiled`. M is how many
robots all followers mind together.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from formation.arrays import ComplexArray
from formation.avoidance import LAG, Manners, heading_doubt
from formation.detour import Avoidance, avoid
from formation.law import Limits
from formation.mission import Mission
from formation.neighbour import FRESH_PERIODS, Track, learned, longest_way, unknown
from formation.plane import unit
from formation.simulation.links import TRACK, Link, arrived, carried
from formation.unicycle import Command, control_point

MIND = np.dtype(
    [
        ("head", "i8"), ("radius", "f8"), ("offset", "f8"), ("first", "b1"),
        ("late", "f8"), ("limit", "f8"), ("longest_way", "f8"), ("top_speed", "f8"),
    ],
    align=True,
)  # fmt: skip
"""Who is minded: index among followers, its body, whether it has right of way, `Link`."""
OBSTACLE = np.dtype(
    [
        ("at", "c16"),
        ("radius", "f8"),
        ("velocity", "c16"),
        ("first", "b1"),
        ("stands", "b1"),
        ("doubt", "f8"),
        ("age", "f8"),
        ("unsure", "f8"),
    ],
    align=True,
)
"""`formation.avoidance.Obstacle`."""


class Minds(NamedTuple):
    """Who minds whom; arrays of records."""

    avoids: bool
    """Whether anybody gets out of anybody's way."""
    watches: bool
    """Whether it is looked who touches whom: not where the mission has collisions off."""
    margin: float
    """[m]"""
    blind: float
    """The same while a robot does not know its heading [m]."""
    lag: float
    """[s]"""
    delay: float
    """That the mission expects [s]."""
    whom: Any
    """Records of `MIND`, robot by robot; shape (M,)."""
    tracks: Any
    """`links.TRACK` of each one's centre; shape (M,), or (R, M) of all runs."""
    said: Any
    """Centres that all published lately, in a ring [m; world frame]; shape (K, F), or (R, K, F)."""
    around: Any
    """Room for the obstacles of one robot, records of `OBSTACLE`."""
    order: Any
    """Followers from west to east, as they were at the last look; shape (F,), or (R, F)."""


def minds_of(all_runs: Minds, run: int) -> Minds:
    """What belongs to one run."""
    avoids, watches, margin, blind, lag, delay, whom, tracks, said, around, order = all_runs
    return Minds(avoids, watches, margin, blind, lag, delay, whom, tracks[run], said[run], around, order[run])


def minds_in(
    mission: Mission,
    measurement: str | None,
    late: float,
    shape: tuple[int, ...],
    starts: ComplexArray,
    *,
    avoids: bool,
) -> Minds:
    """Who minds whom in a mission; nobody where nobody `avoids`.

    `measurement` is how all measure, by default as the mission says; `late` the age of what is heard [s];
    `shape` (R, K, N) that of a ring of what all say, `starts` (R, F) where they begin [m; world frame].
    """
    minded = [(name, other) for name in mission.followers for other in mission.minded(name)] if avoids else []
    whom = np.zeros(len(minded), MIND)
    for m, (name, other) in enumerate(minded):
        spec, local = mission.robots[other], (measurement or mission.robots[name].measurement) == "local"
        whom[m] = (
            *(mission.followers.index(other), spec.radius, spec.control_point_offset),
            mission.has_right_of_way(other, name),
            *(0.0 if local else late, FRESH_PERIODS / spec.rate, longest_way(spec.rate), spec.top_speed),
        )
    runs, moments, robots = shape
    tracks = np.zeros((runs, len(whom)), TRACK)
    tracks["stamp"] = -np.inf
    said = np.zeros((runs, moments, robots - 1 if minded else 0), dtype=np.complex128)
    around, rules = np.zeros(robots, OBSTACLE), mission.collisions
    order, watches = np.argsort(starts.real, axis=1), rules.mode != "off"
    return Minds(
        len(minded) > 0,
        *(watches, rules.room, rules.blind, rules.lag, rules.delay),
        *(whom, tracks, said, around, order),
    )


def look(run: Any, i: int, robots: Any, minds: Minds, oldest: int, now: float, world: Any, draw: Any) -> int:
    """Fill `minds.around` with those whom robot i minds; how many they are."""
    me, robot = run[i], robots[i]
    doubt = 0.0 if robot.local else heading_doubt(me.way, world.course_gain, world.noise)
    count = 0
    for m in range(robot.minds, robot.minds_end):
        whom, track, known = minds.whom[m], minds.tracks[m], minds.around[count]
        link = Link(whom.late, whom.limit, whom.longest_way)
        elapsed = now - whom.late - track.stamp
        if robot.local or not (world.loss > 0.0 and draw.random() < world.loss and now > 0.0):
            sample = minds.said[oldest, whom.head]
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
            since = unknown(age, minds.delay, whom.top_speed, newest.point - me.odometry, there - me.odometry)
            known.at = unit(me.course).conjugate() * (there - me.odometry)
            known.radius = whom.radius + since.nearer
            known.velocity = unit(me.course).conjugate() * newest.velocity
            known.age, known.unsure = since.age, since.aside
        known.first = whom.first
        known.doubt = doubt
        count += 1
    return count


def keep_clear(
    me: Any, robot: Any, wanted: Command, minds: Minds, count: int, along: complex, world: Any
) -> Command:
    """What the filter makes of what the law wants."""
    manners = Manners(robot.radius, minds.margin, robot.hold + LAG * minds.lag, minds.blind)
    limits = Limits(robot.offset, robot.max_speed, robot.max_turn_rate)
    before = Avoidance(me.kept, me.detour, me.deadlocks, me.went, me.again, me.side, me.slow)
    done, after = avoid(wanted, minds.around[:count], manners, limits, along, before, world.step)
    me.kept, me.detour, me.deadlocks, me.went, me.again, me.side, me.slow = after
    return done


def clearance(run: Any, robots: Any, order: Any, least: float) -> float:
    """Least distance between two bodies of one run [m], negative where they touch; `least` if that is less.

    `order` is put in order again. Only who is near enough from west to east is looked at.
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
            if near > 0.0 and squared < near * near:  # roots are for the few that are
                least = math.sqrt(squared) - radii
            m -= 1
    return least
