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

CONE_SHARE = 0.9
"""How far the wanted velocity may turn away from c, of what the turn rate can hold sideways [–]."""
BACKWARD_SHARE = 0.8
"""Share of |c| by which a robot that cannot reverse in formation may fall back [–]."""
BRAKING_SHARE = 0.5
"""Share of the ramp's acceleration that an approach uses [–]."""
REVERSE_LEVERS, REVERSE_TURNS = 2.5, 0.5
"""A robot reverses to a slot further behind it than so many control-point offsets, and so many radii of its
tightest turn at top speed [–]."""
REVERSE_SHARE = 0.9
"""Share of the directions behind for which reversing is proved to bring it nearer [–]."""


def field(
    integral: complex, heading: complex, measured: Measured, gains: Gains, limits: Limits, _dt: float
) -> tuple[Command, complex]:
    """u_r + i L ω_r = c + s q/|q|, with s = k |q| as far as the robot can drive that."""
    to_body = heading.conjugate()
    away = to_body * error(heading, measured)
    carried = to_body * measured.velocity
    wanted = intercept(away, carried, gains.k_p, limits)
    if _reverses(away, carried, limits):
        wanted = wanted.conjugate()
    return saturate(wanted, limits.offset, limits.max_speed, limits.max_turn_rate), integral


def intercept(away: complex, carried: complex, gain: float, limits: Limits) -> complex:
    """w = c + s q/|q| [m/s]: `away` q [m] is closed at k |q|, or as fast as the robot meets its moving slot.

    |w| is at most u_max. If the slot moves faster than the robot can move sideways, L ω_max, w stays in a
    cone around c, in which the robot can hold formation at any heading that it turns through.
    """
    distance, speed = abs(away), abs(carried)
    if distance <= MIN_LENGTH:
        return carried
    towards = away * (1.0 / distance)
    along = carried.real * towards.real + carried.imag * towards.imag
    room = limits.max_speed * limits.max_speed - speed * speed + along * along
    closing = min(stoppable(distance, gain, limits), max(0.0, math.sqrt(max(0.0, room)) - along))
    sideways = CONE_SHARE * limits.offset * limits.max_turn_rate
    if speed > sideways:
        sine = sideways / speed
        cosine = math.sqrt(1.0 - sine * sine)
        ahead = along / speed
        across = abs(carried.real * towards.imag - carried.imag * towards.real) / speed
        leaving = across * cosine - ahead * sine
        if closing * leaving > sideways:
            closing = sideways / leaving
        if -closing * ahead > BACKWARD_SHARE * speed:
            closing = BACKWARD_SHARE * speed / -ahead
    return carried + closing * towards


def stoppable(distance: float, gain: float, limits: Limits) -> float:
    """Speed [m/s] at which a slot `distance` [m] away is approached: k |q|, or what the ramp can stop."""
    braking = BRAKING_SHARE * limits.acceleration
    linear = braking / (gain * gain)
    if distance <= linear:
        return gain * distance
    return math.sqrt(2.0 * braking * (distance - 0.5 * linear))


def _reverses(away: complex, carried: complex, limits: Limits) -> bool:
    """Whether the robot had better reverse to its slot than turn round.

    Then it turns the other way, because its back is to point there. With |y| <= m |x| the distance still
    falls if m √(1 + m²) (L ω_max + |c|) < u_max - |c|.
    """
    far = max(REVERSE_LEVERS * limits.offset, REVERSE_TURNS * limits.max_speed / limits.max_turn_rate)
    speed, sideways = abs(carried), limits.offset * limits.max_turn_rate
    if away.real > -far or speed >= min(sideways, limits.max_speed):
        return False
    ratio = REVERSE_SHARE * (limits.max_speed - speed) / (sideways + speed)
    slope = 0.5 * (math.sqrt(1.0 + 4.0 * ratio * ratio) - 1.0)  # m²
    return away.imag * away.imag < slope * away.real * away.real


CONTROLLER = Controller("field", field, INNOVATION, integral=False, mean=True)
