"""The fixed list of plans that every defect meets, the quickest first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from tests.campaigns.defects.plan import Plan, Told

RESTS = (Told(6.0, "hold"), Told(8.0, "stop"), Told(10.0, "release"), Told(14.0, "run"))
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
HALVES = (
    Told(7.0, "cut", {"some": ("leader", "robot1"), "others": ("deputy", "reserve", "robot2", "robot3")}),
    Told(14.0, "heal"),
)
RIVALS = (
    Told(6.0, "cut", {"some": ("deputy",), "others": ("reserve",)}),
    Told(8.0, "kill", {"name": "leader"}),
    Told(16.0, "heal"),
    Told(17.0, "start", {"name": "leader"}),
)
ESTRANGED = (
    Told(6.0, "cut", {"some": ("deputy",), "others": ("leader", "reserve", "robot1", "robot2", "robot3")}),
    Told(9.0, "kill", {"name": "robot1"}),
    Told(9.0, "kill", {"name": "robot2"}),
    Told(9.1, "start", {"name": "robot1"}),
    Told(9.1, "start", {"name": "robot2"}),
    Told(9.2, "heal"),
    Told(9.2, "cut", {"some": ("deputy",), "others": ("leader",)}),
    Told(14.0, "heal"),
)
REPLACED = (
    Told(6.0, "cut", {"some": ("leader",), "others": ("robot1",)}),
    Told(6.5, "kill", {"name": "robot1"}),
    Told(6.6, "start", {"name": "robot1"}),
    Told(9.0, "heal"),
    Told(9.0, "cut", {"some": ("leader",), "others": ("robot3",)}),
    Told(14.0, "heal"),
)


def _on(mission: str, *plans: str, **others: Any) -> tuple[Plan, ...]:
    """Plans of one mission, each given by its faults."""
    return tuple(Plan(mission, faults=tuple(faults.split()), **others) for faults in plans)


_trio, _pair = partial(_on, "trio"), partial(_on, "turtlebot3_pair")
_dark, _dark_pair = (  # a power cut of all processes
    " ".join(f"{name}:kill@6+1" for name in names)
    for names in (
        ("leader", "deputy", "reserve", "robot1", "robot2", "robot3"),
        ("leader", "robot1", "robot2"),
    )
)

GROUPS: Mapping[str, tuple[Plan, ...]] = {
    "quiet": (*_pair(""), Plan("tracked"), Plan("measured"), Plan("swap"), Plan("trio", signed=True)),
    "fenced": _on("fenced", "", seconds=25.0),
    "recorded": _trio("", delay=0.1, noise=0.002, recorded=True),
    "killed": (*_trio("leader:kill@6+8"), *_pair("leader:kill@6+4")),
    "leadercut": (*_trio("leader:cut@6+6", "leader:deaf@6+6"), Plan("trio", told=HALVES)),
    "muted": _trio("leader:freeze@6+5", "leader:mute@6+6 deputy:freeze@9+4"),
    "votes": (
        *(Plan("trio", told=told) for told in (HALVES, RIVALS, ESTRANGED, REPLACED)),
        *_trio("leader:reset@6+3 deputy:kill@8+4", "leader:kill@8+6 reserve:deaf@8.5+0.5"),
    ),
    "clocks": (
        *_trio("robot1:clock=30@1", told=ORDERS[:1]),
        *_trio("leader:clock=-50@5+3 leader:kill@9+3", "robot1:clock=30@5+8"),
        *_trio("leader:clock=90@5+2 leader:reset@5.5+3", "leader:clock=90@1+6 leader:reset@7+0.3"),
    ),
    "leaderlate": (
        *_trio("robot1:late=0.5@5+6", "leader:late=0.5@5+6", "leader:loss=0.5@5+8"),
        *_on("measured", "robot1:late=0.5@5+8"),
    ),
    "stop": _trio("robot1:stop@5+4", "leader:delay=0.4@3+10 robot1:stop@6+4"),
    "stopkill": _trio("robot1:stop@4+8 robot1:kill@6+2 robot2:torn@7+2", "robot1:hold@5+4 robot3:kill@6+1"),
    "power": (
        *_pair(f"robot1:stop@4+8 {_dark_pair}", f"robot1:hold@4+8 {_dark_pair}"),
        *_trio(f"robot1:stop@4+9 {_dark}"),
    ),
    "leaderstop": _trio("robot1:stop@4+10 leader:kill@6+2 deputy:kill@6+2 reserve:kill@6+2 robot2:reset@7+2"),
    "waver": _trio(
        "robot2:waver@3+2 robot1:stop@5.2+4",
        "robot1:stop@4+3 robot2:loss=1@7.4+1.52 robot1:hold@8.25+4",
        "robot2:waver@5+4",
        "robot2:waver@5+4 robot2:loss=0.6@5+6",
    ),
    "full": _trio("robot1:full@4+8 robot1:stop@6+5 robot1:kill@8+2"),
    "crashed": _trio("robot1:kill@3+4", "robot1:kill@6+7"),
    "torn": _trio("robot1:torn@6+1 robot3:torn@8+2"),
    "robotcut": _trio("robot1:cut@6+6", "robot2:deaf@6+6"),
    "robotstall": _trio("robot1:freeze@6+3", "robot3:freeze@4+0.8"),
    "second": _trio("robot1:second@5+6", "robot1:second@3+4 leader:kill@4+6"),
    "mixed": _trio("robot2:mixed@5+6", "robot1:mixed@5+6"),
    "twice": _trio(
        "robot2:twice=1@4+8 robot2:jitter=0.4@5+8",
        "robot1:repeat=0.12@4+4",
        "leader:jitter=0.5@4+8",
        "robot1:again=2@4+10 robot1:kill@7+4",
    ),
    "unwatched": _trio("robot1:unwatched@5+4 robot2:reset@6+4"),
    "slow": _trio(
        "robot2:slow=0.12@0.3+8", "robot1:slow=0.12@0.3+8 robot2:slow=0.12@0.3+8", "robot2:slow=0.2@5+8"
    ),
    "frozen": _trio("robot3:frozen@6+6", "robot3:tremble=0.0005@6+6"),
    "late": _trio("robot3:stale=0.45@6+6", "robot3:stale=1.5@6+6", "robot3:backlog=0.5@6+6"),
    "carried": (*_trio("robot3:carried=0.2@6+6"), *_on("tracked", "robot1:hold@4+8 robot2:carried=0.2@7+4")),
    "blocked": _trio("robot3:blocked@6+6", "robot3:blocked@6+14"),
    "speeds": _trio("robot3:speeds=0@6+6", "robot3:speeds=1.8@6+6"),
    "restamped": _trio("robot3:restamped=1@6+6"),
    "stutter": _trio("robot3:stutter=0.4@6+8"),
    "relative": _on("measured", "robot3:relative_frozen@6+8", "robot3:relative_late=1@6+6"),
    "tracked": _on(
        "tracked", "robot1:frozen@6+6", "robot1:stale=1@6+6", "robot1:kill@6+2", "robot2:carried=0.2@6+5"
    ),
    "pair": (
        *_pair("robot1:kill@6+2", "robot1:stale=1@6+6", "robot1:restart@5+1 robot1:kill@8+2"),
        *_pair("", seconds=40.0),
    ),
    "crossing": (
        *_on("swap", "", "robot1:kill@5+4", "robot2:stop@4+3", "robot3:reset@4.5+6"),
        *(Plan("swap", seed, ("kill", "torn", "reset", "hold", "stop", "unwatched")) for seed in range(6)),
    ),
    "barred": _on("blocked", "robot2:kill@0.5 robot3:kill@0.5"),
    "crowd": (Plan("crowd", delay=0.1), Plan("crowd", delay=0.2), *_on("crowd", "robot1:kill@1.5+6")),
    "rests": _trio("", told=RESTS),
    "bend": (*_trio("", seconds=30.0), *_trio("", seconds=40.0, signed=True)),
    "paper": _on("trio_paper", "robot1:kill@6+7"),
    "orders": _trio("", told=ORDERS),
    "ordersfailover": _trio("leader:kill@20+6", told=ORDERS[:3]),
    "relayed": (
        *_on("relay", "leader:slow=0.12@0.1+8"),
        *_on("relay", "robot1:forge@5+8", "robot2:forge@4+12 leader:kill@7+6", signed=True),
        *_on("relay", "leader:kill@6+8", "robot1:late=0.5@5+6", "robot1:jitter=0.5@4+8 robot2:twice=1@4+8"),
    ),
    "signed": _trio(
        "robot1:forge@5+8",
        "robot3:forge@4+12 leader:kill@7+6",
        "robot1:replay@4+16 leader:kill@8+10",
        signed=True,
    ),
    "drawn": (
        *(Plan("trio", seed, ("all",), signed=bool(seed % 2)) for seed in range(12)),
        *(Plan("turtlebot3_pair", seed, ("kill", "cut", "full", "hold", "stop")) for seed in range(2)),
        *(Plan(mission, seed, ("all",)) for mission in ("patrol", "six_robots") for seed in range(4)),
    ),
    "posts": (
        *(Plan("posts"), Plan("posts", seconds=20.0)),
        *_on("posts", "robot1:scan_frozen@8+8", "robot1:scan_late=1@8+8"),
        *_on("posts_unfiltered", "robot1:unwatched@1"),
    ),
    "large": (
        *(Plan("six_robots", noise=0.005, delay=0.1, seconds=60.0), Plan("two_chains")),
        *_on("patrol", "robot1:stop@6+4", recorded=True),
    ),
}
"""All plans, in groups that are tried together."""
PLANS: list[Plan] = []
for _group in GROUPS.values():
    PLANS += [plan for plan in _group if plan not in PLANS]
QUICK = 8  # plans of a short run


def ordered(first: Sequence[str]) -> list[int]:
    """The numbers of all plans, those of the groups `first` before the others."""
    before = [PLANS.index(plan) for name in first for plan in GROUPS[name]]
    return list(dict.fromkeys([*before, *range(len(PLANS))]))
