"""Is there an agent for the robot, exactly one, with the right mission, and what has it refused?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from deploy.doctor.facts import Examination, Facts, Finding

Sign = tuple[float, float]
"""When it arrived [s, monotonic], and the time since its agent's start that it says [s]."""
FALLS = 3
"""So often the time since the start falls back if there are two; one agent may be started anew meanwhile."""
RUNS = "mission"
"""Key of a status that says with which mission, by its fingerprint, it was started."""
MIXED = "other mission "
"""How keys of a status begin that name a robot of another mission; the value is its tag."""
REFUSED, VOICE = "refused ", "second voice "
"""How keys of a status begin that tell of who was refused, and of two who speak for one robot."""


def look(facts: Facts) -> Iterator[Finding]:
    """Silent, or more than one."""
    quiet = facts.status is not None and not facts.status.heard
    if quiet and not facts.router_trouble and not _unreached(facts):
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
            f"two agents speak for it, as {', '.join(facts.doubled)} hears",
            "end one of them; the second is not believed, but whichever started first is",
        )


def well(facts: Facts) -> str:
    """What it says of itself."""
    return f"says {facts.said.message}" if facts.said else ""


def refusals(facts: Facts) -> Iterator[Finding]:
    """Whom the agent refused: somebody tries what is not his."""
    for key, count in _refused(facts).items():
        yield Finding(
            "refused",
            f"its agent has refused {count} times: {key}",
            "see who that is: an old certificate, a wrong mission, or somebody who does not belong here",
        )
    for key in facts.said.values if facts.said else ():
        if key.startswith(VOICE):
            name = key.removeprefix(VOICE)
            yield Finding(
                "neighbour-doubled", f"it hears two agents speak for {name}", f"end one of {name}'s"
            )


def refusals_well(facts: Facts) -> str:
    """That there are none."""
    return "none" if facts.said and not facts.leads else ""


def mission(facts: Facts) -> Iterator[Finding]:
    """Is the mission that runs, and the one that is installed, the one that was given?"""
    told = facts.said.values.get(RUNS) if facts.said else None
    if told is not None and told != facts.mission.fingerprint:
        yield Finding(
            "mission-other",
            f"its {facts.part} was started with another mission than this one",
            "restart it if the right one is installed; else push that",
        )
    for key, tag in facts.said.values.items() if facts.said else ():
        if key.startswith(MIXED):
            yield Finding(
                "mission-mixed",
                f"{key.removeprefix(MIXED)} runs mission {tag}, its {facts.part} {facts.mission.tag}",
                "give all the same one: formation deploy push",
            )
    if facts.installed_differs:
        yield Finding(
            "mission-differs",
            f"the mission in {facts.installed_differs} is not the one that you gave",
            "push it: formation deploy bundle, formation deploy push",
        )


def mission_well(facts: Facts) -> str:
    """That it is."""
    seen = ["the one that is installed"] if facts.installed_differs == "" else []
    if facts.said and facts.said.values.get(RUNS) == facts.mission.fingerprint:
        seen.append(f"{facts.part} runs it")
    return ", ".join(seen)


def two_ages(signs: Sequence[Sign]) -> tuple[float, float] | None:
    """How long two agents have been running whose signs of life are mixed [s], the older first; else None.

    One agent's come in order, so its time only falls when it is started anew: once, not again and again.
    """
    ages = [value for _, value in signs if value >= 0.0]  # a farewell is below
    falls = [(before, after) for before, after in pairwise(ages) if after < before]
    return falls[-1] if len(falls) >= FALLS else None


def _refused(facts: Facts) -> dict[str, str]:
    values = facts.said.values if facts.said else {}
    return {key.removeprefix(REFUSED): value for key, value in values.items() if key.startswith(REFUSED)}


def _unreached(facts: Facts) -> bool:
    """At the desk: its agent could not even be dialled, which is said elsewhere."""
    reached = facts.reached.get(facts.robot)
    return reached is not None and reached.outcome != "ok"


AGENT = Examination("agent", look, well)
REFUSALS = Examination("refusals", refusals, refusals_well)
MISSION = Examination("mission", mission, mission_well)
