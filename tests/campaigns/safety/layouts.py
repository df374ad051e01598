"""Random posts in the way of `six_robots`, and its mission with them."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import NamedTuple

from formation.mission.file import load
from formation.mission.model import Mission
from tests.unit.formation import scenarios

SIX = load("six_robots")
HEAD = SIX.robots[SIX.leader].start.heading
"""Where the formation goes, unit [world frame]."""
MOST = 5
"""Posts of a layout."""
THIN, THICK = 0.04, 0.2
"""Their radii [m]."""
NEAR, FAR = 1.8, 4.0
"""How far ahead of where the leader starts they stand [m]; robots start behind it."""
ASIDE = 0.3
"""They stand as far to the left as the leftmost slot and so much more, and the same to the right [m]."""
GAP = 0.6
"""Between two of them at least [m]: a body with its margins needs 30 cm, the filter's disc ahead 50."""
BODY = SIX.robots[SIX.followers[0]].radius
"""Of a robot [m]."""


class Post(NamedTuple):
    """Something round that stands."""

    at: complex
    """[m; world frame]"""
    radius: float
    """[m]"""


def tracks() -> list[float]:
    """How far to the left of the leader's way each robot goes in formation [m]."""
    return [(slot * HEAD.conjugate()).imag for slot in SIX.slots()[1:]]


def layout(seed: int) -> list[Post]:
    """One to five posts, at least one of them in the way of a robot."""
    draw = random.Random(seed)
    while True:
        posts = _drawn(draw)
        if any(in_the_way(post) for post in posts):
            return posts


def in_the_way(post: Post) -> bool:
    """Whether the body of a robot would touch it in formation."""
    left = (post.at * HEAD.conjugate()).imag
    return any(abs(left - track) < post.radius + BODY for track in tracks())


def _drawn(draw: random.Random) -> list[Post]:
    number, posts = draw.randint(1, MOST), list[Post]()
    left, right = max(tracks()) + ASIDE, min(tracks()) - ASIDE
    while len(posts) < number:
        at, radius = complex(draw.uniform(NEAR, FAR), draw.uniform(right, left)), draw.uniform(THIN, THICK)
        one = Post(at * HEAD, radius)
        if all(abs(one.at - other.at) - one.radius - other.radius >= GAP for other in posts):
            posts.append(one)
    return posts


def mission(posts: Sequence[Post], *, worse: bool) -> Mission:
    """`six_robots` that avoid all and see by scanners what stands there.

    `worse` scanners have the noise of an LDS-01 and lose a tenth of their beams, the others neither.
    """
    result = scenarios.clearing(SIX).model_dump()
    for name in SIX.followers:
        result["robots"][name]["scanner"] = "required"
    result["simulated_scanner"] = {"lost": 0.1} if worse else {"noise": 0.0, "relative_noise": 0.0}
    result["simulation"]["posts"] = [{"x": at.real, "y": at.imag, "radius": radius} for at, radius in posts]
    return Mission.model_validate(result)
