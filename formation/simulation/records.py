"""Robots and edges in the loop of a simulation: arrays of records."""

from __future__ import annotations

import numpy as np

ROBOT = np.dtype(
    [
        ("offset", "f8"), ("max_speed", "f8"), ("max_turn_rate", "f8"),
        ("speed_step", "f8"), ("speed_most", "f8"), ("turn_rate_step", "f8"), ("turn_rate_most", "f8"),
        ("first", "i8"), ("last", "i8"),
        ("local", "b1"),
        ("radius", "f8"), ("hold", "f8"), ("avoided", "i8"), ("avoided_end", "i8"),
        ("ramp_time", "f8"), ("ramp_longest", "f8"), ("ramp_gap", "f8"), ("ramp_gentle", "f8"),
    ],
    align=True,
)  # fmt: skip
"""Constants of a follower: limits, `Grid` of both numbers, its edges, whether it has a sensor of its own;
its body, the longest time that a command may last, indices of its obstacles; `RampLimits`."""
EDGE = np.dtype(
    [
        ("head", "i8"), ("desired", "c16"),
        ("late", "f8"), ("limit", "f8"), ("longest_delay", "f8"), ("top_speed", "f8"),
    ],
    align=True,
)  # fmt: skip
"""An edge: index of the neighbour, z*_ij [m; world frame], `Link`."""
FOLLOWER = np.dtype(
    [
        ("position", "c16"), ("heading", "c16"),
        ("odometry", "c16"), ("estimate", "c16"), ("facing", "c16"), ("integral", "c16"),
        ("speed", "f8"), ("turn_rate", "f8"), ("wanted_speed", "f8"), ("wanted_turn_rate", "f8"),
        ("wheel_speed", "f8"), ("wheel_turn_rate", "f8"), ("owed_speed", "f8"), ("owed_turn_rate", "f8"),
        ("ramped_speed", "f8"), ("ramped_turn_rate", "f8"), ("commanded", "f8"), ("gentle_until", "f8"),
        ("drift", "c16"),
        ("course", "c16"), ("travelled", "f8"), ("kept", "f8"), ("detour", "f8"),
        ("deadlocks", "i8"), ("went", "c16"), ("again", "f8"), ("side", "f8"), ("slow", "f8"),
    ],
    align=True,
)  # fmt: skip
"""State of a follower: pose without noise; its measurements and estimates; mean motion over the last step,
the command, the wheels at its end, remainder of the quantiser; `Ramp`; direction of its odometry's drift,
a share of the path; the filter's own estimate of the heading, its path length, `Avoidance`."""
