"""Faults of elections at random moments, on the fake clock: never two leaders, no robot held for ever.

python -m tests.campaigns.timings.elections [--timings 1000]     exit code 1 on a failure
"""

from __future__ import annotations

import argparse
import random
import sys
from collections import Counter
from collections.abc import Callable, Iterator

from formation.agent.core import Agent
from formation.leader.core import Leader
from formation.mission.file import parse
from formation.mission.model import Mission
from formation.protocol.election import TERM_EXPIRY_TIME, quarantine
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from tests.support.fleet import Fleet
from tests.support.missions import row_of_three
from tests.unit.leader.team import MISSION, TICK, TWIN, Team

DAY, HOUR = 86_400.0, 3_600.0
"""[s]"""
ERRORS = (0.0, HOUR, -HOUR, 11 * HOUR, 13 * HOUR, -13 * HOUR, DAY - 1.0, DAY, DAY + HOUR, -DAY - HOUR)
"""Of clocks [s]."""
CHAIN = row_of_three("chain", rate=10, speed=0.2)
FAR = CHAIN.replace("b = [-2.0, 0.0]", "b = [-2.0, 3.0]")
"""The same team, with another place for b."""
CREPT = 0.01
"""A robot that holds since it started has not come further [m]."""


class FailureError(Exception):
    """What must not happen has happened."""


def two_agents(seed: int) -> Iterator[str]:
    """A second agent for a robot, anywhere in a network that is cut in two at any moment.

    The team itself fails as soon as two leaders are in lease at once.
    """
    draw, team = random.Random(seed), Team(seed)
    doubled = draw.choice(MISSION.followers)
    readonly = draw.random() < 0.3
    team.run(draw.uniform(0.0, 8.0))
    others = [name for name in MISSION.followers if name != doubled]
    candidates, agents = list(MISSION.candidates), [doubled, doubled + TWIN]
    for names in (others, candidates, agents):
        draw.shuffle(names)
    half = {candidates[0], others[0], agents[0]}
    if draw.random() < 0.5:
        half.add(candidates[1])
    team.twin(doubled, readonly=readonly)
    cut_first = draw.random() < 0.5
    for cuts in (cut_first, not cut_first):
        if cuts:
            _cut(team, half)
        team.run(draw.uniform(0.0, 6.0))
    for _ in range(draw.randint(0, 3)):  # neither patience nor a steady process may be what keeps them apart
        name = draw.choice(agents)
        if draw.random() < 0.5:
            team.processes[name].frozen = True
        team.run(draw.uniform(0.0, 3.0))
        for candidate in MISSION.candidates:
            team.stand(candidate)
        team.thaw(name)
        team.run(draw.uniform(0.0, 3.0))
    yield "readonly" if readonly else "commanding"
    team.heal()
    team.processes[doubled + TWIN].alive = False
    yield from _agrees(team, quarantine(MISSION) + 4.0 * MISSION.takeover)


def wrong_clocks(seed: int) -> Iterator[str]:
    """Clocks up to a day and more off, leaders that come back with another clock; then all are set right."""
    draw = random.Random(seed)
    mission = MISSION if draw.random() < 0.5 else ALONE
    team = Team(seed, mission)
    team.keeps = draw.random() < 0.5
    names = [*mission.candidates, *mission.followers]
    for name in names:
        if draw.random() < 0.4:
            team.processes[name].wrong = draw.choice(ERRORS)
    _clock_of_the_leader(team, draw)
    for _ in range(draw.randint(1, 6)):
        team.run(draw.uniform(0.0, 8.0))
        _disturb(team, draw, draw.choice(names))
    yield "with standbys" if mission.standbys else "alone"
    team.run(draw.uniform(0.0, 8.0))
    team.heal()
    yield from _agrees(team, 2.0 * TERM_EXPIRY_TIME * mission.takeover + 6.0 * mission.takeover)


def _clock_of_the_leader(team: Team, draw: random.Random) -> None:
    match draw.choice(("ahead", "slow", "any")):
        case "ahead":  # refused from its first beat on
            team.processes["led"].wrong = DAY + draw.uniform(1.0, HOUR)
        case "slow":  # as some robots that have forgotten everything see it, and others that have not
            team.run(draw.uniform(3.0, 8.0))
            team.processes["led"].wrong -= HOUR
            for name in ["led", *draw.sample(team.mission.followers, 2)]:
                team.restart(name)
            team.run(draw.uniform(0.0, 3.0))


def _disturb(team: Team, draw: random.Random, name: str) -> None:
    match draw.choice(("restart", "clock", "set", "cut", "join", "dead")):
        case "restart":
            team.restart(name)
        case "clock":
            team.processes[name].wrong = draw.choice(ERRORS)
        case "set":
            team.processes[name].wrong = 0.0
        case "cut":
            _cut(team, set(draw.sample(list(team.processes), 2)))
        case "join":
            team.cuts.clear()
        case "dead":
            team.processes[name].alive = False


def mixed_missions(seed: int) -> Iterator[str]:
    """Some processes run another mission, from the start or by a restart; then all are given the same one."""
    draw = random.Random(seed)
    fleet = Mixed(parse(CHAIN), seed=seed)
    others = draw.sample(["leader", "a", "b", "c"], draw.randint(1, 3))
    if at_start := draw.random() < 0.5:
        fleet.gives(others)
    else:
        fleet.run(draw.uniform(3.0, 6.0))
        for name in others:
            fleet.run(draw.uniform(0.0, 0.5))
            fleet.gives([name])
    fleet.run(2.0)
    before = fleet.points()
    fleet.run(draw.uniform(2.0, 5.0))
    for index, (name, measured) in enumerate(MEASURES.items(), 1):
        mixed = [one for one in measured if (one in others) != (name in others)]
        if not mixed:
            continue
        agent = fleet.agents[name]
        if agent.decision.state is AgentState.RUN:
            raise FailureError(f"{name} runs beside {mixed[0]} of another mission")
        reason = agent.decision.reason
        tags = {reason.values.get("theirs"), reason.values.get("ours")}
        if reason.code is not Code.OTHER_MISSION or tags != {FAR_TAG, NEAR_TAG}:
            raise FailureError(f"{name} holds: {reason}")
        came = abs(fleet.points()[index] - before[index])
        if came > CREPT:
            raise FailureError(f"{name} came {came:.3f} m beside {mixed[0]} of another mission")
    yield "from the start" if at_start else "while driving"
    fleet.other.clear()
    for name in others:
        fleet.run(draw.uniform(0.0, 0.5))
        fleet.restart(name)
    fleet.run(4.0)
    decided = {name: agent.decision for name, agent in fleet.agents.items()}
    if held := {name: one for name, one in decided.items() if one.state is not AgentState.RUN}:
        raise FailureError(f"still held after the push: {held}")
    yield "goes on"


class Mixed(Fleet):
    """A fleet in which some processes run another mission."""

    def __post_init__(self) -> None:
        self.other: set[str] = set()
        super().__post_init__()

    def gives(self, names: list[str]) -> None:
        """Start these anew with the other mission."""
        self.other |= set(names)
        for name in names:
            self.restart(name)

    def new_agent(self, name: str) -> Agent:
        return Agent(self._of(name), name, publisher_id=next(self.publisher_ids))

    def new_leader(self, name: str) -> Leader:
        return Leader(self._of(name), publisher_id=next(self.publisher_ids))

    def _of(self, name: str) -> Mission:
        return parse(FAR) if name in self.other else self.mission


MEASURES = {"a": ("leader",), "b": ("a",), "c": ("b", "a")}
ALONE = Mission.model_validate(
    {**MISSION.model_dump(), "standbys": {}}
)  # a copy would keep its cached candidates
NEAR_TAG, FAR_TAG = parse(CHAIN).tag, parse(FAR).tag
SCENARIOS: dict[str, Callable[[int], Iterator[str]]] = {
    "two agents": two_agents,
    "mixed missions": mixed_missions,
    "wrong clocks": wrong_clocks,
}


def _cut(team: Team, half: set[str]) -> None:
    across = {(one, other) for one in half for other in team.processes if other not in half}
    team.cuts |= across | {(other, one) for one, other in across}


def _agrees(team: Team, within: float) -> Iterator[str]:
    """Fail unless one leads and all obey within so long [s]."""
    begun = team.true
    while not team.agreed:
        if team.true - begun > within:
            raise FailureError(f"no agreement within {within:.1f} s: {team.leaders} lead")
        team.run(5 * TICK)
    yield f"agreed within {10 * (1 + (team.true - begun) // 10):.0f} s"


def judged(scenario: str, seed: int) -> tuple[list[str], str]:
    """What a scenario came to, and why it failed; empty if it did not."""
    seen: list[str] = []
    try:
        seen.extend(SCENARIOS[scenario](seed))
    except (AssertionError, FailureError) as failure:
        return seen, str(failure) or "failed"
    return seen, ""


def main() -> int:
    flags = argparse.ArgumentParser(prog="tests.campaigns.timings.elections", description=__doc__)
    flags.add_argument("--timings", type=int, default=1000)
    timings, failures = flags.parse_args().timings, 0
    for scenario in SCENARIOS:
        seen: Counter[str] = Counter()
        failed: dict[int, str] = {}
        for seed in range(timings):
            events, why = judged(scenario, seed)
            seen.update(events)
            if why:
                failed[seed] = why
        print(f"{scenario}: {timings - len(failed)} of {timings} well; {dict(seen)}", flush=True)
        for seed, why in list(failed.items())[:10]:
            print(f"  seed {seed}: {why}", flush=True)
        failures += len(failed)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
