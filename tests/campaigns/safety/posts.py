"""Posts in the way of a formation: does anybody touch one, and does it form again behind them?"""

from __future__ import annotations

import random
import statistics
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.patches import Circle

from formation.deploy.rehearsal.workers import each
from formation.mission.file import load
from formation.mission.model import Mission
from tests.campaigns.document import Found
from tests.campaigns.figures import filled
from tests.campaigns.parts import table
from tests.campaigns.plots import BLUE, INK, ORANGE, panels
from tests.campaigns.safety.part import Options, bar, reporting
from tests.support.fleet import Fleet
from tests.unit.formation import scenarios

SIX = load("six_robots")
HEAD = SIX.robots[SIX.leader].start.heading  # where the formation goes, unit [world frame]
MOST = 5  # posts of a layout
THIN, THICK = 0.04, 0.2  # their radii [m]
NEAR, FAR = 1.8, 4.0  # how far ahead of where the leader starts they stand [m]; robots start behind it
ASIDE = 0.3
"""They stand as far to the left as the leftmost slot and so much more, and the same to the right [m]."""
GAP = 0.6  # between two of them at least [m]: a body with its margins needs 30 cm, the filter's disc ahead 50
BODY = SIX.robots[SIX.followers[0]].radius  # of a robot [m]


class Post(NamedTuple):
    """Something round that stands."""

    at: complex  # [m; world frame]
    radius: float  # [m]


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


FIGURE = "figures/safety_posts.svg"
PICTURED, PICTURE_STEP = 36.0, 0.1  # what is shown, and from point to point of a path [s]
MOMENTS = (8.0, 22.0, 36.0)  # at which bodies are drawn [s]


def draw(seed: int, folder: Path) -> None:
    """Paths of all robots past one layout, with noise and lost beams, into docs/figures."""
    posts = layout(seed)
    fleet = Fleet(mission(posts, worse=True), seed=seed)
    places = []
    for _ in range(round(PICTURED / PICTURE_STEP)):
        fleet.run(PICTURE_STEP)
        leader = fleet.points()[0]  # has all be where they are by now
        places.append([leader, *(fleet.plant(name).position for name in fleet.mission.followers)])
    way = np.array(places) * HEAD.conjugate()
    with panels(folder / Path(FIGURE).name, 1, (7.0, 3.4), {"svg.hashsalt": "safety"}) as (axes,):
        axes.plot(way[:, 0].real, way[:, 0].imag, color=INK, linewidth=1.0, linestyle="--")
        axes.plot(way[:, 1:].real, way[:, 1:].imag, color=BLUE, linewidth=1.0)
        for moment in MOMENTS:
            for at in way[round(moment / PICTURE_STEP) - 1, 1:]:
                axes.add_patch(Circle((at.real, at.imag), BODY, color=BLUE, alpha=0.5, linewidth=0.0))
        for post in posts:
            at = post.at * HEAD.conjugate()
            axes.add_patch(Circle((at.real, at.imag), post.radius, color=ORANGE))
        axes.set_aspect("equal")
        axes.set_xlabel("along the leader's way [m]")
        axes.set_ylabel("to the left of it [m]")


TITLE = "Posts in the way"
SECONDS, STEP, LAST = 70.0, 0.05, 5.0
"""Of a run, between two looks, at the end of which all has to be in formation [s]."""
FORMED = 0.05  # summed formation error under which it is [m]
LAYOUTS, CLEAN = 200, 40  # with noise and lost beams, and without
SHOWN = 6  # the layout of the picture
ABOUT = filled(
    "Production agents of `six_robots` (five robots of 10 cm that drive, up to 1.5 m/s; the leader goes",
    'straight on at 0.2 m/s) with range scanners at 5 Hz, `scanner = "required"` and `avoid = "all"`, on a',
    f"fake clock for {SECONDS:.0f} s. Robots are kinematic: what stands does not stop them, so a touch is",
    f"seen as one. Layouts are drawn at random: one to {MOST} posts of {100 * THIN:.0f} to",
    f"{100 * THICK:.0f} cm radius between {NEAR:g} and {FAR:g} m ahead of the leader's start, anywhere",
    f"across the way of the formation and {100 * ASIDE:.0f} cm to either side, at least one of them where a",
    "robot would drive into",
    f"it. Gaps between them are at least {100 * GAP:.0f} cm: a body with its margins is 30 cm wide, and the",
    "disc ahead that the collision filter keeps clear 50 cm. *With noise* scanners have the noise of an",
    "LDS-01 (10 mm, 3.5 % beyond half a metre, two standard deviations) and lose 10 % of their beams. *Form",
    f"again*: the formation error, summed over all edges, stays under {100 * FORMED:.0f} cm over the last",
    f"{LAST:.0f} s.",
).strip()
HEADER = "scans | layouts | touched | nearest post | nearest bodies | form again | error then | deadlocks"


class Trial(NamedTuple):
    """One layout, driven once."""

    seed: int
    worse: bool  # whether beams are noisy and lost
    posts: int
    nearest_post: float  # how near a body came to a post, negative where they touched [m]
    nearest_body: float  # and to another body [m]
    error: float  # largest of the last seconds [m]
    deadlocks: int

    @property
    def touched(self) -> bool:
        """Whether anything did."""
        return min(self.nearest_post, self.nearest_body) < 0.0

    @property
    def formed(self) -> bool:
        """Whether they were in formation at the end."""
        return self.error < FORMED


def run(options: Options) -> Found:
    """All layouts, worse scanners first, and a picture of one."""
    tries = [(seed, True) for seed in range(4 if options.quick else LAYOUTS)]
    tries += [(seed, False) for seed in range(4 if options.quick else CLEAN)]
    tell, trials = reporting("posts"), []
    for one in each(drive, tries, options.jobs):
        trials.append(one)
        tell(len(trials) / len(tries))
    if options.figures is not None:
        draw(SHOWN, options.figures)
    return judged(trials)


def drive(one: tuple[int, bool]) -> Trial:
    """One layout, once, with worse scanners or clean ones."""
    seed, worse = one
    posts = layout(seed)
    fleet = Fleet(mission(posts, worse=worse), seed=seed)
    names, post, body, error = fleet.mission.followers, float("inf"), float("inf"), 0.0
    for step in range(round(SECONDS / STEP)):
        fleet.run(STEP)
        now = fleet.error()  # has all be where they are by now
        at = [fleet.plant(name).position for name in names]
        post = min(post, *(abs(one - two.at) - two.radius - BODY for one in at for two in posts))
        body = min(body, *(abs(one - two) - 2.0 * BODY for one, two in combinations(at, 2)))
        if (step + 1) * STEP > SECONDS - LAST:
            error = max(error, now)
    deadlocks = sum(fleet.status(name).deadlocks for name in names)
    return Trial(seed, worse, len(posts), post, body, error, deadlocks)


def judged(trials: list[Trial]) -> Found:
    """What came of them."""
    kinds, bars = {}, list[Any]()
    for name, worse in (("with noise, 10 % of beams lost", True), ("clean", False)):
        ran = [one for one in trials if one.worse == worse]
        touched, astray = [one for one in ran if one.touched], [one for one in ran if not one.formed]
        kinds[name] = {
            "layouts": len(ran),
            "touched": len(touched),
            "formed": len(ran) - len(astray),
            "nearest_post": min(one.nearest_post for one in ran),
            "nearest_body": min(one.nearest_body for one in ran),
            "error": statistics.median(one.error for one in ran),
            "deadlocks": sum(one.deadlocks for one in ran),
            "wrong": [one._asdict() for one in ran if one.touched or not one.formed],
        }
        bars += [
            bar(f"no touch, {len(ran)} layouts, {name}", f"{len(touched)} touch", not touched),
            bar(f"forms again, {name}", f"{len(ran) - len(astray)} of {len(ran)}", not astray),
        ]
    return {"kinds": kinds, "bars": bars}


def section(found: Found) -> str:
    """A table for people, what went wrong, and the picture."""
    rows = [
        f"{name} | {one['layouts']} | {one['touched']} | {100 * one['nearest_post']:.1f} cm | "
        f"{100 * one['nearest_body']:.1f} cm | {one['formed']} | {1000 * one['error']:.1f} mm | "
        f"{one['deadlocks']}"
        for name, one in found["kinds"].items()
    ]
    wrong = "".join(
        f"- {name}, seed {one['seed']}, {one['posts']} posts: post {100 * one['nearest_post']:.1f} cm, "
        f"bodies {100 * one['nearest_body']:.1f} cm away, error at the end {one['error']:.2f} m\n"
        for name, kind in found["kinds"].items()
        for one in kind["wrong"]
    )
    picture = f"![Paths of five robots round posts, and where they are after 8, 22 and 36 s]({FIGURE})\n"
    return "\n".join([table(HEADER, rows), *(["What went wrong:\n", wrong] if wrong else []), picture])
