"""One control step of one robot: from its measurements to its command.

    law → collision filter → ramp → brake → protective zones → quantiser

Agents and simulation call the same functions (simulation compiles them, `formation.simulation.compiled`).
All are pure: state is an argument and a result. Each stage passes on a command within its limits
unchanged.

| stage | module | limits |
|---|---|---|
| law | `formation.control.laws` | to the limits of the body |
| collision filter | `formation.control.avoidance` | how fast obstacles come nearer |
| ramp | `formation.control.ramp` | the change from the command before |
| brake | `formation.control.avoidance` | again, after the ramp |
| protective zones | `formation.control.zones` | speed towards what a scanner sees |
| quantiser | `formation.control.quantiser` | to multiples of the robot's steps |
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from formation.control.avoidance import (
    Avoidance,
    AvoidanceParameters,
    Moving,
    Obstacle,
    avoid,
    brake,
    free_behind,
)
from formation.control.controller import Gains, Limits, Measured, Step
from formation.control.plane import clip
from formation.control.quantiser import Quantiser, quantise
from formation.control.ramp import STARTING, Ramp, RampLimits, ramped
from formation.control.unicycle import AT_REST, Command
from formation.control.zones import Sight, Zone, guarded

Protect = Callable[[Command, Any], tuple[Command, Zone | None]]
"""(command, sight) -> (command within the protective zones, their result)."""


class ControlParams(NamedTuple):
    """Constants of all control steps."""

    law: Step
    limits: Limits
    avoidance: AvoidanceParameters
    avoids: bool
    """Whether the collision filter changes commands, or only reports that it would."""
    ramp: RampLimits
    protect: Protect
    quantiser: Quantiser


class Inputs(NamedTuple):
    """Measurements at one moment."""

    now: float
    """[s]"""
    dt: float
    """Since the newest measurement before this one [s]."""
    heading: complex
    """Estimated heading, unit length [world frame]."""
    measured: Measured
    gains: Gains
    speed: float = 0.0
    """Mean forward speed since then [m/s]."""
    sight: Any = None
    """The scanner's data (`formation.control.zones.Sight`); None without one."""


class ControlState(NamedTuple):
    """State passed from one step to the next."""

    integral: complex = 0j
    """[m s; world frame]"""
    avoidance: Avoidance = Avoidance()
    ramp: Ramp = STARTING
    remainder: Command = AT_REST
    """Remainder of the quantiser."""


class Outcome(NamedTuple):
    """Result of one step."""

    command: Command
    """To send."""
    target: Command
    """Target of the ramp: the law's command after the collision filter."""
    filtered: bool
    """Whether the collision filter changed the command, or would have."""
    zone: Zone | None
    """Result of the protective zones; None without a scanner."""
    finite: bool
    """Whether the law's command and integral are finite numbers; if not, no other stage has run."""


def control_step(
    state: ControlState, inputs: Inputs, obstacles: Sequence[Obstacle], params: ControlParams
) -> tuple[ControlState, Outcome]:
    """Run one step: return the next state, and the command with its result.

    `obstacles` are those of the collision filter, none without one. They are no part of `inputs`: an array
    in a tuple costs compiled code as much as a law does.
    """
    limits = limits_among(obstacles, params) if params.avoids else params.limits
    wanted, integral, finite = law_command(state, inputs, params, limits)
    if not finite:
        after = ControlState(integral, state.avoidance, state.ramp, state.remainder)
        return after, Outcome(wanted, wanted, finite, None, finite)
    after, outcome = constrained(state, wanted, inputs, obstacles, params)
    return ControlState(integral, after.avoidance, after.ramp, after.remainder), outcome


def limits_among(obstacles: Sequence[Obstacle], params: ControlParams) -> Limits:
    """The body's limits; near an obstacle behind it the robot does not reverse far."""
    limits = params.limits
    return Limits(
        limits.offset,
        limits.max_speed,
        limits.max_turn_rate,
        limits.acceleration,
        free_behind(obstacles, params.avoidance, limits),
    )


def law_command(
    state: ControlState, inputs: Inputs, params: ControlParams, limits: Limits
) -> tuple[Command, complex, bool]:
    """The law's own command, its integral, and whether both are finite; the command is cut to `limits`."""
    wanted, integral = params.law(
        state.integral, inputs.heading, inputs.measured, inputs.gains, limits, inputs.dt
    )
    finite = (
        math.isfinite(wanted.speed)
        and math.isfinite(wanted.turn_rate)
        and math.isfinite(integral.real)
        and math.isfinite(integral.imag)
    )
    if finite:
        wanted = Command(clip(wanted.speed, limits.max_speed), clip(wanted.turn_rate, limits.max_turn_rate))
    return wanted, integral, finite


def constrained(
    state: ControlState, wanted: Command, inputs: Inputs, obstacles: Sequence[Obstacle], params: ControlParams
) -> tuple[ControlState, Outcome]:
    """Every stage after the law, for a `wanted` command within limits; the integral stays as it is."""
    limits, parameters = params.limits, params.avoidance
    along = inputs.heading.conjugate() * inputs.measured.velocity
    moving = moving_at(state, inputs)
    clear, avoidance = avoid(wanted, obstacles, parameters, limits, along, state.avoidance, inputs.dt, moving)
    after, outcome = _ramped_and_braked(state, clear if params.avoids else wanted, inputs, obstacles, params)
    after = ControlState(after.integral, avoidance, after.ramp, after.remainder)
    return after, Outcome(outcome.command, outcome.target, clear != wanted, outcome.zone, True)


def slowed(
    state: ControlState, wanted: Command, inputs: Inputs, obstacles: Sequence[Obstacle], params: ControlParams
) -> tuple[ControlState, Outcome]:
    """As `constrained`, but the filter only brakes: for a robot that may not evade."""
    clear = brake(wanted, obstacles, params.avoidance, moving_at(state, inputs))
    after, outcome = _ramped_and_braked(state, clear if params.avoids else wanted, inputs, obstacles, params)
    return after, outcome._replace(filtered=clear != wanted)


def moving_at(state: ControlState, inputs: Inputs) -> Moving:
    """Bounds of the robot's speed: between its mean since the last command, and that command."""
    mean, commanded = inputs.speed, state.ramp.before.speed
    return Moving(min(mean, commanded), max(mean, commanded))


def _ramped_and_braked(
    state: ControlState, target: Command, inputs: Inputs, obstacles: Sequence[Obstacle], params: ControlParams
) -> tuple[ControlState, Outcome]:
    """Ramp, brake, protective zones and quantiser, for a `target` command within limits."""
    command, gentle_until = ramped(state.ramp, target, inputs.now, params.limits, params.ramp)
    if params.avoids and command != target:  # the filter has braked the target itself
        command = brake(command, obstacles, params.avoidance, moving_at(state, inputs))
    command, zone = params.protect(command, inputs.sight)
    ramp = Ramp(command, inputs.now, gentle_until)
    command, remainder = quantised(command, state.remainder, params.quantiser)
    return (
        ControlState(state.integral, state.avoidance, ramp, remainder),
        Outcome(command, target, False, zone, True),
    )


def quantised(command: Command, remainder: Command, quantiser: Quantiser) -> tuple[Command, Command]:
    """Call `quantise` if the robot's commands have steps; else return the command unchanged."""
    if quantiser.speed.step > 0.0 or quantiser.turn_rate.step > 0.0:
        return quantise(quantiser, command, remainder)
    return command, remainder


def at_rest(state: ControlState, now: float) -> ControlState:
    """The state after zero velocity was sent at `now` [s]; integral and avoidance stay as they are."""
    return ControlState(state.integral, state.avoidance, Ramp(AT_REST, now, state.ramp.gentle_until), AT_REST)


def protected(command: Command, sight: Sight) -> tuple[Command, Zone | None]:
    """Apply the protective zones, for a robot with a scanner."""
    return guarded(command, sight.moving, sight.points, sight.body, sight.hold, sight.unseen)


def unprotected(command: Command, _sight: None) -> tuple[Command, Zone | None]:
    """Apply no protective zones, for a robot without a scanner."""
    return command, None
