"""Lost robots, and which robots the others can still follow.

A robot follows the usable ones of its neighbours, or else its fallbacks. A robot with neither holds,
reports it, and is lost to others in turn. A neighbour is usable only if its path to the leader avoids the
robot that follows it: two robots that follow only each other stay together, but drive anywhere. An agent
knows the mission and its own lost neighbours, and uses `leads`; `losing` combines the behaviour of all
agents.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import NamedTuple

from formation.mission.model import Mission


class Loss(NamedTuple):
    """Effect of a loss."""

    holding: tuple[str, ...]
    """Robots that hold, because none is left to follow."""
    instead: dict[str, tuple[str, ...]]
    """Robots that continue with fallbacks, and these."""


def leads(mission: Mission, other: str, robot: str, lost: Collection[str]) -> bool:
    """Whether `other` follows the leader on a path without `robot` and without any of its `lost`.

    A lost leader is recognised by its beat, not by silence.
    """
    gone = set(lost) - {mission.leader}
    while more := {name for name in mission.followers if name not in gone and name != robot} & {
        name for name in mission.followers if gone.issuperset(mission.robots[name].measurable)
    }:
        gone |= more
    seen, waiting = {robot, *gone}, [other]
    while waiting:
        name = waiting.pop()
        if name == mission.leader:
            return True
        if name not in seen:
            seen.add(name)
            spec = mission.robots[name]
            # a fallback counts only if it is certainly used
            waiting += spec.measurable if gone.issuperset(spec.neighbours) else spec.neighbours
    return False


def followed(mission: Mission, robot: str, lost: Iterable[str]) -> tuple[str, ...]:
    """The robots that `robot` follows when these are lost, of all that it may measure; empty if it holds."""
    spec = mission.robots[robot]
    gone = set(lost).intersection(spec.measurable)
    missing = gone.intersection(spec.neighbours)
    if not missing:
        return spec.neighbours
    for some in (spec.neighbours, spec.fallback_neighbours):
        left = tuple(name for name in some if name not in gone and leads(mission, name, robot, missing))
        if left:
            return left
    return ()


def losing(mission: Mission, lost: str) -> Loss:
    """What the others do when the robot `lost` is lost; for the leader, if no standby replaces it."""
    needs_every_vote = bool(mission.standbys) and len(mission.followers) <= 2
    if lost == mission.leader or needs_every_vote:
        return Loss(tuple(name for name in mission.followers if name != lost), {})
    gone, waiting = {lost}, [lost]
    while waiting:
        other = waiting.pop()
        for name in mission.followers:
            measures = name not in gone and other in mission.robots[name].measurable
            if measures and not followed(mission, name, gone):
                gone.add(name)
                waiting.append(name)
    by = {name: followed(mission, name, gone) for name in mission.followers if name not in gone}
    led = {mission.leader}  # and not only by each other
    while more := {name for name, some in by.items() if name not in led and led.intersection(some)}:
        led |= more
    return Loss(
        tuple(name for name in mission.followers if name not in led and name != lost),
        {n: some for n, some in by.items() if n in led and not {*some} <= {*mission.robots[n].neighbours}},
    )


def losses(mission: Mission) -> dict[str, Loss]:
    """`losing` each of the robots, by its name."""
    return {name: losing(mission, name) for name in mission.names}


def useless_fallbacks(mission: Mission) -> Iterator[str]:
    """Sentences about fallbacks that help in no loss."""
    for name in mission.followers:
        spec = mission.robots[name]
        for other in spec.fallback_neighbours:
            if not leads(mission, other, name, spec.neighbours):
                yield (
                    f"robots.{name}.fallback_neighbours: {other} never helps, for without "
                    f"{' and '.join(spec.neighbours)} it has no way to the leader but by {name}, or none"
                )
