"""Posts in the way of a formation: does anybody touch one, and does it form again behind them?"""

from __future__ import annotations

import statistics
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from itertools import combinations
from typing import Any, NamedTuple

from tests.campaigns.document import Found
from tests.campaigns.figures import filled, markdown
from tests.campaigns.safety import paths
from tests.campaigns.safety.layouts import ASIDE, BODY, FAR, GAP, MOST, NEAR, THICK, THIN, layout, mission
from tests.campaigns.safety.part import Options, bar, reporting
from tests.support.fleet import Fleet

TITLE = "Posts in the way"
SECONDS, STEP, LAST = 70.0, 0.05, 5.0
"""Of a run, between two looks, at the end of which all has to be in formation [s]."""
FORMED = 0.05
"""Summed formation error under which it is [m]."""
LAYOUTS, CLEAN = 200, 40
"""With noise and lost beams, and without."""
SHOWN = 6
"""The layout of the picture."""
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
HEADER = (
    "scans", "layouts", "touched", "nearest post", "nearest bodies", "form again", "error then",
    "deadlocks",
)  # fmt: skip


class Trial(NamedTuple):
    """One layout, driven once."""

    seed: int
    worse: bool
    """Whether beams are noisy and lost."""
    posts: int
    nearest_post: float
    """How near a body came to a post, negative where they touched [m]."""
    nearest_body: float
    """And to another body [m]."""
    error: float
    """Largest of the last seconds [m]."""
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
    for one in driven(tries, options.jobs):
        trials.append(one)
        tell(len(trials) / len(tries))
    if options.figures is not None:
        paths.draw(SHOWN, options.figures)
    return judged(trials)


def driven(tries: list[tuple[int, bool]], jobs: int) -> Iterable[Trial]:
    """Each layout, with so many processes side by side."""
    if jobs == 1:
        yield from (drive(*one) for one in tries)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(drive, *zip(*tries, strict=True))


def drive(seed: int, worse: bool) -> Trial:
    """One layout, once."""
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
        [
            name,
            *(str(one[key]) for key in ("layouts", "touched")),
            *(f"{100 * one[key]:.1f} cm" for key in ("nearest_post", "nearest_body")),
            str(one["formed"]),
            f"{1000 * one['error']:.1f} mm",
            str(one["deadlocks"]),
        ]
        for name, one in found["kinds"].items()
    ]
    wrong = "".join(
        f"- {name}, seed {one['seed']}, {one['posts']} posts: post {100 * one['nearest_post']:.1f} cm, "
        f"bodies {100 * one['nearest_body']:.1f} cm away, error at the end {one['error']:.2f} m\n"
        for name, kind in found["kinds"].items()
        for one in kind["wrong"]
    )
    return "\n".join(
        [
            markdown(HEADER, rows),
            *(["What went wrong:\n", wrong] if wrong else []),
            f"![Paths of five robots round posts, and where they are after 8, 22 and 36 s]({paths.FIGURE})\n",
        ]
    )
