"""The figures of docs/simulation.md: both laws from the same starts, in every scenario of the table.

python -m tests.campaigns.bench.table [--readings] [--runs N]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from formation.control.observer import INNOVATION, PRINTED
from formation.mission.model import Mission
from formation.simulation.ensemble import Options
from formation.simulation.simulate import simulate
from tests.campaigns.bench.control_trials import drawn, slot_errors
from tests.campaigns.bench.lower_bound import by_distance
from tests.campaigns.figures import worded
from tests.unit.formation import scenarios

COLUMNS = {"paper law": "paper", "field law": "field"}
SEED = 0


@dataclass(frozen=True)
class Scenario:
    """One line of a table; for one of `READINGS` the paper's law, understood or simulated differently."""

    name: str
    build: Callable[..., Mission]
    options: Options = field(default_factory=Options)
    runs: int | None = None
    """Where it is not the command line's."""
    hops: tuple[int, ...] = ()
    """Robots whose distance from their slot is shown (RMS over the last third), not settling times."""
    times: Mapping[str, float] = field(default_factory=dict)
    """Step and horizon, where they are not the mission's [s]."""


LATE = Options(delay=0.1)
SCENARIOS = (
    Scenario("six robots", scenarios.six),
    Scenario("TurtleBot3 pair", scenarios.pair),
    Scenario("six robots near the limit", scenarios.near_limit),
    Scenario("ten in a chain", partial(scenarios.long_chain, 10)),
    Scenario("fifty in a chain", partial(scenarios.long_chain, 50), runs=60),
    Scenario("chain on a circle, hop 1 / 5 / 11", scenarios.circling_chain, runs=1, hops=(1, 5, 11)),
    Scenario("the same, samples 100 ms old", scenarios.circling_chain, LATE, 1, (1, 5, 11)),
    Scenario("straight chain, samples 100 ms old, hop 1 / 11", scenarios.straight_chain, LATE, 1, (1, 11)),
)
LOCAL = Options(measurement="local")
READINGS = (
    Scenario("six robots, positions over the network, ζ̂/|ζ̂|", scenarios.six),
    Scenario("– ζ̂ of any length", scenarios.six, Options(normalised=False)),
    Scenario("– sensor on the robot, ζ̂/|ζ̂|", scenarios.six, LOCAL),
    Scenario(
        "– sensor on the robot, ζ̂ of any length: Eq. (7) as printed",
        scenarios.six,
        Options(measurement="local", normalised=False),
    ),
    Scenario("– the observer in innovation form", scenarios.six, Options(observer=INNOVATION)),
    Scenario("– Eq. (3) as printed, -k ω ζ̂", scenarios.six, Options(observer=PRINTED)),
    Scenario("near the limit", scenarios.near_limit),
    Scenario("– step 40 ms", scenarios.near_limit, times={"step": 0.04}),
    Scenario("– step 10 ms", scenarios.near_limit, times={"step": 0.01}),
    Scenario("– horizon 360 s", scenarios.near_limit, times={"horizon": 360.0}),
    Scenario("– ω_max 2.84 rad/s", partial(scenarios.near_limit, max_turn_rate=2.84)),
    Scenario("– the observer in innovation form", scenarios.near_limit, Options(observer=INNOVATION)),
)


def figure(scenario: Scenario, kind: str, runs: int) -> str:
    """What one law makes of a scenario, as the table says it."""
    mission, options = scenario.build(kind=kind), scenario.options
    result = simulate(
        mission,
        runs=scenario.runs or runs,
        seed=SEED,
        options=options,
        starts="random",
        keep=bool(scenario.hops),
    )
    if scenario.hops:
        errors = [slot_errors(mission, result)[hop] for hop in scenario.hops]
        return " / ".join(f"{100.0 * error:.{0 if error >= 0.095 else 2}f}" for error in errors) + " cm"
    found = result.summary()
    share = found["converged_fraction"]
    if share < 0.5:
        return f"{100.0 * share:.0f} %"
    return ("" if share == 1.0 else f"{100.0 * share:.0f} %, ") + times(found)


def times(summary: Mapping[str, Any]) -> str:
    return "{median:.1f} / {p95:.1f} s".format(**summary["settling_time"])


def readings(runs: int) -> None:
    """Print what becomes of the paper's law when it is read differently."""
    print("| paper law | converged | settling median / p95 |\n|---|---:|---:|")
    for one in READINGS:
        mission = one.build(kind="paper")
        found = simulate(mission, runs=runs, seed=SEED, options=one.options, **one.times).summary()  # type: ignore[arg-type]
        print(f"| {one.name} | {converged_cells(found)} |", flush=True)


def converged_cells(found: Mapping[str, Any]) -> str:
    """Return the share of starts that converge, and their times; of under one in a hundred no times."""
    share = 100.0 * found["converged_fraction"]
    if share < 1.0:
        return f"{'under 1' if share else '0'} % | –"
    return f"{share:.0f} % | {times(found)}"


def main() -> None:
    """Print the table."""
    parser = worded(__doc__)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--readings", action="store_true", help="the paper's law read differently")
    given = parser.parse_args()
    if given.readings:
        readings(given.runs)
        return
    print("| scenario |", " | ".join(COLUMNS), "|")
    print("|---" * (1 + len(COLUMNS)) + "|")
    for scenario in SCENARIOS:
        cells = [figure(scenario, kind, given.runs) for kind in COLUMNS.values()]
        print(f"| {scenario.name} |", " | ".join(cells), "|", flush=True)
        if not scenario.hops and scenario.runs is None:
            mission = scenario.build()
            best = by_distance(mission, drawn(mission, given.runs, SEED))
            middle, upper = np.percentile(best, (50, 95))
            print(f"| – at best | | {middle:.1f} / {upper:.1f} s |", flush=True)


if __name__ == "__main__":
    main()
