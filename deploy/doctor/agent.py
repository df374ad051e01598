"""Examine the processes: one agent with the right mission, a leader, and that all are reached."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from formation.deploy.doctor.facts import Examination, Facts, Finding, Reached
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from formation.protocol.status_codec import sentence
from formation.topics import POSITION
from formation.transport.wiring import role

Sign = tuple[float, float]
"""Arrival [s, monotonic], and the stated time since the agent's start [s]."""
MIN_UPTIME_DROPS = 3
"""Drops of the time since the start that prove two agents; one agent may restart meanwhile."""
MAX_SILENCE = 1.0
"""Silence from which on it is a fault [s]. An agent stops for less, but one pause is normal."""
NO_FAULT = frozenset(
    {
        Code.STARTED, Code.STOPPED_BY_OPERATOR, Code.HELD_BY_OPERATOR, Code.STOPPED_BEFORE_START,
        Code.HELD_BEFORE_START, Code.NO_ORDER, Code.STOPPED_BY_LEADER, Code.HELD_BY_LEADER,
    }
)  # fmt: skip
"""Reasons of a robot that stands as it was ordered to."""
REPORTED = frozenset(
    {
        Code.NO_LINK, Code.NO_LISTENER, Code.SECOND_AGENT, Code.OTHER_MISSION, Code.UNKNOWN_MISSION,
        Code.SIGHT_SEARCHING, Code.SIGHT_PLACING, Code.SIGHT_CONTRADICTED, Code.SIGHT_LOST,
    }
)  # fmt: skip
"""Reasons that another finding reports."""
DIAL_RESULTS = {
    "refused": (
        "refuses the connection",
        "the computer is on: start the process there, or correct its endpoint in the mission",
    ),
    "no route": (
        "cannot be reached: no route",
        "see that it is on and in this network, and that its address is right",
    ),
    "no answer": (
        "does not answer",
        "see that it is on; or let it through the firewall, and end the access point's client isolation",
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


def _agent(facts: Facts) -> Iterator[Finding]:
    silent = facts.status is not None and not facts.status.received
    if facts.status is not None and facts.status.bad:
        yield Finding(
            f"{facts.part}-unreadable",
            f"{len(facts.status.bad)} statuses of its {facts.part} cannot be read: {facts.status.bad[-1]}",
            "it may run another version of formation: formation deploy push installs this one",
        )
    elif silent and not facts.router_error and not _unreached(facts):
        yield Finding(
            f"{facts.part}-silent",
            f"its {facts.part} says nothing: no status in {facts.seconds:g} s",
            _how_to_start(facts),
        )
    elif facts.status is not None and facts.status.received:
        silence = facts.ended - facts.status.received[-1].arrived
        if silence > MAX_SILENCE:
            yield Finding(
                f"{facts.part}-silent",
                f"its {facts.part} fell silent: newest status {silence:.1f} s old; limit {MAX_SILENCE:g} s",
                _how_to_start(facts),
            )
    if (
        facts.agent is not None
        and facts.agent.state is not AgentState.RUN
        and facts.agent.reason.code not in NO_FAULT | REPORTED
    ):
        yield Finding(
            "agent-stands",
            f"its agent says {sentence(facts.agent)}",
            "see docs/guide/when-something-fails.md, what fails and what you do",
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


def _how_to_start(facts: Facts) -> str:
    unit = f"formation-{facts.part}"
    return f"start it there: sudo systemctl restart {unit}; its log: journalctl -u {unit}"


def _agent_seen(facts: Facts) -> str:
    return f"says {sentence(facts.newest_status)}" if facts.newest_status else ""


def _refusals(facts: Facts) -> Iterator[Finding]:
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


def _refusals_seen(facts: Facts) -> str:
    return "none" if facts.newest_status and not facts.leads else ""


def _mission(facts: Facts) -> Iterator[Finding]:
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


def _mission_seen(facts: Facts) -> str:
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


def _leader(facts: Facts) -> Iterator[Finding]:
    if facts.leading == ():
        candidates = ", ".join(facts.mission.candidates)
        yield Finding(
            "no-leader",
            f"no leader: none of {candidates} says that it does",
            "start one; one that runs must be linked with more than half of the followers",
        )


def _leader_seen(facts: Facts) -> str:
    # if a takeover happened while listening, the earlier leader may be included
    return f"{' and '.join(facts.leading)} said that it leads" if facts.leading else ""


def _network(facts: Facts) -> Iterator[Finding]:
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
        if facts.newest_status and reached_well and (age := _silence(facts, name)) is not None:
            since = "has never been received" if age < 0 else f"has been silent for {age:.1f} s"
            refused = facts.agent.dropped_last.get(POSITION.key(name)) if facts.agent else None
            yield Finding(
                "neighbour-silent",
                f"its neighbour {name} {since}" + (f"; newest refusal: {refused}" if refused else ""),
                f"examine {name}: formation doctor there",
            )


def _network_seen(facts: Facts) -> str:
    reached = [name for name, one in facts.reached.items() if one.outcome == "ok"]
    if not reached:
        return ""
    if not facts.on_robot:
        return f"answers at {facts.reached[reached[0]].endpoint}"
    return f"{', '.join(reached)} can be reached"


def _silence(facts: Facts, neighbour: str) -> float | None:
    """Return how long nothing has come from a neighbour [s]: negative for never, None if it is fresh."""
    seconds = facts.agent.age.get(neighbour, -1.0) if facts.agent else -1.0
    return seconds if seconds < 0.0 or seconds > MAX_SILENCE else None


def _unreachable(facts: Facts, name: str, reached: Reached) -> Finding:
    sentence, remedy = DIAL_RESULTS[reached.outcome]
    detail = (
        f" ({reached.detail})" if reached.detail and reached.outcome in {"untrusted", "turned away"} else ""
    )
    titles = {"agent": f"{name}'s agent", "leader": "the leader", "standby": f"the standby {name}"}
    kind = role(facts.mission, name)
    title = "its agent" if name == facts.robot and kind == "agent" else titles[kind]
    return Finding("unreachable", f"{title} at {reached.endpoint} {sentence}{detail}", remedy)


AGENT = Examination("agent", _agent, _agent_seen)
MISSION = Examination("mission", _mission, _mission_seen)
LEADING = Examination("leader", _leader, _leader_seen)
NEIGHBOURS = Examination("network", _network, _network_seen)
REFUSALS = Examination("refusals", _refusals, _refusals_seen)
