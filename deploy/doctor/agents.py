"""Check that the robot has exactly one agent, with the right mission, and list its refusals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from formation.deploy.doctor.facts import Examination, Facts, Finding
from formation.protocol.status_codec import sentence

Sign = tuple[float, float]
"""Arrival [s, monotonic], and the stated time since the agent's start [s]."""
MIN_UPTIME_DROPS = 3
"""Drops of the time since the start that prove two agents; one agent may restart meanwhile."""


def look(facts: Facts) -> Iterator[Finding]:
    """Yield findings: a silent agent, or more than one."""
    quiet = facts.status is not None and not facts.status.received
    if facts.status is not None and facts.status.bad:
        yield Finding(
            f"{facts.part}-unreadable",
            f"{len(facts.status.bad)} statuses of its {facts.part} cannot be read: {facts.status.bad[-1]}",
            "does it run another version of formation? push this one: formation deploy push",
        )
    elif quiet and not facts.router_trouble and not _unreached(facts):
        yield Finding(
            f"{facts.part}-silent",
            f"its {facts.part} says nothing: no status in {facts.seconds:g} s",
            f"is it running? systemctl status formation-{facts.part} there",
        )
    ages = two_ages(facts.alive or ())
    if ages is not None:
        yield Finding(
            "agents-two",
            f"two agents command this robot: one runs for {ages[0]:.0f} s, one for {ages[1]:.0f} s",
            "end one of them: ps ax | grep 'formation agent' on this robot and on others",
        )
    elif facts.doubled:
        yield Finding(
            "agents-two",
            f"{', '.join(facts.doubled)} receives its positions from two agents",
            "end one of them; the second is not believed, but whichever started first is",
        )


def well(facts: Facts) -> str:
    """Return the agent's state."""
    return f"says {sentence(facts.newest_status)}" if facts.newest_status else ""


def refusals(facts: Facts) -> Iterator[Finding]:
    """Yield the processes that the agent refused: they tried what they may not do."""
    for kind, count in (facts.agent.refused if facts.agent else {}).items():
        yield Finding(
            "refused",
            f"its agent has refused {count} times: {kind}",
            "find that process: an old certificate, a wrong mission, or an intruder",
        )
    for name in facts.agent.contested if facts.agent else ():
        yield Finding(
            "neighbour-doubled", f"it receives positions of {name} from two agents", f"end one of {name}'s"
        )


def refusals_well(facts: Facts) -> str:
    """Return that there are none."""
    return "none" if facts.newest_status and not facts.leads else ""


def mission(facts: Facts) -> Iterator[Finding]:
    """Yield findings if the running or the installed mission is not the given one."""
    theirs = facts.newest_status.mission if facts.newest_status else ""
    if theirs and theirs != facts.mission.fingerprint:
        yield Finding(
            "mission-other",
            f"its {facts.part} was started with another mission than this one",
            "restart it if the right one is installed; else push that",
        )
    for name, tag in facts.newest_status.other_mission.items() if facts.newest_status else ():
        yield Finding(
            "mission-mixed",
            f"{name} runs mission {tag or 'unknown'}, its {facts.part} {facts.mission.tag}",
            "give all the same one: formation deploy push",
        )
    if facts.installed_differs:
        yield Finding(
            "mission-differs",
            f"the mission in {facts.installed_differs} is not the one that you gave",
            "push it: formation deploy bundle, formation deploy push",
        )


def mission_well(facts: Facts) -> str:
    """Return that it is the given one."""
    seen = ["the one that is installed"] if facts.installed_differs == "" else []
    if facts.newest_status and facts.newest_status.mission == facts.mission.fingerprint:
        seen.append(f"{facts.part} runs it")
    return ", ".join(seen)


def two_ages(signs: Sequence[Sign]) -> tuple[float, float] | None:
    """Return the running times of two agents with mixed signs of life [s], the older first; else None.

    Those of one agent come in order, so its time falls only at a restart: once, not repeatedly.
    """
    ages = [value for _, value in signs if value >= 0.0]  # the last sign is negative
    falls = [(before, after) for before, after in pairwise(ages) if after < before]
    return falls[-1] if len(falls) >= MIN_UPTIME_DROPS else None


def _unreached(facts: Facts) -> bool:
    """Return whether, at the desk, the agent could not be dialled, which is reported elsewhere."""
    reached = facts.reached.get(facts.robot)
    return reached is not None and reached.outcome != "ok"


AGENT = Examination("agent", look, well)
REFUSALS = Examination("refusals", refusals, refusals_well)
MISSION = Examination("mission", mission, mission_well)
