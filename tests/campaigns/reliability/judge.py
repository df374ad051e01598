"""From what was seen to verdicts: pure functions, held by tests that feed them bad traces.

Shares are of a robot's limits: 1.0 is as fast as it may go. A jump is the step from one command at the
wheels to the next one, whoever said them. A step to zero velocity is the failsafe's right, and counted apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from formation.mission.robot import RobotSpec
from tests.campaigns.reliability.seen import Commanded, Floats, Led, Seen, window

NEAR = 0.02  # a formation error that is no longer one [m]
STAYS = 1.0  # so long it has to stay under that [s]
STEP = 0.05  # at which times errors are looked at [s]
OVER = 1.0 + 1e-6  # a share of a limit that is above it
JUMP = 0.5  # largest share of a limit that a command may jump


class Motion(NamedTuple):
    """How a robot, or many, was commanded."""

    peak: float  # largest command, as a share of its limit
    jump: float  # largest jump that was not to zero, as a share of the limit
    zeros: int  # how often a moving robot was told to stand

    @classmethod
    def of(cls, commands: Sequence[Commanded], robot: RobotSpec) -> Motion:
        """How one was commanded."""

        def share(speed: float, turn_rate: float) -> float:
            worst = max(abs(speed) / robot.max_speed, abs(turn_rate) / robot.max_turn_rate)
            return worst if math.isfinite(worst) else math.inf

        jumps = [
            share(b.speed - a.speed, b.turn_rate - a.turn_rate) for a, b in pairwise(commands) if not b.zero
        ]
        return cls(
            max((share(one.speed, one.turn_rate) for one in commands), default=0.0),
            max(jumps, default=0.0),
            sum(b.zero and not a.zero for a, b in pairwise(commands)),
        )

    @classmethod
    def worst(cls, motions: Iterable[Motion]) -> Motion:
        """Of many."""
        peaks, jumps, zeros = zip(*motions, strict=True)
        return cls(max(peaks), max(jumps), sum(zeros))


def motion(seen: Seen, since: float, until: float = math.inf) -> Motion:
    """Of all robots in a time [s, monotonic]."""
    robots = seen.mission.robots
    return Motion.worst(
        Motion.of(window(seen.commands[name], since, until), robots[name]) for name in seen.mission.followers
    )


def faults(motion: Motion) -> list[str]:
    """What of it must not be."""
    found = []
    if motion.peak > OVER:
        found.append(f"a command was {100 * motion.peak:.1f} % of a limit")
    if motion.jump > JUMP:
        found.append(f"a command jumped by {100 * motion.jump:.0f} % of a limit")
    return found


def settled_at(times: Floats, errors: Floats, near: float = NEAR, stays: float = STAYS) -> float | None:
    """The first of `times` from which on the error stayed under `near` for so long; None if there is none."""
    start: float | None = None
    for at, error in zip(times.tolist(), errors.tolist(), strict=True):
        if not error < near:
            start = None
        elif start is None:
            start = at
        if start is not None and at - start >= stays - 1e-9:
            return start
    return None


def grid(since: float, until: float) -> Floats:
    """Times to look at [s]."""
    return np.arange(since, until, STEP)


def stood(commands: Sequence[Commanded], since: float, until: float) -> float | None:
    """How long after `since` a robot was told to stand, and nothing else until `until` [s]; None: never.

    A robot that was told to stand before, and nothing else since, stood at once.
    """
    before = [one for one in commands if one.at < since]
    during = [one for one in commands if since <= one.at < until]
    moving = [one.at for one in during if not one.zero]
    if not moving and before and before[-1].zero:
        return 0.0
    zeros = [one.at for one in during if one.zero and not (moving and one.at <= moving[-1])]
    return zeros[0] - since if zeros else None


def went_on(commands: Sequence[Commanded], since: float, until: float, silence: float = 0.3) -> bool:
    """Whether a robot was commanded all the time and never told to stand."""
    rows = [one for one in commands if since - silence <= one.at < until]
    times = [one.at for one in rows]
    if not times or times[0] > since + silence or until - times[-1] > silence:
        return False
    return not any(one.zero for one in rows) and all(b - a <= silence for a, b in pairwise(times))


class LeaderTerm(NamedTuple):
    """From when to when somebody led."""

    since: float
    until: float  # [s, monotonic]
    publisher_id: str
    term: int


def leader_terms(leads: Sequence[Led]) -> list[LeaderTerm]:
    """Terms of leaders: one for each publisher id and term, in the order of time."""
    found: dict[tuple[str, int], LeaderTerm] = {}
    for one in leads:
        key = (one.publisher_id, one.term)
        old = found.get(key, LeaderTerm(one.at, one.at, *key))
        found[key] = LeaderTerm(min(old.since, one.at), max(old.until, one.at), *key)
    return sorted(found.values())


def rivals(leads: Sequence[Led]) -> list[tuple[LeaderTerm, LeaderTerm]]:
    """Pairs that led at the same time."""
    return [(one, other) for one, other in combinations(leader_terms(leads), 2) if other.since <= one.until]


def taken_over(leads: Sequence[Led], since: float) -> float | None:
    """How long after `since` a process led that had not before [s]; None if none did."""
    former = {(one.publisher_id, one.term) for one in leads if one.at < since}
    new = [one.at for one in leads if one.at >= since and (one.publisher_id, one.term) not in former]
    return min(new) - since if new else None


def middle(values: Sequence[float]) -> Mapping[str, float] | None:
    """Median and worst; None of nothing."""
    if not values:
        return None
    return {"median": float(np.median(values)), "worst": float(max(values))}
