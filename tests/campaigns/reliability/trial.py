"""One try: wait until all is well, do it, watch, undo it, wait until all is well again; and judge."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from formation.mission.model import Mission
from formation.monitor.recording.reader import UnreadableError, read
from tests.campaigns.reliability import judge
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.seen import window

STANDS = 0.3  # a robot without an agent stands within that [s]
AWAY = 2.0  # how long a process is dead, stopped or unplugged [s]: longer than any limit of the failure table
SLACK = 0.5  # more than the mission's `takeover` that a takeover may take: the first beat has to arrive [s]
READABLE = 1.0  # of a recording that was cut, so much may be missing [s]
PATIENCE = 45.0  # for the formation to stand again [s]
BEFORE = 0.5  # so much of what was before a fault is judged with it [s]
MOMENT = 1.0  # a fault comes at any moment of so long after all is well [s]


class Times(NamedTuple):
    """When it happened [s, monotonic]."""

    begin: float
    end: float


class Judgement(NamedTuple):
    """What came of it."""

    figures: dict[str, float]  # by name [s]
    wrong: list[str]


Verdict = Callable[[Fleet, str, Times], Judgement]  # of a fleet, the process that it happened to, and when


def anything(_fleet: Fleet, _victim: str, _times: Times) -> Judgement:
    """What holds for every fault is enough."""
    return Judgement({}, [])


def stands(fleet: Fleet, victim: str, times: Times) -> Judgement:
    """The robot of an agent stands in time; whoever does not need it goes on, whoever does holds."""
    robot = victim.rpartition(" ")[2]
    after = judge.stood(fleet.seen.commands[robot], *times)
    wrong = [] if after is not None and after <= STANDS else [f"{robot} stood after {after} s"]
    holding = holders(fleet.mission, (robot,))
    for name in (name for name in fleet.followers if name != robot):
        commands = fleet.seen.commands[name]
        if name not in holding and not judge.went_on(commands, *times):
            wrong.append(f"{name} did not go on without {robot}")
        if name in holding and judge.stood(commands, *times) is None:
            wrong.append(f"{name} did not hold, though none is left that it follows")
    return Judgement({} if after is None else {"stands": after}, wrong)


def holders(mission: Mission, lost: Iterable[str]) -> set[str]:
    """Robots that have none left to follow when these are lost."""
    gone, before = set(lost), set[str]()
    while gone != before:
        before = gone
        gone = gone | {name for name in mission.followers if gone >= set(mission.robots[name].measurable)}
    return gone - set(lost)


def replaced(fleet: Fleet, _victim: str, times: Times) -> Judgement:
    """A standby leads in time; without one all hold."""
    mission = fleet.mission
    if not mission.standbys:
        after = {name: judge.stood(fleet.seen.commands[name], *times) for name in fleet.followers}
        late = [name for name, one in after.items() if one is None or one > 1.5]
        return Judgement({}, [f"{name} did not hold without a leader" for name in late])
    found = judge.taken_over(window(fleet.seen.leads, times.begin - 5.0), times.begin)
    if found is None or times.begin + found > times.end + mission.takeover:
        return Judgement({}, ["no process took the leader's place"])
    wrong = [] if found <= mission.takeover + SLACK else [f"a standby led after {found:.2f} s only"]
    return Judgement({"takes over": found}, wrong)


def unmoved(fleet: Fleet, _victim: str, times: Times) -> Judgement:
    """Nothing moves differently."""
    wrong = [
        f"{name} did not go on"
        for name in fleet.followers
        if not judge.went_on(fleet.seen.commands[name], *times)
    ]
    worst = float(fleet.seen.errors(judge.grid(*times)).max())
    if worst >= judge.NEAR:
        wrong.append(f"the error rose to {worst * 100:.1f} cm")
    return Judgement({}, wrong)


def recorded(fleet: Fleet, victim: str, times: Times) -> Judgement:
    """Besides, what the killed monitor recorded can be read up to its end."""
    found = unmoved(fleet, victim, times)
    path = fleet.former_recording
    try:
        last = max((one.wall for one in read(path).messages()), default=0.0)
    except UnreadableError as error:
        return Judgement(found.figures, [*found.wrong, str(error)])
    missing = times.begin + (time.time() - time.monotonic()) - last
    wrong = [] if missing <= READABLE else [f"the last {missing:.2f} s of the recording are lost"]
    return Judgement({**found.figures, "not recorded": max(missing, 0.0)}, [*found.wrong, *wrong])


Act = Callable[[Fleet, str], object]  # does something to a process of a fleet


class Row(NamedTuple):
    """One kind of fault."""

    name: str  # on the command line
    title: str
    begin: Act
    end: Act = lambda _fleet, _victim: None
    victim: Callable[[Fleet], str] = lambda _: ""  # the process that it happens to, asked for when it does
    verdict: Verdict = anything
    lasts: float = AWAY  # between `begin` and `end` [s]
    heals: bool = False
    """Whether all is to be well again without anything undone, so that time counts from `begin`."""


@dataclass
class Try:
    """What came of one."""

    row: str
    wrong: list[str] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)  # times by name [s]
    peak: float = 0.0
    jump: float = 0.0  # shares of a limit
    zeros: int = 0
    settles: float | None = None  # after the fault was undone, or began if nothing has to be [s]
    error: float | None = None  # at the end [m]
    curve: list[list[float]] = field(default_factory=list)  # error over time from the fault on [s; m]


class Lost(Exception):  # noqa: N818 - it is the fleet that is
    """The fleet did not come to rest before a try: it has to be made anew."""


def attempt(fleet: Fleet, row: Row, patience: float = PATIENCE) -> Try:
    """Try it once; the formation has so long to stand again [s]. Raises Lost."""
    fleet.seen.forget(time.monotonic() - 10.0)
    if not fleet.settles(PATIENCE):
        raise Lost(f"{fleet.error(0.1)} m; ended: {fleet.lost()}")
    time.sleep(random.uniform(0.0, MOMENT))
    begin = time.monotonic()
    victim = row.victim(fleet)
    row.begin(fleet, victim)
    time.sleep(max(0.0, row.lasts - (time.monotonic() - begin)))
    end = time.monotonic()
    row.end(fleet, victim)
    well = fleet.settles(patience, since=end)
    return judged(fleet, row, victim, Times(begin, end), well=well)


def judged(fleet: Fleet, row: Row, victim: str, times: Times, *, well: bool) -> Try:
    """The verdict on what was seen."""
    seen = fleet.seen
    found = row.verdict(fleet, victim, times)
    motion = judge.motion(seen, times.begin - BEFORE)
    one = Try(row.name, [*judge.faults(motion), *found.wrong], dict(found.figures), *motion)
    since = times.begin if row.heals and fleet.mission.standbys else times.end
    after = judge.grid(since, seen.now)
    settled = judge.settled_at(after, seen.errors(after))
    if settled is None and well:  # it has just stood for a second, by the grid that was waited by
        last = judge.grid(times.end, seen.now)
        settled = judge.settled_at(last, seen.errors(last))
    if settled is None or not well:
        one.wrong.append("the error did not come back")
    else:
        one.settles = settled - since
    for a, b in judge.rivals(window(seen.leads, times.begin - BEFORE)):
        one.wrong.append(f"two led at once: {a.publisher_id} in {a.term} and {b.publisher_id} in {b.term}")
    one.wrong += [f"{name} ended" for name in fleet.lost()]
    whole = judge.grid(times.begin - BEFORE, seen.now)
    errors = seen.errors(whole)
    one.error = float(errors[-1])
    one.curve = [
        [round(float(t - times.begin), 2), round(float(e), 5)] for t, e in zip(whole, errors, strict=True)
    ][::2]
    return one
