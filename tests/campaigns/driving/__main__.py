"""`python -m tests.campaigns.driving`: time until the last command that is not zero, for each failure."""

from __future__ import annotations

import argparse
import random
from collections.abc import Callable, Mapping
from statistics import median

from formation.control.unicycle import AT_REST
from formation.deploy.rehearsal.operator import DESK
from formation.deploy.testing.rehearsed import RehearsedFleet

MISSION = "convoy"
SETTLING_SECONDS, WATCHED_SECONDS, REST_SECONDS = 4.0, 3.0, 580.0
STEP_SECONDS = 0.01
RELEASE = "driver lets go"
FAILURES: Mapping[str, Callable[[RehearsedFleet], None]] = {
    "driver cut off": lambda fleet: fleet.cut([DESK], ["leader"]),
    "leader dies": lambda fleet: fleet.kill("leader"),
    "leader hangs": lambda fleet: fleet.freeze("leader"),
    "leader cut off from the team": lambda fleet: fleet.cut(["leader"], fleet.mission.followers),
    "agent of the robot in its place dies": lambda fleet: fleet.kill("robot1"),
}
"""What fails while the leader is driven."""


def standing_after(failure: str, seed: int) -> float:
    """Time from a failure to the last command that is not zero [s]."""
    fleet, draw = RehearsedFleet(MISSION, seed=seed), random.Random(f"{failure} {seed}")
    fleet.run(SETTLING_SECONDS)
    fleet._judge.expect("hold")
    seconds, forward, turn_rate = draw.uniform(3.0, 5.0), draw.uniform(0.05, 0.16), draw.uniform(-0.2, 0.2)
    if failure == RELEASE:
        fleet.drive(forward, turn_rate, seconds=seconds)
    else:
        fleet._operator.drive(forward, turn_rate, 60.0)
        fleet.run(seconds)
        FAILURES[failure](fleet)
    began, last = fleet.now, 0.0
    while fleet.now < began + WATCHED_SECONDS:
        fleet.run(STEP_SECONDS)
        if any(fleet.command(name) != AT_REST for name in fleet.mission.followers):
            last = fleet.now - began
    return last


def wandered() -> float:
    """How far a robot comes from its place behind the leader at rest [m]."""
    fleet, farthest = RehearsedFleet(MISSION), 0.0
    fleet.run(5.0 * SETTLING_SECONDS)
    places = {name: fleet.position(name) for name in fleet.mission.followers}
    end = fleet.now + REST_SECONDS
    while fleet.now < end:
        fleet.run(0.5)
        farthest = max(farthest, *(abs(fleet.position(name) - place) for name, place in places.items()))
    return farthest


def main() -> None:
    """Print the figures of docs/decisions/0058."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.driving", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    seeds = range(parser.parse_args().seeds)
    for failure in (RELEASE, *FAILURES):
        times = [standing_after(failure, seed) for seed in seeds]
        print(
            f"{failure}: median {median(times):.2f} s, worst {max(times):.2f} s of {len(times)}", flush=True
        )
    print(f"leader at rest for {REST_SECONDS:g} s: {1e3 * wandered():.1f} mm from its place at most")


if __name__ == "__main__":
    main()
