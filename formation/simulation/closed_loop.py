"""The closed loop of many robots, one number at a time; `formation.simulation.compiled` compiles it.

Shapes: R runs, N robots (leader first), F = N-1 followers, E edges of the graph. Every run is a separate
world. In one step each follower publishes its position, then each receives its neighbours' and applies the
law, then all move and estimate their headings from their motion. Robots and links are records of arrays,
which have attributes and are changed in place.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from formation.control.avoidance import Avoidance, AvoidanceParameters, course_gain
from formation.control.controller import Gains, Limits, Measured
from formation.control.laws.field import field as law  # or whichever law this is compiled with
from formation.control.observer import Travel, innovation
from formation.control.observer import innovation as observe  # or the observer that this is compiled with
from formation.control.pipeline import ControlParams, ControlState, Inputs, at_rest, control_step, unprotected
from formation.control.plane import unit
from formation.control.pose_filter import ODOMETRY_NOISE, Spread, filtered
from formation.control.quantiser import Grid, Quantiser
from formation.control.ramp import Ramp, RampLimits
from formation.control.tracker import Track, learned
from formation.control.trust import FULL_TRUST, GREATEST_WEIGHT, believed, mean, trust, weighted
from formation.control.unicycle import AT_REST, Command, along, control_point, driven
from formation.simulation.body import Body, obeyed
from formation.simulation.neighbours import (
    Avoided,
    Link,
    arrived,
    avoided_of,
    carried,
    clearance,
    is_fresh,
    look,
)


class World(NamedTuple):
    """Constants of all runs."""

    step: float
    """[s]"""
    gains: Gains
    body: Body
    observer_gain: float
    """[1/m]"""
    course_gain: float
    """Initial gain of the filter's own observer; 0 if no robot avoids others [1/m]."""
    noise: float
    """Noise of positions that the mission expects [m]."""
    filters_pose: bool
    """Whether robots filter their poses."""
    least_noise: float
    """Least variance of positions for that [m²]."""
    normalised: bool
    """Whether ζ̂/|ζ̂| is used, or ζ̂ itself."""
    feed_forward: bool
    carries: bool
    """Whether samples are extrapolated to the present."""
    mean: bool
    """Whether the law takes the neighbours' weighted mean."""
    leader_speed: float
    """The leader's top speed [m/s]."""
    ordered_velocity: bool
    """Whether robots use the leader's velocity, as its orders say."""
    ordered_place: bool
    """Whether they use its place as well."""
    time_constant: float
    """Time constant of the neighbours' velocities [s]; 0 if they are not needed."""
    loss: float
    """Share of samples that never arrive."""
    settled: float
    """Formation error under which a run counts as settled [m]."""
    stride: int
    """Steps between stored moments of the error."""


class NeighbourSums(NamedTuple):
    """Data that a follower has received of its neighbours so far in one step."""

    relative: complex
    """Σ W z of displacements to the fresh ones [m; world frame, or body frame of a robot with a sensor]."""
    desired: complex
    """Σ W z of their desired displacements [m; world frame]."""
    velocity: complex
    """Σ w of their velocities [m/s; world frame]."""
    weights: float
    """Σ w."""
    skew: complex
    """Σ b [world frame]."""
    known: float
    """Number of neighbours in the sums."""
    elapsed: float
    """Time between the last two samples of the newest neighbour [s]; equal for all, unless some were lost."""
    share: float
    """`learned` of `elapsed`."""


NO_NEIGHBOURS = NeighbourSums(0j, 0j, 0j, 0.0, 0j, 0.0, 0.0, 0.0)


def true_point(me: Any, robot: Any) -> complex:
    """A follower's control point [m; world frame]."""
    return control_point(me.position, me.heading, robot.offset)


def speak(me: Any, robot: Any, world: World) -> complex:
    """The control point that a follower publishes [m; world frame]."""
    me.facing = unit(me.estimate) if world.normalised else me.estimate
    return control_point(me.believed, me.facing, robot.offset)


def receive(
    received: NeighbourSums, me: Any, robot: Any, edge: Any, track: Any, sample: complex, there: complex,
    lost: bool,
    now: float, ordered: complex, world: World,
) -> NeighbourSums:  # fmt: skip
    """Add one neighbour to the sums; it is `there`, and a `sample` of it arrives, or is `lost`.

    A sensor measures it there, and its measurement is never lost. `ordered` is the leader's velocity [m/s;
    world frame].
    """
    point, seen = control_point(me.believed, me.facing, robot.offset), 0j
    if robot.local:
        seen = me.heading.conjugate() * (there - true_point(me, robot))
        sample, lost = point + me.facing * seen, False
    share, elapsed = received.share, now - edge.late - track.stamp
    if not lost:
        if world.time_constant > 0.0 and elapsed != received.elapsed:
            share = learned(elapsed, world.time_constant)
        last = Track(track.stamp, track.point, track.velocity)
        newest = arrived(last, now - edge.late, sample, share, edge.top_speed)
        track.stamp, track.point, track.velocity = newest.stamp, newest.point, newest.velocity
    newest = Track(track.stamp, track.point, track.velocity)
    link = Link(edge.late, edge.limit, edge.longest_delay)
    if world.loss > 0.0 and not is_fresh(newest, now, link):
        return received
    if not robot.local:
        seen = (carried(newest, now, link) if world.carries else newest.point) - point
    one, turn = FULL_TRUST, me.facing.conjugate() if robot.local else 1.0 + 0.0j
    if world.mean and world.ordered_velocity:
        one = trust(newest.velocity - ordered, 0.0, edge.top_speed)
    elif world.mean:
        one = trust(newest.velocity, world.leader_speed, edge.top_speed)
    return NeighbourSums(
        received.relative + weighted(one.weight, turn * turn * one.skew, seen),
        received.desired + weighted(one.weight, one.skew, edge.desired),
        received.velocity + one.weight * newest.velocity,
        received.weights + one.weight,
        received.skew + one.skew,
        received.known + 1.0,
        elapsed,
        share,
    )


def params_of(robot: Any, avoided: Avoided) -> ControlParams:
    """The control pipeline's parameters for one robot, without protective zones: there are no scanners."""
    return ControlParams(
        law,
        Limits(robot.offset, robot.max_speed, robot.max_turn_rate, robot.acceleration, True),
        AvoidanceParameters(robot.radius, avoided.margin, robot.hold, avoided.blind, robot.lag),
        avoided.avoids,
        RampLimits(robot.ramp_time, robot.ramp_longest, robot.ramp_gap, robot.ramp_gentle),
        unprotected,
        Quantiser(
            Grid(robot.speed_step, robot.max_speed, robot.speed_most),
            Grid(robot.turn_rate_step, robot.max_turn_rate, robot.turn_rate_most),
        ),
    )


def state_of(me: Any) -> ControlState:
    """State of the control pipeline of one robot."""
    return ControlState(
        me.integral,
        Avoidance(me.kept, me.detour, me.deadlocks, me.went, me.side, me.slow),
        Ramp(Command(me.ramped_speed, me.ramped_turn_rate), me.commanded, me.gentle_until),
        Command(me.owed_speed, me.owed_turn_rate),
    )


def with_place(received: NeighbourSums, me: Any, robot: Any, place: complex) -> NeighbourSums:
    """Add the leader, at its ordered `place` [m; world frame], as one more neighbour to the sums."""
    away = place - control_point(me.believed, me.facing, robot.offset)
    if robot.local:
        away = me.facing.conjugate() * away
    return NeighbourSums(
        received.relative + GREATEST_WEIGHT * away,
        received.desired - GREATEST_WEIGHT * robot.slot,
        received.velocity,
        received.weights + GREATEST_WEIGHT,
        received.skew,
        received.known,
        received.elapsed,
        received.share,
    )


def decide(
    me: Any, robot: Any, received: NeighbourSums, avoided: Avoided, count: int, now: float, ordered: complex,
    world: World,
) -> None:  # fmt: skip
    """Run the control step, with `count` obstacles; without a neighbour to follow the robot rests."""
    state, command = state_of(me), AT_REST
    if received.known > 0.0:
        relative = received.relative if robot.local else me.facing.conjugate() * received.relative
        velocity = received.velocity * (1.0 / received.weights) if world.feed_forward else 0j
        measured = Measured(relative, received.desired, received.known, velocity)
        if world.mean:
            turn = me.facing.conjugate()
            relative = mean(received.weights, turn * turn * received.skew, relative)
            desired = mean(received.weights, received.skew, received.desired)
            velocity = ordered if world.ordered_velocity else believed(velocity, world.leader_speed)
            measured = Measured(relative, desired, 1.0, velocity)
        inputs = Inputs(now, world.step, me.facing, measured, world.gains, me.speed, None)
        state, outcome = control_step(state, inputs, avoided.around[:count], params_of(robot, avoided))
        command = outcome.command
    else:
        state = at_rest(state, now)
    me.integral = state.integral
    if count > 0:  # otherwise the filter has no memory
        me.kept, me.detour, me.deadlocks, me.went, me.side, me.slow = state.avoidance
    me.ramped_speed, me.ramped_turn_rate = state.ramp.before
    me.commanded, me.gentle_until = state.ramp.moment, state.ramp.gentle_until
    me.owed_speed, me.owed_turn_rate = state.remainder
    me.wanted_speed, me.wanted_turn_rate = command


def drive(me: Any, noise: complex, world: World) -> None:
    """Move the body as commanded; `noise` is the error of the next odometry [m; world frame]."""
    obeyed_command = obeyed(world.body, Command(me.wanted_speed, me.wanted_turn_rate))
    wheels = Command(me.wheel_speed, me.wheel_turn_rate)
    moving, wheels = driven(wheels, obeyed_command, world.body.lag, world.step)
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
        me.course = innovation(me.course, travel, course_gain(me.travelled, world.course_gain, world.noise))
        me.travelled += abs(distance)
    if not world.filters_pose:
        me.believed, me.estimate = me.odometry, observe(me.estimate, travel, world.observer_gain)
        return
    spread = Spread(
        me.position_variance, me.cross_variance, me.heading_variance, me.noise_variance, me.innovation
    )
    me.believed, me.estimate, spread = filtered(
        me.believed, me.estimate, spread, travel, me.odometry, world.step, world.least_noise, ODOMETRY_NOISE
    )
    (
        me.position_variance, me.cross_variance, me.heading_variance, me.noise_variance, me.innovation,
    ) = spread  # fmt: skip


def formation_error(run: Any, robots: Any, edges: Any, leader: complex) -> float:
    """Σ over edges of |z_ij - z*_ij| of one run [m], infinite if it has overflowed."""
    total = 0.0
    for i in range(len(robots)):
        point = true_point(run[i], robots[i])
        for e in range(robots[i].first, robots[i].last):
            j = edges[e].head - 1
            there = leader if j < 0 else true_point(run[j], robots[j])
            total += abs(there - point - edges[e].desired)
    return min(np.inf, total)


def run_on(
    begin: int, leader: Any, ordered: Any, world: World, robots: Any, edges: Any, run: Any, tracks: Any,
    published: Any,
    draw: Any, kept: Any, avoided: Avoided,
) -> tuple[int, float, float]:  # fmt: skip
    """Continue one run from step `begin`.

    `leader` is its position [m; world frame] at this and each next step, `ordered` its velocity [m/s; world
    frame] from then on. `run` and `tracks` are the run's
    followers and their data, shapes (F,) and (E,); `published` the recently published positions, in a ring of
    shape (K, N); `kept` receives the error every `World.stride` steps. Random numbers are drawn from
    `draw`.

    Returns the last step after which its error was not under the bound, or -1, the error at the end, and
    the least distance between two bodies [m], infinite if contacts are not detected.
    """
    nearest = clearance(run, robots, avoided.order, np.inf) if avoided.watches else np.inf
    last_out, ring = -1, len(published)
    error = formation_error(run, robots, edges, leader[0])
    for step in range(begin, begin + len(leader) - 1):
        now, here = step * world.step, leader[step - begin]
        newest, oldest = step % ring, max(step + 1 - ring, 0) % ring  # initially all have always been there
        published[newest, 0] = here
        for i in range(len(robots)):
            published[newest, i + 1] = speak(run[i], robots[i], world)
            if avoided.avoids:
                avoided.published[newest, i] = run[i].believed
        received = NO_NEIGHBOURS
        for i in range(len(robots)):
            me, robot, received = (
                run[i],
                robots[i],
                NeighbourSums(0j, 0j, 0j, 0.0, 0j, 0.0, received.elapsed, received.share),
            )
            for e in range(robot.first, robot.last):
                edge, j = edges[e], edges[e].head - 1
                there = here if j < 0 else true_point(run[j], robots[j])
                lost = world.loss > 0.0 and draw.random() < world.loss and step > 0
                received = receive(
                    received, me, robot, edge, tracks[e], published[oldest, j + 1], there, lost, now,
                    ordered[step - begin], world,
                )  # fmt: skip
            if world.ordered_place and received.known > 0.0:
                received = with_place(received, me, robot, here)
            count = look(run, i, robots, avoided, oldest, now, world, draw) if avoided.avoids else 0
            decide(me, robot, received, avoided, count, now, ordered[step - begin], world)
        for i in range(len(robots)):
            noise = 0j
            if world.body.position_noise > 0.0:
                noise = world.body.position_noise * complex(draw.normal(0.0, 1.0), draw.normal(0.0, 1.0))
            drive(run[i], noise, world)
        nearest = clearance(run, robots, avoided.order, nearest) if avoided.watches else nearest
        error = formation_error(run, robots, edges, leader[step - begin + 1])
        last_out = step + 1 if error >= world.settled else last_out
        if (step + 1) % world.stride == 0:
            kept[(step + 1) // world.stride] = error
    return last_out, error, nearest


def all_run_on(
    begin: int, leader: Any, ordered: Any, world: World, robots: Any, edges: Any, followers: Any, tracks: Any,
    published: Any,
    draw: Any, errors: Any, last_out: Any, error: Any, nearest: Any, avoided: Avoided,
) -> None:  # fmt: skip
    """Run `run_on` for every run in turn: the data of one stay in the processor's cache."""
    for r in range(len(followers)):
        out, error[r], room = run_on(
            begin, leader, ordered, world, robots, edges, followers[r], tracks[r], published[r], draw,
            errors[:, r], avoided_of(avoided, r),
        )  # fmt: skip
        last_out[r] = max(last_out[r], out)
        nearest[r] = min(nearest[r], room)
