"""A proportional law with the neighbours' mean velocity as feed-forward; not in the paper.

In formation that velocity is the leader's, so a steady leader leaves no error. Without an integral nothing
winds up, and a robot's bias (a wheel slightly too large) leaves an error of bias / (k_P d) at each of its
d neighbours.
"""

from __future__ import annotations

from formation.control.controller import Controller, Gains, Limits, Measured
from formation.control.observer import INNOVATION
from formation.control.unicycle import Command, saturate


def proportional(
    integral: complex, heading: complex, measured: Measured, gains: Gains, limits: Limits, _dt: float
) -> tuple[Command, complex]:
    """u_r + i L ω_r = k_P Σ_j (z_ij^(i) - ζ̂* z*_ij) + ζ̂* mean_j v̂_j, within limits; no integral."""
    to_body = heading.conjugate()
    wanted = gains.k_p * (measured.relative - to_body * measured.desired) + to_body * measured.velocity
    return saturate(wanted, limits.offset, limits.max_speed, limits.max_turn_rate), integral


CONTROLLER = Controller("proportional", proportional, INNOVATION, integral=False)
