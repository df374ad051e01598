"""The fixed list of plans that every defect meets, the quickest first."""

from __future__ import annotations

from collections.abc import Sequence

from tests.campaigns.defects.plan import Plan, Told

ORDERS = (
    Told(8.0, "shape", {"shape": "line"}),
    Told(16.0, "rotate", {"degrees": 90.0}),
    Told(26.0, "scale", {"factor": 1.3}),
    Told(34.0, "stop"),
    Told(37.0, "release"),
    Told(40.0, "run"),
    Told(44.0, "tune", {"k_p": 2.0, "k_i": 0.2}),
    Told(48.0, "speed", {"speed": 0.3, "degrees": 200.0}),
)
RESTS = (Told(6.0, "hold"), Told(8.0, "stop"), Told(10.0, "release"), Told(14.0, "run"))

QUIET = (
    Plan("turtlebot3_pair"),
    Plan("tracked"),
    Plan("measured"),
    Plan("swap"),
    Plan("fenced", seconds=25.0),
    Plan("trio", signed=True),
    Plan("trio", delay=0.1, noise=0.002, recorded=True),
)
"""Without faults."""


def _disturbed(*faults: tuple[str, ...]) -> tuple[Plan, ...]:
    """The mission trio with one fault each, or two that belong together."""
    return tuple(Plan("trio", faults=one) for one in faults)


LEADERS = _disturbed(
    ("leader:kill@6+8",),
    ("leader:cut@6+6",),
    ("leader:freeze@6+5",),
    ("leader:mute@6+6", "deputy:freeze@9+4"),
    ("leader:deaf@6+6",),
    ("leader:clock=-50@5+3", "leader:kill@9+3"),
    ("leader:late=0.5@5+6",),
    ("leader:reset@6+3", "deputy:kill@8+4"),
    ("leader:loss=0.5@5+8",),
)
STOPS = _disturbed(
    ("robot1:stop@5+4",),
    ("robot1:stop@4+8", "robot1:kill@6+2", "robot2:torn@7+2"),
    ("robot1:hold@5+4", "robot3:kill@6+1"),
    ("robot2:waver@5+4",),
    ("robot1:full@4+8", "robot1:stop@6+5", "robot1:kill@8+2"),
)
ROBOTS = _disturbed(
    ("robot1:kill@6+3",),
    ("robot1:cut@6+6",),
    ("robot1:freeze@6+3",),
    ("robot1:second@5+6",),
    ("robot2:mixed@5+6",),
    ("robot1:clock=20@5+8",),
    ("robot2:twice=1@4+8", "robot2:jitter=0.4@5+8"),
    ("robot1:unwatched@5+4", "robot2:reset@6+4"),
    ("robot2:slow=0.2@5+8",),
)
POSITIONS = _disturbed(
    ("robot3:frozen@6+6",),
    ("robot3:stale=1.5@6+6",),
    ("robot3:carried=0.2@6+6",),
    ("robot3:blocked@6+6",),
    ("robot3:speeds=0@6+6",),
    ("robot3:speeds=1.8@6+6",),
    ("robot3:tremble=0.0005@6+6",),
    ("robot3:backlog=0.5@6+6",),
    ("robot3:restamped=1@6+6",),
    ("robot3:stutter=0.4@6+8",),
)

SENSORS = (
    Plan("measured", faults=("robot3:relative_frozen@6+6",)),
    Plan("measured", faults=("robot3:relative_late=1@6+6",)),
    Plan("tracked", faults=("robot1:frozen@6+6",)),
    Plan("tracked", faults=("robot1:stale=1@6+6",)),
    Plan("tracked", faults=("robot1:kill@6+2",)),
    Plan("tracked", faults=("robot2:carried=0.2@6+5",)),
    Plan("turtlebot3_pair", faults=("robot1:kill@6+2",)),
    Plan("turtlebot3_pair", faults=("robot1:stale=1@6+6",)),
)

CROSSING = (
    Plan("swap", faults=("robot1:kill@5+4",)),
    Plan("swap", faults=("robot2:stop@4+3",)),
    Plan("swap", faults=("robot3:reset@4.5+6",)),
    *(Plan("swap", seed, ("kill", "torn", "reset", "hold", "stop", "unwatched")) for seed in range(6)),
)

ORDERED = (
    Plan("trio", told=RESTS),
    Plan("trio", told=ORDERS),
    Plan("trio", told=ORDERS[:3], faults=("leader:kill@12+6",)),
)

SIGNED = (
    Plan("trio", signed=True, faults=("robot1:forge@5+8",)),
    Plan("trio", signed=True, faults=("robot3:forge@4+12", "leader:kill@7+6")),
)

DRAWN = (
    *(Plan("trio", seed, ("all",), signed=bool(seed % 2)) for seed in range(12)),
    *(Plan("turtlebot3_pair", seed, ("kill", "cut", "full", "hold", "stop", "freeze")) for seed in range(2)),
    *(Plan("patrol", seed, ("all",)) for seed in range(4)),
    *(Plan("six_robots", seed, ("all",)) for seed in range(4)),
)
"""Faults from a seed."""

LARGE = (
    Plan("posts"),
    Plan("posts", faults=("robot1:scan_frozen@8+8",)),
    Plan("posts", faults=("robot1:scan_late=1@8+8",)),
    Plan("six_robots", noise=0.005, delay=0.1, seconds=60.0),
    Plan("two_chains"),
    Plan("patrol", recorded=True, faults=("robot1:stop@6+4",)),
)

GROUPS = {
    "quiet": QUIET,
    "leaders": LEADERS,
    "stops": STOPS,
    "robots": ROBOTS,
    "positions": POSITIONS,
    "sensors": SENSORS,
    "crossing": CROSSING,
    "ordered": ORDERED,
    "signed": SIGNED,
    "drawn": DRAWN,
    "large": LARGE,
}
PLANS: tuple[Plan, ...] = tuple(plan for group in GROUPS.values() for plan in group)
QUICK = 8
"""Number of plans of a short run."""


def ordered(first: Sequence[str]) -> list[int]:
    """The numbers of all plans, those of the groups `first` before the others."""
    group_of = [name for name, group in GROUPS.items() for _ in group]
    rank = {name: place for place, name in enumerate((*first, *(set(GROUPS) - set(first))))}
    return sorted(range(len(PLANS)), key=lambda n: (min(rank[group_of[n]], len(first)), n))
