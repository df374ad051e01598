"""The paper's law as printed, Eqs. (7)-(9): no feed-forward, no filter, no ramp.

A ramp or a filter would let its integral wind up further, because it does not know what they cut off.
"""

from __future__ import annotations

from formation.control.controller import Controller, Gains, Limits, Measured, error, nominal
from formation.control.observer import MENDED
from formation.control.unicycle import Command, saturate


def paper(
    integral: complex, heading: complex, measured: Measured, gains: Gains, limits: Limits, dt: float
) -> tuple[Command, complex]:
    """The law as printed, with z_ij read as the displacement of control points: Eqs. (7)-(9)."""
    command = saturate(
        nominal(integral, heading, measured, gains), limits.offset, limits.max_speed, limits.max_turn_rate
    )
    return command, integral + dt * error(heading, measured)


CONTROLLER = Controller(
    "paper",
    paper,
    MENDED,
    feed_forward=False,
    delay_compensation=False,
    collision_filter=False,
    ramp=False,
    pose_filter=False,
)
