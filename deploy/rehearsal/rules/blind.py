"""Rule of blind robots: with a frozen or late position they drive less than `MAX_BLIND_PATH`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from formation.agent.simulated.faults import Fault
from formation.control.tracker import MAX_DELAY
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.rules.places import Tell
from formation.mission.model import Mission
from formation.protocol.lateness import LATE_GAIN, own_age_limit

BLIND = frozenset(("frozen", "tremble", "stutter", "stale", "backlog"))
"""Kinds of faults under which a robot's position is frozen or late.

Not ``restamped``: without stamps only a changing speed shows a delay, so a robot may drive on until then.
"""
GRACE_DISTANCE, GRACE_TIME = 0.035, 1.0
"""So far [m] such a robot is away before it can notice, and so long after that [s] its path does not count.

The distance is `still_min` of the motion check: one that creeps in its slot is noticed once it leaves.
"""
MAX_BLIND_PATH = 0.1
"""Path of such a robot that breaks the rule [m]."""


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
    """`GRACE_TIME` after it was `GRACE_DISTANCE` away from there [s]."""
    origin: complex | None = None
    """Its true position at the first check [m]."""
    path: float = 0.0
    """Its true path from `counts_from` on [m]."""

    def drove_on(self, here: complex, now: float) -> bool:
        """Update with its true position [m] at `now` [s]; return whether it drove `MAX_BLIND_PATH`."""
        if not self.since <= now <= self.until:
            return False
        step = 0.0 if self.at is None else abs(here - self.at)
        self.at = here
        if now > self.counts_from:
            self.path += step
            return self.path >= MAX_BLIND_PATH
        self.origin = here if self.origin is None else self.origin
        if abs(here - self.origin) > GRACE_DISTANCE:
            self.counts_from = min(self.counts_from, now + GRACE_TIME)
        return False


class BlindPaths:
    """How far the robots of one fleet drive while their positions are frozen or late."""

    def __init__(self, fleet: Fleet, faults: Sequence[Fault], tell: Tell) -> None:
        self._fleet, self._tell = fleet, tell
        self._blind = blind_faults(fleet.mission, faults)

    @property
    def longest(self) -> float:
        """The longest of these paths [m]."""
        return max((one.path for one in self._blind), default=0.0)

    def look(self) -> None:
        """Check every such robot; call this often."""
        for one in self._blind:
            name, kind = one.fault.robot, one.fault.kind
            world, _ = self._fleet.robots[name]
            if one.drove_on(world.plant(name).position, self._fleet.engine.now):
                self._tell("blind", name, f"{one.path:.2f} m with {kind} since {one.since:g} s")


def blind_faults(mission: Mission, faults: Iterable[Fault]) -> list[Blind]:
    """Return those of `faults` that are of `BLIND`, except of robots that are carried as well."""
    faults = list(faults)
    carried = {one.robot for one in faults if one.kind == "carried"}
    blind = [one for one in faults if one.kind in BLIND and one.robot not in carried]
    return [
        Blind(one, max(_since(mission, one), _hidden_until(mission, one, blind)), one.since + one.lasts)
        for one in blind
    ]


def _hidden_until(mission: Mission, fault: Fault, others: Iterable[Fault]) -> float:
    """Return when earlier faults of its robot end, which are noticed instead of `fault` [s]."""
    earlier = [one for one in others if one.robot == fault.robot and one.since < fault.since]
    judged = [one for one in earlier if _since(mission, one) < math.inf]
    return max((one.since + one.lasts for one in judged), default=0.0)


def _since(mission: Mission, fault: Fault) -> float:
    """Return when the position of a robot with `fault` counts as wrong or too late [s]; infinite if never."""
    spec, gains = mission.robots[fault.robot], mission.gains
    law = mission.law.controller
    degree, k_p = law.degree(len(spec.neighbours)), min(gains.k_p, LATE_GAIN) if law.mean else gains.k_p
    limit = own_age_limit(degree, k_p, gains.k_i, spec.rate, MAX_DELAY)
    if fault.kind == "stale":
        return fault.since if fault.size > limit else math.inf
    if fault.kind == "stutter":  # one burst and one gap are needed to see that it is frozen
        return fault.since + 2.0 * fault.size
    if fault.kind == "backlog":  # what was measured after t seconds arrives after (1 + SIZE) t
        return fault.since + limit * (1.0 + fault.size) / fault.size if fault.size > 0.0 else math.inf
    return fault.since
