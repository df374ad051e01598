"""Assignment of robots to slots in a mission, and the robots that each measures there."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from formation.control.arrays import FloatArray
from formation.deploy.mission_files.edit import Change
from formation.deploy.refusal import Refusal
from formation.mission.model import Mission
from formation.slots.assignment import Aim
from formation.slots.measuring import measured
from formation.slots.shape import PlacedShape

MAX_COORDINATE = 100_000
"""Largest magnitude of a mission's positions on each axis [m]."""


class Places(NamedTuple):
    """The assignment, by follower."""

    of: dict[str, str]
    """The robot of the slots that it takes, in every shape; its own name if it keeps its slots."""
    before: dict[str, float]
    """Its distance to the slot that it had [m]."""
    now: dict[str, float]
    """Its distance to the slot that it takes [m]."""
    neighbours: dict[str, tuple[str, ...]]
    fallbacks: dict[str, tuple[str, ...]]
    avoids: dict[str, tuple[str, ...] | Literal["all"]]
    """Other robots that it is to avoid; only for robots with a changed list."""


def chosen(mission: Mission, shape: str, at: Mapping[str, complex], aim: Aim, *, keep_graph: bool) -> Places:
    """Return the places in `shape` by `aim`, from `at` [m; world frame] if given there, else from the starts.

    Places that gain nothing stay as they are. With `keep_graph` slots measure each other as before.
    """
    names = mission.followers
    distances = _distances(mission, shape, at)
    places, own = aim.assign(distances), tuple(range(len(names)))
    if _rounded(aim.worth(distances, places)) >= _rounded(aim.worth(distances, own)):
        places = own
    of = {name: names[place] for name, place in zip(names, places, strict=True)}
    neighbours, fallbacks = _present(mission, of) if keep_graph else _measured(mission, shape, of)
    return Places(
        of=of,
        before={name: float(distances[i, i]) for i, name in enumerate(names)},
        now={
            name: float(distances[i, place])
            for i, (name, place) in enumerate(zip(names, places, strict=True))
        },
        neighbours=neighbours,
        fallbacks=fallbacks,
        avoids=_avoids(mission, of, neighbours, fallbacks),
    )


def changes(mission: Mission, places: Places) -> Iterator[Change]:
    """Yield the changes of the mission's file."""
    for shape, slots in mission.shapes.items():
        for name, place in places.of.items():
            yield Change("shapes", shape, name, slots[place])
    for name in mission.followers:
        yield Change("robots", name, "neighbours", places.neighbours[name])
        yield Change("robots", name, "fallback_neighbours", places.fallbacks[name])
    for name, avoided in places.avoids.items():
        yield Change("robots", name, "avoid", avoided, otherwise=mission.robot.avoid)


def positions(path: Path, mission: Mission) -> dict[str, complex]:
    """Read robots' positions [m; world frame] from JSON such as {"robot1": [0.4, -1.2]}. Raises Refusal."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise Refusal(f"--positions {path}: {error.strerror}") from None
    except ValueError as error:
        raise Refusal(f"--positions {path}: not JSON: {error}") from None
    except RecursionError:
        raise Refusal(f"--positions {path}: lists or objects a thousand deep") from None
    if not isinstance(data, dict):
        raise Refusal(
            f'--positions {path}: must be an object such as {{"{mission.followers[0]}": [0.4, -1.2]}}'
        )
    for name, point in data.items():
        if name not in mission.robots:
            raise Refusal(f"--positions {path}: unknown robot {name}; known: {', '.join(mission.robots)}")
        if not _is_point(point):
            raise Refusal(
                f"--positions {path}: {name} = {point!r:.80}: must be [x, y], "
                f"two numbers from {-MAX_COORDINATE} to {MAX_COORDINATE} in metres"
            )
    return {name: complex(*point) for name, point in data.items()}


def _is_point(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(type(number) in {int, float} and abs(number) <= MAX_COORDINATE for number in value)
    )


def _distances(mission: Mission, shape: str, at: Mapping[str, complex]) -> FloatArray:
    """Return the distance of each follower's centre to its place in each slot [m]; shape (F, F)."""
    where = {name: at.get(name, robot.start.position) for name, robot in mission.robots.items()}
    placed_shape = PlacedShape.first(mission)._replace(mix=((shape, 1.0),))
    slots = np.array([where[mission.leader] + placed_shape.slot(mission, name) for name in mission.followers])
    # in formation all head as the leader does, and control points are ahead of centres
    ahead = mission.leader_heading
    points = [where[name] + mission.robots[name].control_point_offset * ahead for name in mission.followers]
    distances: FloatArray = np.abs(np.array(points)[:, None] - slots)
    return distances


def _rounded(worth: tuple[float, ...]) -> tuple[float, ...]:
    """Return distances rounded to 1 nm: smaller differences do not count."""
    return tuple(round(way, 9) for way in worth)


def _present(mission: Mission, of: Mapping[str, str]) -> tuple[dict[str, tuple[str, ...]], ...]:
    """Return the mission's own graph from slot to slot."""
    taken_by = {place: name for name, place in of.items()} | {mission.leader: mission.leader}
    return tuple(
        {
            name: tuple(taken_by[other] for other in getattr(mission.robots[place], key))
            for name, place in of.items()
        }
        for key in ("neighbours", "fallback_neighbours")
    )


def _avoids(
    mission: Mission,
    of: Mapping[str, str],
    neighbours: Mapping[str, tuple[str, ...]],
    fallbacks: Mapping[str, tuple[str, ...]],
) -> dict[str, tuple[str, ...] | Literal["all"]]:
    """Return the robots to avoid, from slot to slot, where the list changes.

    A robot that was avoided because it was measured, and no longer is, gets listed. Without any `avoid`
    list, nothing is added.
    """
    robots = mission.robots
    if not any(robots[name].avoid for name in mission.followers):
        return {}
    taken_by = {place: name for name, place in of.items()}
    avoids: dict[str, tuple[str, ...] | Literal["all"]] = {}
    for name, place in of.items():
        had, has = robots[place].avoid, robots[name].avoid
        if had == "all":
            if has != "all":
                avoids[name] = "all"
            continue
        listed = [taken_by[other] for other in had]
        before = [taken_by[other] for other in robots[place].measurable if other != mission.leader]
        still = {*listed, *neighbours[name], *fallbacks[name]}
        listed += [other for other in before if other not in still]
        if has == "all" or set(listed) != set(has):
            avoids[name] = tuple(listed)
    return avoids


def _measured(mission: Mission, shape: str, of: Mapping[str, str]) -> tuple[dict[str, tuple[str, ...]], ...]:
    """Return the graph for the slots of `shape`, as assigned."""
    graph = measured([0j, *(mission.slot(place, shape) for place in of.values())])
    return tuple(
        {mission.names[i]: tuple(mission.names[j] for j in lists[i]) for i in range(1, len(mission.names))}
        for lists in graph
    )
