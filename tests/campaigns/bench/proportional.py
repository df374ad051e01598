"""The laws beside which ours are measured: proportional leader-follower control, after the Robotarium's.

After the public simulator of the Robotarium (robotarium_python_simulator 2.0: `leader_follower.py`,
`transformations.py`), read and written anew. A follower goes like a single integrator towards where its
neighbours want it, no faster than three quarters of its top speed; a mapping makes that a unicycle's command.

| there | here | why |
|---|---|---|
| distances to keep, by a potential | displacements to keep | the formations here are made of displacements |
| gain 10 | `gains.k_p` | displacements have another scale; the benchmarks take the best of a range |
| pose from cameras above the field | the field law's observer | the same inputs for all laws |
| barrier certificates | none | robots in these simulations do not collide |

No integral, no feed-forward, no memory: behind a leader at speed v an edge keeps an error of about v / gain.
Arithmetic and `formation.control.plane` only, so that scalars and arrays take the same path.
"""

from __future__ import annotations

from typing import Any

from formation.control.controller import Controller, Gains, Limits, Measured
from formation.control.observer import INNOVATION
from formation.control.plane import angle_between, clip, shorten
from formation.control.unicycle import Command, saturate

SHARE = 0.75
"""Of the top speed, what a follower is asked for at most."""
FORWARD = 0.8
"""Forward speed for each m/s in the direction of travel."""
TURN = 2.0
"""Turn rate for each radian between heading and wanted velocity [1/s]: π rad/s at a right angle."""


def turning(
    integral: Any, heading: Any, measured: Measured, gains: Gains, limits: Limits, _dt: float
) -> tuple[Command, Any]:
    """Turn towards the wanted velocity and drive what of it lies ahead: `create_si_to_uni_dynamics`."""
    wanted = gains.k_p * (measured.relative - heading.conjugate() * measured.desired)
    wanted = shorten(wanted, SHARE * limits.max_speed)
    turn_rate = TURN * angle_between(1.0 + 0.0j, wanted)
    speed = clip(FORWARD * wanted.real, limits.max_speed)
    return Command(speed, clip(turn_rate, limits.max_turn_rate)), integral


def near_identity(
    integral: Any, heading: Any, measured: Measured, gains: Gains, limits: Limits, _dt: float
) -> tuple[Command, Any]:
    """Give the control point the wanted velocity exactly: `create_si_to_uni_mapping`."""
    wanted = gains.k_p * (measured.relative - heading.conjugate() * measured.desired)
    wanted = shorten(wanted, SHARE * limits.max_speed)
    return saturate(wanted, limits.offset, limits.max_speed, limits.max_turn_rate), integral


TURNING = Controller("turning", turning, INNOVATION, integral=False, ramp=False)
NEAR_IDENTITY = Controller("near_identity", near_identity, INNOVATION, integral=False, ramp=False)
