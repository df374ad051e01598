"""Robots that could meet on their paths without both avoiding each other."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

from formation.mission.model import Mission


class Segment(NamedTuple):
    """A straight path, relative to the leader [m]."""

    begin: complex
    end: complex


def unfiltered(mission: Mission) -> Iterator[str]:
    """Warning of `formation check` about a law without collision filter."""
    if mission.collisions.mode != "off" and len(mission.followers) > 1:
        yield f"the {mission.law.kind} law has no collision filter: robots do not avoid each other"


def unavoided(mission: Mission) -> tuple[tuple[str, str], ...]:
    """Pairs of followers that could meet, and do not both avoid each other.

    They go straight from their starts to their first slots, at any times: where these paths come nearer to
    each other than bodies and control points need, the robots could meet. Between shapes they move
    together, and an order is refused if slots would touch during the transition.
    """
    if mission.collisions.mode == "off":
        return ()
    avoided = {name: set(mission.avoided_by(name)) for name in mission.followers}
    segments = {name: _segment(mission, name) for name in mission.followers}
    return tuple(
        (one, other)
        for one, other in combinations(mission.followers, 2)
        if not (one in avoided[other] and other in avoided[one])
        and between(segments[one], segments[other]) < _needed(mission, one, other)
    )


def warnings(mission: Mission) -> Iterator[str]:
    """Warnings of `formation check` about these pairs."""
    pairs = unavoided(mission)
    if not pairs:
        return
    first, second = pairs[0]
    more = len(pairs) - 1
    others = "" if more == 0 else f" (and {more} other pair{'' if more == 1 else 's'})"
    yield (
        f"{first} and {second}{others} could meet on their ways, and do not both avoid each other: "
        'name them in each other\'s `avoid`, or say avoid = "all" under [robot]'
    )


def between(one: Segment, other: Segment) -> float:
    """Least distance between two straight paths [m]."""
    if _apart(one, other) and _apart(other, one):
        return 0.0
    ends = ((one.begin, other), (one.end, other), (other.begin, one), (other.end, one))
    return min(_to(point, segment) for point, segment in ends)


def _segment(mission: Mission, name: str) -> Segment:
    leader = mission.robots[mission.leader].start.position
    turned = mission.leader_heading if mission.turning else 1.0
    return Segment(mission.robots[name].start.position - leader, mission.slot(name) * turned)


def _needed(mission: Mission, one: str, other: str) -> float:
    bodies = (mission.robots[one], mission.robots[other])
    return sum(body.radius + body.control_point_offset for body in bodies) + mission.collisions.margin


def _apart(line: Segment, segment: Segment) -> bool:
    """Whether the ends of a path lie on different sides of a line."""
    along = (line.end - line.begin).conjugate()
    return (along * (segment.begin - line.begin)).imag * (along * (segment.end - line.begin)).imag < 0.0


def _to(point: complex, segment: Segment) -> float:
    along = segment.end - segment.begin
    squared = abs(along) ** 2
    share = 0.0 if squared == 0.0 else (along.conjugate() * (point - segment.begin)).real / squared
    return abs(segment.begin + max(0.0, min(1.0, share)) * along - point)
