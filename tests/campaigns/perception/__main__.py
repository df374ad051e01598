"""`python -m tests.campaigns.perception --help`: one line for each run, errors in centimetres."""

from __future__ import annotations

import argparse
from collections import Counter

from formation.deploy.rehearsal.air import Weather
from formation.sensing.models import MODELS
from tests.campaigns.perception.drift import BLIND, ROUTES, Case, locked_after, run, window
from tests.support.seeing import HEXAGON_TEAM, SQUARE_TEAM, Errors

MINUTES = (1, 2, 5, 10)
"""Ends of the minutes that are printed."""
START_SECONDS = 20
"""Time in which robots get to their slots; not judged [s]."""
RETURN_SECONDS = 10
"""Time for a robot that saw nothing to come back [s]."""


def main() -> None:
    """Run a case from several seeds."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.perception", description=__doc__)
    parser.add_argument("route", choices=ROUTES)
    parser.add_argument("--world", choices=("kinematic", "mujoco"), default="mujoco")
    parser.add_argument("--measurement", choices=("scan", "network"), default="scan")
    parser.add_argument("--scale", type=float, default=0.0, help="error of distances, as a share")
    parser.add_argument("--mounting", type=float, default=0.0, help="error of directions [°]")
    parser.add_argument("--start", type=float, default=0.02, help="deviation of start positions [m]")
    parser.add_argument("--start-deg", type=float, default=1.0, help="deviation of start headings [°]")
    parser.add_argument("--square", action="store_true", help="four robots in a square of 0.8 m")
    parser.add_argument("--scanner", choices=MODELS, default="", help="model of the scanners")
    parser.add_argument("--drivers", action="store_true", help="scans as the model's driver sends them")
    parser.add_argument("--blind", action="store_true", help="one robot sees nothing from 40 to 70 s")
    parser.add_argument("--posts", type=float, default=0.0, help="posts [1/m²], in mujoco")
    parser.add_argument("--clearance", type=float, default=0.45, help="of posts from the robots' ways [m]")
    parser.add_argument("--loss", type=float, default=0.0, help="share of messages that is lost")
    parser.add_argument("--delay", type=float, default=0.0, help="delay of messages [s]")
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    flags = parser.parse_args()
    if flags.seconds <= START_SECONDS:
        parser.error(f"--seconds is {flags.seconds}, must be more than {START_SECONDS}")
    errors = Errors(
        scale=flags.scale, mounting_deg=flags.mounting, start=flags.start, start_deg=flags.start_deg
    )
    team, weather = SQUARE_TEAM if flags.square else HEXAGON_TEAM, Weather(flags.loss, flags.delay)
    case = Case(
        flags.route, flags.measurement, flags.world, errors, team, weather,
        scanner=flags.scanner, drivers=flags.drivers, blinds=flags.blind,
        posts=flags.posts, clearance=flags.clearance,
    )  # fmt: skip
    for seed in flags.seeds:
        samples, witness = run(case, seed, flags.seconds)
        parts = [f"{flags.route} seed {seed}"]
        for minute in MINUTES:
            if 60 * minute <= flags.seconds:
                one = window(samples, max(START_SECONDS, 60.0 * (minute - 1)), 60.0 * minute)
                parts.append(
                    f"minute {minute}: {100 * one.shape:.2f} ({100 * one.believed:.2f} believed,"
                    f" {100 * one.world:.2f} world)"
                )
        settled = window(samples, START_SECONDS, flags.seconds)
        states = Counter(state for one in samples[START_SECONDS:] for state in one.states.values())
        parts.append(f"from {START_SECONDS} s on: {100 * settled.shape:.2f}")
        if flags.blind:
            begin, end = BLIND
            worst = max(one.error.shape for one in samples if begin < one.time <= end + RETURN_SECONDS)
            after = max(one.error.shape for one in samples if one.time > end + RETURN_SECONDS)
            parts.append(
                f"blind: worst {100 * worst:.2f}; from {RETURN_SECONDS} s later on {100 * after:.2f}"
            )
        parts.append(f"locked after {locked_after(samples)} s")
        parts.append(f"wrong {witness.wrong} of {witness.right + witness.wrong}")
        print("; ".join(parts), dict(states), flush=True)


if __name__ == "__main__":
    main()
