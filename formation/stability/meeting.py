"""Which robots could meet on their ways without both minding each other."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

from formation.mission import Mission


class Way(NamedTuple):
    """A straight way, relative to the leader [m]."""

    begin: complex
    end: complex


def unfiltered(mission: Mission) -> Iterator[str]:
    """What `formation check` says of the printed law."""
    if mission.collisions.mode != "off" and len(mission.followers) > 1:
        yield "by the paper's law commands are as printed, without collision filter: nobody avoids anybody"


def unminded(mission: Mission) -> tuple[tuple[str, str], ...]:
    """Pairs of followers whose bodies could meet, of whom not each minds the other.

    They go straight from their starts to their first slots, at whatever times: where these ways come nearer
    to each other than bodies and control points need, the robots could meet. From shape to shape they go
    together, and whoever orders it is refused where slots would touch on the way.
    """
    if mission.collisions.mode == "off":
        return ()
    minded = {name: set(mission.minded(name)) for name in mission.followers}
    ways = {name: _way(mission, name) for name in mission.followers}
    return tuple(
        (one, other)
        for one, other in combinations(mission.followers, 2)
        if not (one in minded[other] and other in minded[one])
        and between(ways[one], ways[other]) < _needed(mission, one, other)
    )


def warnings(mission: Mission) -> Iterator[str]:
    """What `formation check` says of them."""
    pairs = unminded(mission)
    if not pairs:
        return
    first, second = pairs[0]
    more = len(pairs) - 1
    others = "" if more == 0 else f" (and {more} other pair{'' if more == 1 else 's'})"
    yield (
        f"{first} and {second}{others} could meet on their ways, and do not both mind each other: "
        'name them in each other\'s `mind`, or say mind = "all" under [robot]'
    )


def between(one: Way, other: Way) -> float:
    """Least distance between two straight ways [m]."""
    if _apart(one, other) and _apart(other, one):
        return 0.0
    ends = ((one.begin, other), (one.end, other), (other.begin, one), (other.end, one))
    return min(_to(point, way) for point, way in ends)


def _way(mission: Mission, name: str) -> Way:
    leader = mission.robots[mission.leader].start.position
    turned = mission.leader_heading if mission.turning else 1.0
    return Way(mission.robots[name].start.position - leader, mission.slot(name) * turned)


def _needed(mission: Mission, one: str, other: str) -> float:
    bodies = (mission.robots[one], mission.robots[other])
    return sum(body.radius + body.control_point_offset for body in bodies) + mission.collisions.margin


def _apart(line: Way, way: Way) -> bool:
    """Whether the ends of a way lie on either side of a line."""
    along = (line.end - line.begin).conjugate()
    return (along * (way.begin - line.begin)).imag * (along * (way.end - line.begin)).imag < 0.0


def _to(point: complex, way: Way) -> float:
    along = way.end - way.begin
    squared = abs(along) ** 2
    share = 0.0 if squared == 0.0 else (along.conjugate() * (point - way.begin)).real / squared
    return abs(way.begin + max(0.0, min(1.0, share)) * along - point)
