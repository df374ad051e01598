"""How far a robot drives while its position is frozen or late: a rule of rehearsals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from formation.agent.simulated.faults import Fault
from formation.control.tracker import MAX_DELAY
from formation.mission.model import Mission
from formation.protocol.lateness import own_age_limit

BLIND = frozenset(("frozen", "tremble", "stutter", "stale", "backlog"))
"""Kinds of faults under which a robot's position is frozen or late.

Not ``restamped``: without stamps only a changing speed shows a delay, so a robot may drive on until then.
"""
GRACE_TIME = 1.0
"""Time from its first motion until the path of such a robot counts [s]."""
MAX_BLIND_PATH = 0.1
"""Path of such a robot that breaks the rule [m]."""
AT_REST_STEP = 1e-4
"""Motion between two checks up to which a robot stands [m]."""


@dataclass
class Blind:
    """A fault that freezes or delays a position, and how far the robot drove."""

    fault: Fault
    since: float
    """When the position is wrong or late enough to be judged [s]."""
    until: float
    at: complex | None = None
    """Its true position at the newest check [m]."""
    counts_from: float = math.inf
    """`GRACE_TIME` after it first moved since then [s]."""
    path: float = 0.0
    """Its true path from `counts_from` on [m]."""

    def drove_on(self, here: complex, now: float) -> bool:
        """Update with its true position [m] at `now` [s]; return whether it drove `MAX_BLIND_PATH`."""
        if not self.since <= now <= self.until:
            return False
        step = 0.0 if self.at is None else abs(here - self.at)
        self.at = here
        if step > AT_REST_STEP:
            self.counts_from = min(self.counts_from, now + GRACE_TIME)
        if now > self.counts_from:
            self.path += step
        return self.path >= MAX_BLIND_PATH


def found(mission: Mission, faults: Iterable[Fault]) -> list[Blind]:
    """Return those of `faults`, except of robots that are carried as well."""
    faults = list(faults)
    carried = {one.robot for one in faults if one.kind == "carried"}
    return [
        Blind(one, _begin(mission, one), one.since + one.lasts)
        for one in faults
        if one.kind in BLIND and one.robot not in carried
    ]


def _begin(mission: Mission, fault: Fault) -> float:
    """Return when the position of a robot with `fault` counts as wrong or too late [s]; infinite if never."""
    spec, law = mission.robots[fault.robot], mission.law
    limit = own_age_limit(len(spec.neighbours), law.k_p, law.k_i, spec.rate, MAX_DELAY)
    if fault.kind == "stale":
        return fault.since if fault.size > limit else math.inf
    if fault.kind == "stutter":  # one burst and one gap are needed to see that it is frozen
        return fault.since + 2.0 * fault.size
    if fault.kind == "backlog":  # what was measured after t seconds arrives after (1 + SIZE) t
        return fault.since + limit * (1.0 + fault.size) / fault.size if fault.size > 0.0 else math.inf
    return fault.since
