"""Positions and orders that come late: fleets on a fake clock, at random moments.

``python -m tests.campaigns.reliability.late [--seeds N]`` makes each robot's own
positions late by each of `LATE`, or later and later, and each link slower and slower; it prints a table and
ends with 1 if anything moved that should not have. `tests/unit/agent/test_lateness.py` has a few of these as
tests.
"""

from __future__ import annotations

import argparse
import random
import sys
from itertools import product
from typing import NamedTuple

from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.lateness import MAX_BEAT_LATENESS
from formation.protocol.order import LEADER_TIMEOUT_SECONDS
from formation.protocol.status import AgentState
from tests.support.fleet import Fleet, Link

MISSIONS = ("six_robots", "turtlebot3_pair", "patrol", "two_chains")
LATE = (0.3, 0.5, 1.0, 2.0, 4.0)  # [s]
GRACE = 1.0  # from so long after the fault begins on, the robot must stand [s]
FARTHEST = 0.1  # it may drive this far while it should stand [m]
LASTS = 8.0  # a fault of a sensor [s]
BACK = 6.0  # so long after the fault ends the robot runs again at most, beyond what is still under way [s]
BOUNDED = LEADER_TIMEOUT_SECONDS + MAX_BEAT_LATENESS + 1.5
"""So long after their leader's death robots behind links that slow down hold at most [s]."""


class Outcome(NamedTuple):
    """What came of one try."""

    driven: float  # while it should have stood [m]
    held: bool  # whether it held
    well: bool  # whether it went on by itself when the sensor was well


def late_sensor(mission: Mission, robot: str, link: Link, seed: int, lasts: float = LASTS) -> Outcome:
    """Have a robot's own positions come by this link for a while."""
    fleet = Fleet(mission, seed=seed)
    fleet.run(random.Random(seed).uniform(8.0, 10.0))
    fleet.sensors[robot] = link._replace(since=fleet.now)
    fleet.run(GRACE)
    driven, there, end = 0.0, _place(fleet, robot), fleet.now + lasts - GRACE
    held = False
    while fleet.now < end:
        fleet.run(0.05)
        here = _place(fleet, robot)
        driven, there = driven + abs(here - there), here
        held |= fleet.agents[robot].decision.state is not AgentState.RUN
    fleet.sensors.clear()
    fleet.run(BACK)
    return Outcome(driven, held, fleet.agents[robot].decision.state is AgentState.RUN)


def dead_leader(mission: Mission, link: Link, seed: int, lasts: float = 4.0) -> float:
    """How long after the leader's death all hold whose links have been this bad for `lasts` [s]."""
    fleet = Fleet(mission, seed=seed)
    fleet.run(random.Random(seed).uniform(8.0, 10.0))
    for one, other in product(("leader", *mission.followers), mission.followers):
        fleet.links[one, other] = link._replace(since=fleet.now)
    fleet.run(lasts)
    fleet.kill("leader")
    began = last = fleet.now
    while fleet.now < began + 30.0:
        fleet.run(0.05)
        if any(agent.decision.state is AgentState.RUN for agent in fleet.agents.values()):
            last = fleet.now
    return last - began


def _place(fleet: Fleet, robot: str) -> complex:
    hosted = fleet.world._hosted[robot]
    hosted.go_to(fleet.now)
    return hosted.control_point


SENSORS: dict[str, Link] = {
    **{f"own positions {late:g} s late": Link(0.0, (late, late)) for late in LATE},
    "own positions later by 1 s/s": Link(0.0, (0.0005, 0.0005), growth=1.0),
}
LINKS: dict[str, Link] = {
    "links later by 1 s/s": Link(0.0, (0.001, 0.002), growth=1.0),
    "links of 3 kB/s": Link(0.0, (0.001, 0.002), bandwidth=3000.0),
}


def main(arguments: list[str]) -> int:
    """Try them all."""
    parser = argparse.ArgumentParser(prog="tests.campaigns.reliability.late", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    seeds = range(parser.parse_args(arguments).seeds)
    wrong = 0
    for name, (words, link) in product(MISSIONS, [*SENSORS.items(), *LINKS.items()]):
        tried = _leader if words in LINKS else _sensor
        tries = [tried(load(name), link, seed) for seed in seeds]
        good, worst = sum(well for well, _ in tries), max(figure for _, figure in tries)
        print(f"{name} | {words} | {good} of {len(tries)} | worst {worst:.3f}", flush=True)
        wrong += len(tries) - good
    return int(wrong > 0)


def _sensor(mission: Mission, link: Link, seed: int) -> tuple[bool, float]:
    robot = random.Random(seed).choice(mission.followers)
    tried = late_sensor(mission, robot, link, seed)
    return tried.well and (not tried.held or tried.driven < FARTHEST), tried.driven if tried.held else 0.0


def _leader(mission: Mission, link: Link, seed: int) -> tuple[bool, float]:
    took = dead_leader(mission, link, seed)
    return took <= BOUNDED, took


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
