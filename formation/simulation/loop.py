"""The closed loop of many robots, one number at a time: what `formation.simulation.compiled` makes fast.

Shapes: R runs, N robots (leader first), F = N-1 followers, E edges of the graph. Every run is a world of its
own. In one step each follower says where it is, then each hears its neighbours and applies the law, then all
move and estimate their headings from how they moved. Robots and links are records of arrays, which have
attributes and are changed in place.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from formation.avoidance import course_gain
from formation.heading import Travel, innovation, mended, printed
from formation.law import Gains, Limits, Measured, unwound
from formation.law import field as law  # or whichever law this is compiled with
from formation.neighbour import Track, learned
from formation.plane import unit
from formation.quantiser import Grid, Quantiser, quantise
from formation.simulation.body import Body, obeyed
from formation.simulation.links import Link, arrived, carried, is_fresh
from formation.simulation.minding import Minds, clearance, keep_clear, look, minds_of
from formation.unicycle import Command, along, control_point, driven

INNOVATION, MENDED, PRINTED = 0, 1, 2
"""Observers: the field law's; Eq. (3) with erratum 1 mended; Eq. (3) as printed."""


class World(NamedTuple):
    """What is the same for all and does not change."""

    step: float
    """[s]"""
    gains: Gains
    body: Body
    observer: int
    observer_gain: float
    """[1/m]"""
    course_gain: float
    """The same for the filter's own observer at first; 0 where nobody minds anybody [1/m]."""
    noise: float
    """That the mission expects of positions [m]."""
    normalised: bool
    """Whether ζ̂/|ζ̂| is used, or ζ̂ as it is."""
    feed_forward: bool
    carries: bool
    """Whether samples are carried forward to the present."""
    time_constant: float
    """Low pass of the neighbours' velocities [s]; 0 where nobody needs them."""
    loss: float
    """Share of samples that never arrive."""
    quantises: bool
    """Whether any robot cuts commands to steps."""
    settled: float
    """Formation error under which a run counts as settled [m]."""
    stride: int
    """Steps between moments of the error that is kept."""


class Heard(NamedTuple):
    """What a follower has heard of its neighbours so far in one step."""

    relative: complex
    """Σ of displacements to those who are fresh [m; world frame, or body frame of who has a sensor]."""
    desired: complex
    """Σ of what they should be [m; world frame]."""
    velocity: complex
    """Σ of their velocities [m/s; world frame]."""
    known: float
    """How many these are."""
    elapsed: float
    """Between the last two samples of who was heard last [s]; the same for all, unless some were lost, …"""
    share: float
    """… and `learned` of it."""


NOBODY = Heard(0j, 0j, 0j, 0.0, 0.0, 0.0)


def true_point(me: Any, robot: Any) -> complex:
    """A follower's control point [m; world frame]."""
    return control_point(me.position, me.heading, robot.offset)


def speak(me: Any, robot: Any, world: World) -> complex:
    """The control point that a follower publishes [m; world frame]."""
    me.facing = unit(me.estimate) if world.normalised else me.estimate
    return control_point(me.odometry, me.facing, robot.offset)


def hear(
    heard: Heard, me: Any, robot: Any, edge: Any, track: Any, sample: complex, there: complex, lost: bool,
    now: float, world: World,
) -> Heard:  # fmt: skip
    """Add one neighbour to what was heard of others; it is `there`, and a `sample` of it comes, or is `lost`.

    A robot with a sensor sees it there, and what it sees is never lost.
    """
    point, seen = control_point(me.odometry, me.facing, robot.offset), 0j
    if robot.local:
        seen = me.heading.conjugate() * (there - true_point(me, robot))
        sample, lost = point + me.facing * seen, False
    share, elapsed = heard.share, now - edge.late - track.stamp
    if not lost:
        if world.time_constant > 0.0 and elapsed != heard.elapsed:
            share = learned(elapsed, world.time_constant)
        last = Track(track.stamp, track.point, track.velocity)
        newest = arrived(last, now - edge.late, sample, share, edge.top_speed)
        track.stamp, track.point, track.velocity = newest.stamp, newest.point, newest.velocity
    newest = Track(track.stamp, track.point, track.velocity)
    link = Link(edge.late, edge.limit, edge.longest_way)
    if world.loss > 0.0 and not is_fresh(newest, now, link):
        return heard
    if not robot.local:
        seen = (carried(newest, now, link) if world.carries else newest.point) - point
    return Heard(
        heard.relative + seen,
        heard.desired + edge.desired,
        heard.velocity + newest.velocity,
        heard.known + 1.0,
        elapsed,
        share,
    )


def decide(me: Any, robot: Any, heard: Heard, minds: Minds, count: int, world: World) -> None:
    """Apply the law, minding `count` others; who has nobody to follow stands still, and learns nothing."""
    wanted = Command(0.0, 0.0)
    if heard.known > 0.0:
        relative = heard.relative if robot.local else me.facing.conjugate() * heard.relative
        velocity = heard.velocity * (1.0 / heard.known) if world.feed_forward else 0j
        measured = Measured(relative, heard.desired, heard.known, velocity)
        limits = Limits(robot.offset, robot.max_speed, robot.max_turn_rate)
        wanted, me.integral = law(me.integral, me.facing, measured, world.gains, limits, world.step)
        if count > 0:
            ahead, said = me.facing.conjugate() * velocity, wanted
            wanted = keep_clear(me, robot, said, minds, count, ahead, world)
            me.integral = unwound(
                me.integral, me.facing, measured, world.gains, limits, said, wanted, world.step
            )
    if world.quantises:
        quantiser = Quantiser(
            Grid(robot.speed_step, robot.max_speed, robot.speed_most),
            Grid(robot.turn_rate_step, robot.max_turn_rate, robot.turn_rate_most),
        )
        wanted, owed = quantise(quantiser, wanted, Command(me.owed_speed, me.owed_turn_rate))
        me.owed_speed, me.owed_turn_rate = owed
    me.wanted_speed, me.wanted_turn_rate = wanted


def drive(me: Any, noise: complex, world: World) -> None:
    """Do as is wanted, as the body can; `noise` is how far the next odometry is off [m; world frame]."""
    told = obeyed(world.body, Command(me.wanted_speed, me.wanted_turn_rate))
    wheels = Command(me.wheel_speed, me.wheel_turn_rate)
    moving, wheels = driven(wheels, told, world.body.lag, world.step)
    me.wheel_speed, me.wheel_turn_rate = wheels
    me.speed, me.turn_rate = moving
    distance, turn = moving.speed * world.step, moving.turn_rate * world.step
    position, heading = along(me.position, me.heading, distance, turn)
    if world.body.drift > 0.0:
        position += me.drift * abs(distance) * me.heading
    me.position, me.heading = position, heading
    travel = Travel(distance, turn, position + noise - me.odometry)
    me.odometry = position + noise
    if world.course_gain > 0.0:
        me.course = innovation(me.course, travel, course_gain(me.way, world.course_gain, world.noise))
        me.way += abs(distance)
    if world.observer == INNOVATION:
        me.estimate = innovation(me.estimate, travel, world.observer_gain)
    elif world.observer == MENDED:
        me.estimate = mended(me.estimate, travel, world.observer_gain)
    else:
        me.estimate = printed(me.estimate, travel, world.observer_gain)


def formation_error(run: Any, robots: Any, edges: Any, leader: complex) -> float:
    """Σ over edges of |z_ij - z*_ij| of one run [m], infinite where it has left the numbers."""
    total = 0.0
    for i in range(len(robots)):
        point = true_point(run[i], robots[i])
        for e in range(robots[i].first, robots[i].last):
            j = edges[e].head - 1
            there = leader if j < 0 else true_point(run[j], robots[j])
            total += abs(there - point - edges[e].desired)
    return min(np.inf, total)


def run_on(
    begin: int, leader: Any, world: World, robots: Any, edges: Any, run: Any, tracks: Any, said: Any,
    draw: Any, kept: Any, minds: Minds,
) -> tuple[int, float, float]:  # fmt: skip
    """Take one run from step `begin` on.

    `leader` is where that is [m; world frame] at this and each next step. `run` and `tracks` are the run's
    followers and what they know, shapes (F,) and (E,); `said` what all published lately, in a ring of shape
    (K, N); `kept` takes the error every `World.stride` steps. Random numbers are drawn from `draw`.

    Returns the last step after which its error was not under the bound, or -1, the error at the end, and
    how near two bodies came to each other [m], infinite where nobody looks.
    """
    nearest = clearance(run, robots, minds.order, np.inf) if minds.watches else np.inf
    last_out, ring = -1, len(said)
    error = formation_error(run, robots, edges, leader[0])
    for step in range(begin, begin + len(leader) - 1):
        now, here = step * world.step, leader[step - begin]
        newest, oldest = step % ring, max(step + 1 - ring, 0) % ring  # at first all have always stood there
        said[newest, 0] = here
        for i in range(len(robots)):
            said[newest, i + 1] = speak(run[i], robots[i], world)
            if minds.avoids:
                minds.said[newest, i] = run[i].odometry
        heard = NOBODY
        for i in range(len(robots)):
            me, robot, heard = run[i], robots[i], Heard(0j, 0j, 0j, 0.0, heard.elapsed, heard.share)
            for e in range(robot.first, robot.last):
                edge, j = edges[e], edges[e].head - 1
                there = here if j < 0 else true_point(run[j], robots[j])
                lost = world.loss > 0.0 and draw.random() < world.loss and step > 0
                heard = hear(heard, me, robot, edge, tracks[e], said[oldest, j + 1], there, lost, now, world)
            count = look(run, i, robots, minds, oldest, now, world, draw) if minds.avoids else 0
            decide(me, robot, heard, minds, count, world)
        for i in range(len(robots)):
            noise = 0j
            if world.body.position_noise > 0.0:
                noise = world.body.position_noise * complex(draw.normal(0.0, 1.0), draw.normal(0.0, 1.0))
            drive(run[i], noise, world)
        nearest = clearance(run, robots, minds.order, nearest) if minds.watches else nearest
        error = formation_error(run, robots, edges, leader[step - begin + 1])
        last_out = step + 1 if error >= world.settled else last_out
        if (step + 1) % world.stride == 0:
            kept[(step + 1) // world.stride] = error
    return last_out, error, nearest


def all_run_on(
    begin: int, leader: Any, world: World, robots: Any, edges: Any, followers: Any, tracks: Any, said: Any,
    draw: Any, errors: Any, last_out: Any, error: Any, nearest: Any, minds: Minds,
) -> None:  # fmt: skip
    """`run_on` of every run, one after the other: what belongs to one stays in the processor's cache."""
    for r in range(len(followers)):
        out, error[r], room = run_on(
            begin, leader, world, robots, edges, followers[r], tracks[r], said[r], draw, errors[:, r],
            minds_of(minds, r),
        )  # fmt: skip
        last_out[r] = max(last_out[r], out)
        nearest[r] = min(nearest[r], room)
