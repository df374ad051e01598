"""What `formation check` says is proven of random missions, and what happens to them.

python -m tests.campaigns.certificates [--missions N] [--short N] [--jobs N]

Each mission is simulated with ideal bodies, without ramp and collision filter, as its certificate assumes:

| it says | what is to happen |
|---|---|
| every start, but for a route of circles only | all random starts settle |
| near formation | starts within a millimetre of the slots settle |
| none | starts within 10 µm of the slots swing up to more than that |
| an error on curves | robots err by as much, and not more, on a circle |

Prints the counts, and each mission that contradicts its certificate, by its seed.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from formation.mission.graph import cyclic_core
from formation.mission.model import Mission
from formation.simulation.simulate import simulate
from formation.stability import spectrum
from formation.stability.analysis import certified
from formation.stability.certificate import CIRCLES_ONLY
from tests.campaigns.document import count
from tests.campaigns.figures import markdown, worded
from tests.campaigns.safety.part import reported
from tests.unit.formation import scenarios
from tests.unit.formation.scenarios import IDEAL, edge_errors

NEAR = 1e-3
"""Starts near formation are off by at most this on each axis [m]."""
TINY = 1e-5
"""Starts of an unstable loop are off by at most this on each axis [m]: limits may keep its swing small."""
PATIENCE = 4.0
"""Where not all robots settle they are given so many times the time: some are slow to turn."""
MAX_GAIN_SHARE = 1.5
"""Greatest gain times control period: nearer to 2, the limit near formation, first headings that are not
known leave a swing that the limits of the robots keep up [–]."""
LEAST_GROWTH = 0.1
"""A swing that grows slower than this does not show within a run [1/s]."""
LEAST_CURVE_ERROR = 1e-4
"""Certified errors below are not compared [m]."""
MAX_CURVE_RATIO = 1.002
"""Measured error on a circle over the certified one, at most [–]: what has not yet settled counts."""


class Outcome(NamedTuple):
    """One mission."""

    seed: int
    says: str
    cyclic: bool
    holds: bool
    """Whether what happened agrees with the certificate."""
    ratio: float
    """Largest certified error on a circle over the measured one; NaN without a circle."""
    found: str


def drawn(seed: int, *, short: bool) -> Mission:
    """A random mission of 3 to 8 robots, 2 to 4 if `short`.

    Every third has a cycle if it can; every other of the rest a leader on a circle.
    """
    rng = np.random.default_rng(seed)
    robots = int(rng.integers(2, 5) if short else rng.integers(3, 9))
    cyclic = seed % 3 == 0 and robots > 2
    others = robots if cyclic else 0
    neighbours = [
        sorted({int(rng.integers(0, one)), int(rng.integers(0, max(others, one)))} - {one})
        for one in range(1, robots)
    ]
    slots = -0.7 * np.arange(robots) + 1j * rng.uniform(-1.0, 1.0, robots)
    offset, top, turn = (float(rng.uniform(*ends)) for ends in ((0.05, 0.3), (0.2, 2.0), (0.5, 3.0)))
    most = 0.5 if short else 0.95  # there is no time to catch up with a fast leader
    speed = float(rng.uniform(0.02, most)) * min(top, offset * turn)
    route: dict[str, Any] = {"speed": speed, "heading_deg": float(rng.uniform(-180.0, 180.0))}
    if seed % 2 and not cyclic:
        route = {"speed": speed, "radius": float(rng.uniform(1.0, 5.0))}
    rate = float(rng.choice([5.0, 10.0, 20.0, 50.0]))
    law: dict[str, Any] = {"leader_orders": "none"}
    if seed % 5 == 0:
        law["gain"] = float(np.exp(rng.uniform(np.log(0.5), np.log(MAX_GAIN_SHARE * rate))))
    robot = {"control_point_offset": offset, "max_speed": top, "max_turn_rate": turn, "rate": rate}
    return scenarios.build(slots - slots[0], [[], *neighbours], route, law=law, robot=robot)


def tried(seed: int, *, short: bool) -> Outcome:
    """Compare a mission's certificate with simulations."""
    mission = drawn(seed, short=short)
    found = certified(mission)
    cyclic = bool(cyclic_core(mission.graph))
    far = found.convergence == "every start" or found.broken == (CIRCLES_ONLY,)
    spread = 2.0 if far else {"near formation": NEAR}.get(found.convergence, TINY)
    runs, horizon = (1, 40.0) if short else (10, 120.0)
    run = partial(
        simulate, mission, runs=runs, seed=seed, step=step_of(mission),
        options=IDEAL, starts="random", spread=spread,
    )  # fmt: skip
    result = run(horizon=horizon)
    if not result.converged.all():
        result = run(horizon=PATIENCE * horizon)
    # on a circle the error that is left, summed over edges, may be more than the mission's bound
    left = sum(error * len(mission.robots[name].neighbours) for name, error in found.curve_errors.items())
    holds = bool((result.converged | (result.final_error <= MAX_CURVE_RATIO * left)).all())
    if found.convergence == "none":  # limits may keep the swing below the mission's bound
        growth = spectrum.cyclic_poles(mission, *mission.gains).real.max() if cyclic else turning(mission)
        holds = growth < LEAST_GROWTH or bool((result.final_error > TINY).all())
    ratio = curve_ratio(mission, found.curve_errors) if far else math.nan
    if not math.isnan(ratio) and ratio < 1.0 / MAX_CURVE_RATIO:
        holds = False
    what = f"{found.convergence}, {int(result.converged.sum())} of {len(result.converged)} starts settle"
    return Outcome(seed, found.convergence, cyclic, holds, ratio, what)


def turning(mission: Mission) -> float:
    """Growth of the fastest swing across the leader's direction [1/s], by Proposition 2; without a cycle."""
    rates = []
    for name in mission.followers:
        spec = mission.robots[name]
        a, b = mission.gains.k_p / spec.rate, mission.leader_speed / (spec.control_point_offset * spec.rate)
        poles = np.roots((1.0, a + b + 0.5 * a * b - 2.0, 1.0 - a - b + 0.5 * a * b))
        rates.append(spec.rate * math.log(np.abs(poles).max()))
    return max(rates)


def step_of(mission: Mission) -> float:
    """The control period of its robots [s]."""
    return 1.0 / min(mission.robots[name].rate for name in mission.followers)


def curve_ratio(mission: Mission, errors: dict[str, float]) -> float:
    """Certified error of the edge that errs most on a circle, over the measured one; NaN without a circle."""
    if not errors or max(errors.values()) < LEAST_CURVE_ERROR:
        return math.nan
    return max(errors.values()) / max(edge_errors(mission, step=step_of(mission)).values())


def outcomes(missions: int, jobs: int, *, short: bool) -> list[Outcome]:
    """Try so many missions."""
    with ProcessPoolExecutor(jobs) as pool:
        results = pool.map(partial(tried, short=short), range(missions), chunksize=20)
        tried_ones = reported("short" if short else "full", range(missions))
        return [one for _, one in zip(tried_ones, results, strict=True)]


def table(found: Sequence[Outcome]) -> str:
    """How often each verdict was given, and how often it was wrong."""
    rows = []
    for says, cyclic in sorted({(one.says, one.cyclic) for one in found}):
        held = Counter(one.holds for one in found if (one.says, one.cyclic) == (says, cyclic))
        rows.append([says, "yes" if cyclic else "no", f"{held.total()}", f"{held[False]}"])
    return markdown(("check says", "a cycle", "missions", "contradicted"), rows)


def main(words: Sequence[str] | None = None) -> int:
    """Try, and print; 1 if any mission contradicts its certificate."""
    flags = worded(__doc__)
    flags.add_argument("--missions", type=count(10**6), default=10_000, help="whole ones (default: 10000)")
    flags.add_argument("--short", type=count(10**7), default=100_000, help="short ones (default: 100000)")
    flags.add_argument("--jobs", type=count(64), default=2, help="processes side by side (default: 2)")
    given = flags.parse_args(words)
    every: list[Outcome] = []
    for short, missions in ((False, given.missions), (True, given.short)):
        found = outcomes(missions, given.jobs, short=short)
        every += found
        ratios = [one.ratio for one in found if not math.isnan(one.ratio)]
        print(f"\n{'short' if short else 'whole'} missions:\n\n{table(found)}")
        if ratios:
            low, middle, high = np.percentile(ratios, (0, 50, 100))
            circles = f"certified over measured error on {len(ratios)} circles"
            print(f"{circles}: {low:.3f}, {middle:.3f}, {high:.3f}")
    for one in every:
        if not one.holds:
            print(f"seed {one.seed}: {one.found}, ratio {one.ratio:.3f}")
    return 0 if all(one.holds for one in every) else 1


if __name__ == "__main__":
    sys.exit(main())
