"""The figures of docs/simulation.md: both laws from the same starts, in every scenario of the table.

python -m tests.campaigns.bench.table [--runs N] [--seed S] [--only WORD]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from formation.control.observer import INNOVATION, PRINTED
from formation.mission.model import Mission
from formation.simulation.ensemble import Options
from formation.simulation.simulate import simulate
from tests.campaigns.bench.control_trials import drawn, slot_errors
from tests.campaigns.bench.lower_bound import by_distance
from tests.unit.formation import scenarios

COLUMNS: dict[str, dict[str, Any]] = {
    "paper law": {"kind": "paper"},
    "field law": {"kind": "field"},
}


@dataclass(frozen=True)
class Scenario:
    """One line of the table."""

    name: str
    build: Callable[..., Mission]
    options: Options = field(default_factory=Options)
    runs: int | None = None
    """Where it is not the command line's."""
    hops: tuple[int, ...] = ()
    """Robots whose distance from their slot is shown (RMS over the last third), not settling times."""


SCENARIOS = (
    Scenario("six robots", scenarios.six),
    Scenario("TurtleBot3 pair", scenarios.pair),
    Scenario("six robots near the limit", scenarios.near_limit),
    Scenario(
        "ten in a chain",
        lambda **law: scenarios.long_chain(10, **law),
    ),
    Scenario(
        "fifty in a chain",
        lambda **law: scenarios.long_chain(50, **law),
        runs=60,
    ),
    Scenario(
        "chain on a circle, hop 1 / 5 / 11",
        scenarios.circling_chain,
        runs=1,
        hops=(1, 5, 11),
    ),
    Scenario(
        "the same, samples 100 ms old",
        scenarios.circling_chain,
        Options(delay=0.1),
        runs=1,
        hops=(1, 5, 11),
    ),
    Scenario(
        "straight chain, samples 100 ms old, hop 1 / 11",
        scenarios.straight_chain,
        Options(delay=0.1),
        runs=1,
        hops=(1, 11),
    ),
)


@dataclass(frozen=True)
class Reading:
    """The paper's law, understood or simulated differently."""

    name: str
    build: Callable[..., Mission]
    options: Options = field(default_factory=Options)
    step: float | None = None
    horizon: float | None = None


READINGS = (
    Reading("six robots, positions over the network, ζ̂/|ζ̂|", scenarios.six),
    Reading("– ζ̂ of any length", scenarios.six, Options(normalised=False)),
    Reading("– sensor on the robot, ζ̂/|ζ̂|", scenarios.six, Options(measurement="local")),
    Reading(
        "– sensor on the robot, ζ̂ of any length: Eq. (7) as printed",
        scenarios.six,
        Options(measurement="local", normalised=False),
    ),
    Reading("– the observer in innovation form", scenarios.six, Options(observer=INNOVATION)),
    Reading("– Eq. (3) as printed, -k ω ζ̂", scenarios.six, Options(observer=PRINTED)),
    Reading("near the limit", scenarios.near_limit),
    Reading("– step 40 ms", scenarios.near_limit, step=0.04),
    Reading("– step 10 ms", scenarios.near_limit, step=0.01),
    Reading("– horizon 360 s", scenarios.near_limit, horizon=360.0),
    Reading("– ω_max 2.84 rad/s", lambda **law: scenarios.near_limit(max_turn_rate=2.84, **law)),
    Reading("– the observer in innovation form", scenarios.near_limit, Options(observer=INNOVATION)),
)


def figure(scenario: Scenario, law: dict[str, Any], runs: int, seed: int) -> str:
    """What one law makes of a scenario, as the table says it."""
    mission = scenario.build(**law)
    result = simulate(
        mission,
        runs=scenario.runs or runs,
        seed=seed,
        options=scenario.options,
        starts="random",
        keep=bool(scenario.hops),
    )
    if scenario.hops:
        errors = slot_errors(mission, result)
        return (
            " / ".join(f"{100.0 * errors[hop]:.{0 if errors[hop] >= 0.095 else 2}f}" for hop in scenario.hops)
            + " cm"
        )
    found = result.summary()
    share, settling = found["converged_fraction"], found["settling_time"]
    if share < 0.5:
        return f"{100.0 * share:.0f} %"
    whole = "" if share == 1.0 else f"{100.0 * share:.0f} %, "
    return f"{whole}{settling['median']:.1f} / {settling['p95']:.1f} s"


def readings(runs: int, seed: int) -> None:
    """Print what becomes of the paper's law when it is read differently."""
    print("| paper law | converged | settling median / p95 |\n|---|---:|---:|")
    for reading in READINGS:
        found = simulate(
            reading.build(kind="paper"),
            runs=runs,
            seed=seed,
            options=reading.options,
            step=reading.step,
            horizon=reading.horizon,
        ).summary()
        settling, share = found["settling_time"], 100.0 * found["converged_fraction"]
        times = "–" if not share else f"{settling['median']:.1f} / {settling['p95']:.1f} s"
        print(f"| {reading.name} | {share:.0f} % | {times} |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="scenarios with this in their name")
    parser.add_argument("--readings", action="store_true", help="the paper's law read differently")
    arguments = parser.parse_args()
    if arguments.readings:
        readings(arguments.runs, arguments.seed)
        return
    print("| scenario |", " | ".join(COLUMNS), "|")
    print("|---" * (1 + len(COLUMNS)) + "|")
    for scenario in SCENARIOS:
        if arguments.only not in scenario.name:
            continue
        cells = [figure(scenario, law, arguments.runs, arguments.seed) for law in COLUMNS.values()]
        print(f"| {scenario.name} |", " | ".join(cells), "|", flush=True)
        if not scenario.hops and scenario.runs is None:
            mission = scenario.build()
            best = by_distance(mission, drawn(mission, arguments.runs, arguments.seed))
            print(
                f"| – at best | | {np.median(best):.1f} / {np.percentile(best, 95):.1f} s |",
                flush=True,
            )


if __name__ == "__main__":
    main()
