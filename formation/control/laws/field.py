"""The law that robots drive with: feed-forward, anti-windup and an integral band around Eq. (7).

Not in the paper.
"""

from __future__ import annotations

from formation.control.controller import Controller, Gains, Limits, Measured, error, near, nominal
from formation.control.observer import INNOVATION
from formation.control.unicycle import Command, body_velocity, saturate


def field(
    integral: complex, heading: complex, measured: Measured, gains: Gains, limits: Limits, dt: float
) -> tuple[Command, complex]:
    """Eq. (7) with the neighbours' velocity fed forward; integrates near formation only.

    The neighbours' velocity replaces most of the paper's integral. The rest (a wheel slightly too large, a
    velocity slightly wrong) is small, so integration is useful only near formation: its weight falls
    smoothly from 1 to 0 around `integral_band`, and where it is 0 the integral decays. At zero error the
    weight is exactly 1, so the equilibrium is the paper's.
    """
    e = error(heading, measured)
    wanted = nominal(integral, heading, measured, gains) + heading.conjugate() * measured.velocity
    command = saturate(wanted, limits.offset, limits.max_speed, limits.max_turn_rate)
    cut_off = heading * (body_velocity(command.speed, command.turn_rate, limits.offset) - wanted)
    weight = near(abs(e) / measured.count, gains.integral_band)
    growth = weight * (e + gains.anti_windup * cut_off)
    forgotten = min(dt * gains.integral_decay, 1.0)  # at most all of it, however long dt
    return command, integral + dt * growth - (1.0 - weight) * forgotten * integral


CONTROLLER = Controller("field", field, INNOVATION)
