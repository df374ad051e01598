"""What the loop of a simulation knows of robots and edges: arrays of records."""

from __future__ import annotations

import numpy as np

ROBOT = np.dtype(
    [
        ("offset", "f8"), ("max_speed", "f8"), ("max_turn_rate", "f8"),
        ("speed_step", "f8"), ("speed_most", "f8"), ("turn_rate_step", "f8"), ("turn_rate_most", "f8"),
        ("first", "i8"), ("last", "i8"),
        ("local", "b1"),
        ("radius", "f8"), ("hold", "f8"), ("minds", "i8"), ("minds_end", "i8"),
    ],
    align=True,
)  # fmt: skip
"""What a follower is: limits, `Grid` of both numbers, its edges, whether it has a sensor of its own;
its body, the longest that a command may last, whom it minds."""
EDGE = np.dtype(
    [
        ("head", "i8"), ("desired", "c16"),
        ("late", "f8"), ("limit", "f8"), ("longest_way", "f8"), ("top_speed", "f8"),
    ],
    align=True,
)  # fmt: skip
"""What an edge is: index of the neighbour, z*_ij [m; world frame], `Link`."""
FOLLOWER = np.dtype(
    [
        ("position", "c16"), ("heading", "c16"),
        ("odometry", "c16"), ("estimate", "c16"), ("facing", "c16"), ("integral", "c16"),
        ("speed", "f8"), ("turn_rate", "f8"), ("wanted_speed", "f8"), ("wanted_turn_rate", "f8"),
        ("wheel_speed", "f8"), ("wheel_turn_rate", "f8"), ("owed_speed", "f8"), ("owed_turn_rate", "f8"),
        ("drift", "c16"),
        ("course", "c16"), ("way", "f8"), ("kept", "f8"), ("detour", "f8"),
        ("deadlocks", "i8"), ("went", "c16"), ("again", "f8"), ("side", "f8"), ("slow", "f8"),
    ],
    align=True,
)  # fmt: skip
"""How a follower is: pose without noise; what it measured and makes of it; mean motion over the last step,
what the law wants, the wheels at its end, what the quantiser owes; where its odometry drifts to, a share of
the way; the filter's own estimate of the heading, how far it went, `Avoidance`."""
