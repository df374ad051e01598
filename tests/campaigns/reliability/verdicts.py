"""What must come of a fault while it lasts, by the failure table; by what was seen, and nobody's word."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import NamedTuple

from formation.mission.model import Mission
from formation.monitor.recording.reader import UnreadableError, read
from tests.campaigns.reliability import judge
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.seen import window

STANDS = 0.3
"""A robot without an agent stands within that [s]."""
SLACK = 0.5
"""More than the mission's own `takeover` that a takeover may take: the first beat has to arrive [s]."""
READABLE = 1.0
"""Of a recording that was cut, so much may be missing [s]."""


class Times(NamedTuple):
    """When it happened [s, monotonic]."""

    begin: float
    end: float


class Found(NamedTuple):
    """What came of it."""

    figures: dict[str, float]
    """By name [s]."""
    wrong: list[str]


Verdict = Callable[[Fleet, str, Times], Found]
"""Of a fleet, the process that it happened to, and when."""


def anything(_fleet: Fleet, _victim: str, _times: Times) -> Found:
    """What holds for every fault is enough."""
    return Found({}, [])


def stands(fleet: Fleet, victim: str, times: Times) -> Found:
    """The robot of an agent stands in time; whoever does not need it goes on, whoever does holds."""
    robot = victim.rpartition(" ")[2]
    after = judge.stood(fleet.seen.commands[robot], *times)
    wrong = [] if after is not None and after <= STANDS else [f"{robot} stood after {after} s"]
    holding = holders(fleet.mission, (robot,))
    for name in fleet.followers:
        if name == robot:
            continue
        if name not in holding and not judge.went_on(fleet.seen.commands[name], *times):
            wrong.append(f"{name} did not go on without {robot}")
        if name in holding and judge.stood(fleet.seen.commands[name], *times) is None:
            wrong.append(f"{name} did not hold, though nobody is left whom it follows")
    return Found({} if after is None else {"stands": after}, wrong)


def holders(mission: Mission, lost: Iterable[str]) -> set[str]:
    """Who has nobody left to follow when these are lost."""
    gone = set(lost)
    holding: set[str] = set()
    while True:
        more = {
            name
            for name in set(mission.followers) - gone - holding
            if gone | holding >= set(mission.robots[name].measurable)
        }
        if not more:
            return holding
        holding |= more


def replaced(fleet: Fleet, _victim: str, times: Times) -> Found:
    """A standby leads in time; without one all hold."""
    mission = fleet.mission
    if not mission.standbys:
        after = [judge.stood(fleet.seen.commands[name], *times) for name in fleet.followers]
        late = [name for name, one in zip(fleet.followers, after, strict=True) if one is None or one > 1.5]
        return Found({}, [f"{name} did not hold without a leader" for name in late])
    found = judge.taken_over(window(fleet.seen.leads, times.begin - 5.0), times.begin)
    if found is None or times.begin + found > times.end + mission.takeover:
        return Found({}, ["nobody took the leader's place"])
    wrong = [] if found <= mission.takeover + SLACK else [f"a standby led after {found:.2f} s only"]
    return Found({"takes over": found}, wrong)


def unmoved(fleet: Fleet, _victim: str, times: Times) -> Found:
    """Nothing moves differently."""
    wrong = [
        f"{name} did not go on"
        for name in fleet.followers
        if not judge.went_on(fleet.seen.commands[name], *times)
    ]
    worst = float(fleet.seen.errors(judge.grid(*times)).max())
    if worst >= judge.NEAR:
        wrong.append(f"the error rose to {worst * 100:.1f} cm")
    return Found({}, wrong)


def recorded(fleet: Fleet, victim: str, times: Times) -> Found:
    """Besides, what the killed monitor recorded can be read up to its end."""
    found = unmoved(fleet, victim, times)
    path = fleet.former_recording
    try:
        last = max((one.wall for one in read(path).messages()), default=0.0)
    except UnreadableError as error:
        return Found(found.figures, [*found.wrong, str(error)])
    missing = times.begin + (time.time() - time.monotonic()) - last
    wrong = [] if missing <= READABLE else [f"the last {missing:.2f} s of the recording are lost"]
    return Found({**found.figures, "not recorded": max(missing, 0.0)}, [*found.wrong, *wrong])
