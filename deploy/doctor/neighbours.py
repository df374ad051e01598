"""Can the agents be dialled that this one talks with, and do their positions come?"""

from __future__ import annotations

from collections.abc import Iterator

from deploy.doctor.facts import Examination, Facts, Finding, Reached
from formation.transport.wiring import role

SILENT = 1.0
"""[s]; an agent stops for less, but one pause is no illness."""
AGE = "age "
"""How keys of a status begin that tell how long a neighbour has been silent."""
WORDS = {
    "refused": (
        "refuses the connection",
        "the computer is on; does it run there, and listen at that endpoint?",
    ),
    "no route": ("cannot be reached: no route", "is it on, in this network, and is the address right?"),
    "no answer": (
        "does not answer",
        "is it on? a firewall, or client isolation of the access point, looks just the same",
    ),
    "unknown name": ("cannot be reached: nobody knows its name", "use its address in the mission's endpoint"),
    "no TLS": ("does not speak TLS", "its agent runs without its -c file, or something else listens there"),
    "untrusted": (
        "shows a certificate that is not to be trusted",
        "renew it: formation deploy certificates --renew, bundle, push",
    ),
    "turned away": (
        "refuses our certificate",
        "renew ours, or theirs: formation deploy certificates --renew, bundle, push",
    ),
}
"""What an outcome means, and what to do."""


def look(facts: Facts) -> Iterator[Finding]:
    """Everybody who was dialled; and neighbours who can be dialled and yet are not heard."""
    for name, reached in facts.reached.items():
        if reached.outcome != "ok":
            yield _unreachable(facts, name, reached)
        elif reached.name and reached.name != name:
            yield Finding(
                "neighbour-misnamed",
                f"at {reached.endpoint}, where {name} should be, {reached.name} answers",
                "addresses are mixed up: correct the endpoints in the mission",
            )
    for name in () if facts.leads else facts.mission.robots[facts.robot].neighbours:
        reached_well = name not in facts.reached or facts.reached[name].outcome == "ok"
        if facts.said and reached_well and (age := silence(facts, name)) is not None:
            since = "has never been heard" if age < 0 else f"has been silent for {age:.1f} s"
            yield Finding(
                "neighbour-silent",
                f"its neighbour {name} {since}",
                f"examine {name}: formation doctor there",
            )


def well(facts: Facts) -> str:
    """Who was reached."""
    reached = [name for name, one in facts.reached.items() if one.outcome == "ok"]
    if not reached:
        return ""
    if not facts.on_robot:
        return f"answers at {facts.reached[reached[0]].endpoint}"
    return f"{', '.join(reached)} can be reached"


def silence(facts: Facts, neighbour: str) -> float | None:
    """How long the agent has not heard a neighbour [s]: negative for never, None where it is fresh."""
    age = facts.said.values.get(AGE + neighbour) if facts.said else None
    try:
        seconds = -1.0 if age is None else float(age)
    except ValueError:
        return None
    return seconds if seconds < 0.0 or seconds > SILENT else None


def _unreachable(facts: Facts, name: str, reached: Reached) -> Finding:
    sentence, remedy = WORDS[reached.outcome]
    said = f" ({reached.said})" if reached.said and reached.outcome in {"untrusted", "turned away"} else ""
    whose = {"agent": f"{name}'s agent", "leader": "the leader", "standby": f"the standby {name}"}
    kind = role(facts.mission, name)
    who = "its agent" if name == facts.robot and kind == "agent" else whose[kind]
    return Finding("unreachable", f"{who} at {reached.endpoint} {sentence}{said}", remedy)


NEIGHBOURS = Examination("network", look, well)
