"""One try: wait until all is well, do it, watch, undo it, wait until all is well again; and judge."""

from __future__ import annotations

import random
import time
from dataclasses import asdict, dataclass, field
from typing import Any

from tests.campaigns.reliability import judge
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.rows import Row
from tests.campaigns.reliability.seen import window
from tests.campaigns.reliability.verdicts import Times

PATIENCE = 45.0
"""For the formation to stand again [s]."""
BEFORE = 0.5
"""So much of what was before a fault is judged with it [s]."""
MOMENT = 1.0
"""A fault comes at any moment of so long after all is well [s]."""


@dataclass
class Try:
    """What came of one."""

    row: str
    wrong: list[str] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)
    """Times by name [s]."""
    peak: float = 0.0
    jump: float = 0.0
    """Shares of a limit."""
    zeros: int = 0
    settles: float | None = None
    """After the fault was undone, or began if nothing has to be [s]."""
    error: float | None = None
    """At the end [m]."""
    curve: list[list[float]] = field(default_factory=list)
    """Error over time from the fault on [s; m]."""

    def as_json(self) -> dict[str, Any]:
        """For a file."""
        return asdict(self)


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
    ended = fleet.lost()
    one.wrong += [f"{name} ended" for name in ended]
    whole = judge.grid(times.begin - BEFORE, seen.now)
    errors = seen.errors(whole)
    one.error = float(errors[-1])
    one.curve = [
        [round(float(t - times.begin), 2), round(float(e), 5)] for t, e in zip(whole, errors, strict=True)
    ][::2]
    return one
