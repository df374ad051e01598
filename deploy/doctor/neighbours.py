"""Check that the agents linked with this one can be dialled, and that their positions arrive."""

from __future__ import annotations

from collections.abc import Iterator

from formation.deploy.doctor.facts import Examination, Facts, Finding, Reached
from formation.transport.wiring import role

MAX_SILENCE = 1.0
"""Silence from which on it is a fault [s]. An agent stops for less, but one pause is normal."""
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
    "unknown name": (
        "cannot be reached: its name cannot be resolved",
        "use its address in the mission's endpoint",
    ),
    "no TLS": ("does not use TLS", "its agent runs without its -c file, or something else listens there"),
    "untrusted": (
        "shows a certificate that is not to be trusted",
        "renew it: formation deploy certificates --renew, bundle, push",
    ),
    "turned away": (
        "refuses our certificate",
        "renew ours, or theirs: formation deploy certificates --renew, bundle, push",
    ),
}
"""Meaning of an outcome, and the remedy."""


def look(facts: Facts) -> Iterator[Finding]:
    """Yield findings about dialled agents, and neighbours that can be dialled but send nothing."""
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
        if facts.newest_status and reached_well and (age := silence(facts, name)) is not None:
            since = "has never been received" if age < 0 else f"has been silent for {age:.1f} s"
            yield Finding(
                "neighbour-silent",
                f"its neighbour {name} {since}",
                f"examine {name}: formation doctor there",
            )


def well(facts: Facts) -> str:
    """Return the agents reached."""
    reached = [name for name, one in facts.reached.items() if one.outcome == "ok"]
    if not reached:
        return ""
    if not facts.on_robot:
        return f"answers at {facts.reached[reached[0]].endpoint}"
    return f"{', '.join(reached)} can be reached"


def silence(facts: Facts, neighbour: str) -> float | None:
    """Return how long nothing has come from a neighbour [s]: negative for never, None if it is fresh."""
    seconds = facts.agent.age.get(neighbour, -1.0) if facts.agent else -1.0
    return seconds if seconds < 0.0 or seconds > MAX_SILENCE else None


def _unreachable(facts: Facts, name: str, reached: Reached) -> Finding:
    sentence, remedy = WORDS[reached.outcome]
    detail = (
        f" ({reached.detail})" if reached.detail and reached.outcome in {"untrusted", "turned away"} else ""
    )
    whose = {"agent": f"{name}'s agent", "leader": "the leader", "standby": f"the standby {name}"}
    kind = role(facts.mission, name)
    who = "its agent" if name == facts.robot and kind == "agent" else whose[kind]
    return Finding("unreachable", f"{who} at {reached.endpoint} {sentence}{detail}", remedy)


NEIGHBOURS = Examination("network", look, well)
