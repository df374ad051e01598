r"""The law that robots drive with: their neighbours' mean velocity, and a saturated share of the mean error.

Not in the paper. Eq. (8) cuts each body axis by itself: a robot that is far away then drives at full speed
before it points where it should, and drives past its slot. Here the wanted velocity is limited as a vector.

| symbol | here | meaning | unit |
|---|---|---|---|
| q | `away` | weighted mean of the neighbours' errors, body frame | m |
| c | `carried` | weighted mean of their velocities, body frame | m/s |
| k | `Gains.k_p` | gain | 1/s |
| w | `wanted` | velocity of the control point, c + s q/\|q\|, body frame | m/s |
"""

from __future__ import annotations

import math

from formation.control.controller import Controller, Gains, Limits, Measured, error
from formation.control.observer import INNOVATION
from formation.control.plane import MIN_LENGTH
from formation.control.unicycle import Command, saturate

CONE_SHARE = 2.0
"""How far the wanted velocity may turn away from c, of what the turn rate can hold sideways [–]: below 1 it
could be held at every heading, but slots that are hardly too fast would be approached slowly."""
BACKWARD_SHARE = 0.8
"""Share of |c| by which a robot that cannot reverse in formation may fall back [–]."""
BRAKING_SHARE = 0.7
"""Share of the ramp's acceleration, of speed and of turn rate, that an approach uses [–]."""
SIDEWAYS_BRAKING_SHARE = 0.5
"""Share of L times the ramp's angular acceleration that an approach from the side uses [–]: less than ahead,
because the heading that it leaves behind has to be turned back as well."""
REVERSE_LEVERS, REVERSE_TURNS = 2.5, 0.5
"""A robot reverses to a slot further behind it than so many control-point offsets, and so many radii of its
tightest turn at top speed [–]."""
REVERSE_SHARE = 1.0
"""Share of the directions behind for which reversing is proved to bring it nearer at high gains [–]."""


def field(
    integral: complex, heading: complex, measured: Measured, gains: Gains, limits: Limits, _dt: float
) -> tuple[Command, complex]:
    """u_r + i L ω_r = c + s q/|q|, with s = k |q| as far as the robot can drive that."""
    to_body = heading.conjugate()
    away = to_body * error(heading, measured)
    carried = to_body * measured.velocity
    distance, speed = abs(away), abs(carried)
    if distance <= MIN_LENGTH:
        return driven(carried, 1.0, limits), integral
    towards = away * (1.0 / distance)
    closing = stoppable(distance, gains.k_p, towards, limits)
    if closing + speed > limits.max_speed:
        closing = intercepting(towards, carried, closing, limits)
    if speed > CONE_SHARE * limits.offset * limits.max_turn_rate:
        closing = turning(towards, carried, closing, limits)
    wanted, ahead = carried + closing * towards, 1.0
    if away.real < -REVERSE_LEVERS * limits.offset and better_backwards(away, speed, limits):
        wanted, ahead = wanted.conjugate(), -1.0
    return driven(wanted, ahead, limits), integral


def stoppable(distance: float, gain: float, towards: complex, limits: Limits) -> float:
    """Speed s [m/s] at which a slot `distance` [m] away is approached: k |q|, or what the ramp can stop.

    Ahead the ramp changes s by its acceleration; to the side, where s is L ω, by L times its angular one.
    """
    share, across = BRAKING_SHARE, abs(towards.imag)
    sideways = SIDEWAYS_BRAKING_SHARE * limits.offset * limits.max_turn_rate / limits.max_speed
    if across * share > sideways:
        share = sideways / across
    closing, braking = gain * distance, share * limits.acceleration
    if gain * closing <= braking:
        return closing
    linear = braking / (gain * gain)
    return math.sqrt(2.0 * braking * (distance - 0.5 * linear))


def intercepting(towards: complex, carried: complex, closing: float, limits: Limits) -> float:
    """`closing` [m/s], or less, so that |w| is at most u_max: the robot then meets its moving slot."""
    along = carried.real * towards.real + carried.imag * towards.imag
    across = carried.real * towards.imag - carried.imag * towards.real
    room = limits.max_speed * limits.max_speed - across * across
    return max(0.0, min(closing, math.sqrt(max(0.0, room)) - along))


def turning(towards: complex, carried: complex, closing: float, limits: Limits) -> float:
    """`closing` [m/s], or less, so that w stays in a cone around c.

    A slot that moves faster than the robot can move sideways, L ω_max, is followed only by a robot that
    faces along c, and a robot that has turned away from c falls behind.
    """
    speed, sideways = abs(carried), CONE_SHARE * limits.offset * limits.max_turn_rate
    sine = min(1.0, sideways / speed)
    along = (carried.real * towards.real + carried.imag * towards.imag) / speed
    across = abs(carried.real * towards.imag - carried.imag * towards.real) / speed
    leaving = across * math.sqrt(1.0 - sine * sine) - along * sine
    if closing * leaving > sideways:
        closing = sideways / leaving
    if -closing * along > BACKWARD_SHARE * speed:
        closing = BACKWARD_SHARE * speed / -along
    return closing


def driven(wanted: complex, ahead: float, limits: Limits) -> Command:
    """The command for `wanted` [m/s; body frame], driven forwards (`ahead` = 1) or backwards (-1)."""
    turn_rate = limits.max_turn_rate
    if limits.acceleration < math.inf:
        turn_rate = stoppable_turn(math.atan2(abs(wanted.imag), ahead * wanted.real), limits)
    return saturate(wanted, limits.offset, limits.max_speed, turn_rate)


def stoppable_turn(angle: float, limits: Limits) -> float:
    """Greatest turn rate [rad/s] `angle` [rad] away from the wanted heading: what the ramp can stop there.

    Else a robot with a slow ramp and a short offset turns past the heading that it wants, and weaves.
    """
    turning_up = limits.acceleration * limits.max_turn_rate / limits.max_speed
    return min(limits.max_turn_rate, math.sqrt(2.0 * BRAKING_SHARE * turning_up * angle))


def better_backwards(away: complex, speed: float, limits: Limits) -> bool:
    """Whether the robot had better reverse to its slot than turn round; `speed` is |c| [m/s].

    Then it turns the other way, because its back is to point there. With |y| < m |x| the distance still
    falls if m √(1 + m²) (L ω_max + |c|) = u_max - |c| and s is at least u_max - |c| (Lemma 2 of
    docs/theory/convergence.md): at low gains it may not.
    """
    sideways = limits.offset * limits.max_turn_rate
    if not limits.reverses or speed >= min(sideways, limits.max_speed):
        return False
    if -away.real * limits.max_turn_rate < REVERSE_TURNS * limits.max_speed:
        return False
    ratio = REVERSE_SHARE * (limits.max_speed - speed) / (sideways + speed)
    slope = 0.5 * (math.sqrt(1.0 + 4.0 * ratio * ratio) - 1.0)  # m²
    return away.imag * away.imag < slope * away.real * away.real


CONTROLLER = Controller("field", field, INNOVATION, integral=False, mean=True)
