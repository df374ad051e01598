"""Who takes whose slot in a mission, and whom each robot measures there."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from deploy.making.text import Change
from deploy.refusal import Refusal
from formation.arrays import FloatArray
from formation.figure import Figure
from formation.mission import Mission
from formation.slots.assignment import Aim
from formation.slots.measuring import measured

FARTHEST = 100_000
"""Positions of a mission are within ± this, on each axis [m]."""


class Places(NamedTuple):
    """What is chosen, by follower."""

    of: dict[str, str]
    """Whose slots it takes, in every shape; its own name where it keeps them."""
    before: dict[str, float]
    """Its way to the slot that it had [m]."""
    now: dict[str, float]
    """Its way to the slot that it takes [m]."""
    neighbours: dict[str, tuple[str, ...]]
    fallbacks: dict[str, tuple[str, ...]]
    minds: dict[str, tuple[str, ...] | Literal["all"]]
    """Whom it is to mind beside those; only of robots whose mission has to say so anew."""


def chosen(mission: Mission, shape: str, at: Mapping[str, complex], aim: Aim, *, keep_graph: bool) -> Places:
    """The places in `shape` by `aim`, from the starts, or from `at` [m; world frame] where that says more.

    Places that gain nothing are left as they are. With `keep_graph` slots measure each other as they did.
    """
    names = mission.followers
    ways = _ways(mission, shape, at)
    places, own = aim.assign(ways), tuple(range(len(names)))
    if _rounded(aim.worth(ways, places)) >= _rounded(aim.worth(ways, own)):
        places = own
    of = {name: names[place] for name, place in zip(names, places, strict=True)}
    neighbours, fallbacks = _kept(mission, of) if keep_graph else _measured(mission, shape, of)
    return Places(
        of=of,
        before={name: float(ways[i, i]) for i, name in enumerate(names)},
        now={name: float(ways[i, place]) for i, (name, place) in enumerate(zip(names, places, strict=True))},
        neighbours=neighbours,
        fallbacks=fallbacks,
        minds=_minds(mission, of, neighbours, fallbacks),
    )


def changes(mission: Mission, places: Places) -> Iterator[Change]:
    """What becomes of the mission's file."""
    for shape, slots in mission.shapes.items():
        for name, place in places.of.items():
            yield Change("shapes", shape, name, slots[place])
    for name in mission.followers:
        yield Change("robots", name, "neighbours", places.neighbours[name])
        yield Change("robots", name, "fallback_neighbours", places.fallbacks[name])
    for name, minded in places.minds.items():
        yield Change("robots", name, "mind", minded, otherwise=mission.robot.mind)


def positions(path: Path, mission: Mission) -> dict[str, complex]:
    """Where robots are [m; world frame], from JSON such as {"robot1": [0.4, -1.2]}. Raises Refusal."""
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
                f"two numbers from {-FARTHEST} to {FARTHEST} in metres"
            )
    return {name: complex(*point) for name, point in data.items()}


def _is_point(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(type(number) in {int, float} and abs(number) <= FARTHEST for number in value)
    )


def _ways(mission: Mission, shape: str, at: Mapping[str, complex]) -> FloatArray:
    """How far each follower's centre is from where each slot would have it [m]; shape (F, F)."""
    where = {name: at.get(name, robot.start.position) for name, robot in mission.robots.items()}
    figure = Figure.first(mission)._replace(mix=((shape, 1.0),))
    slots = np.array([where[mission.leader] + figure.slot(mission, name) for name in mission.followers])
    # in formation all head as the leader does, and control points are ahead of centres
    ahead = mission.leader_heading
    points = [where[name] + mission.robots[name].control_point_offset * ahead for name in mission.followers]
    ways: FloatArray = np.abs(np.array(points)[:, None] - slots)
    return ways


def _rounded(worth: tuple[float, ...]) -> tuple[float, ...]:
    """Ways to the nanometre: what differs by less is as long."""
    return tuple(round(way, 9) for way in worth)


def _kept(mission: Mission, of: Mapping[str, str]) -> tuple[dict[str, tuple[str, ...]], ...]:
    """The mission's own graph from slot to slot."""
    taken_by = {place: name for name, place in of.items()} | {mission.leader: mission.leader}
    return tuple(
        {
            name: tuple(taken_by[other] for other in getattr(mission.robots[place], key))
            for name, place in of.items()
        }
        for key in ("neighbours", "fallback_neighbours")
    )


def _minds(
    mission: Mission,
    of: Mapping[str, str],
    neighbours: Mapping[str, tuple[str, ...]],
    fallbacks: Mapping[str, tuple[str, ...]],
) -> dict[str, tuple[str, ...] | Literal["all"]]:
    """Whom robots mind, from slot to slot, where that is not what they have.

    Who was minded for being measured, and is measured no more, is listed from now on. Where nobody has a
    `mind` nothing is added.
    """
    robots = mission.robots
    if not any(robots[name].mind for name in mission.followers):
        return {}
    taken_by = {place: name for name, place in of.items()}
    minds: dict[str, tuple[str, ...] | Literal["all"]] = {}
    for name, place in of.items():
        had, has = robots[place].mind, robots[name].mind
        if had == "all":
            if has != "all":
                minds[name] = "all"
            continue
        listed = [taken_by[other] for other in had]
        before = [taken_by[other] for other in robots[place].measurable if other != mission.leader]
        still = {*listed, *neighbours[name], *fallbacks[name]}
        listed += [other for other in before if other not in still]
        if has == "all" or set(listed) != set(has):
            minds[name] = tuple(listed)
    return minds


def _measured(mission: Mission, shape: str, of: Mapping[str, str]) -> tuple[dict[str, tuple[str, ...]], ...]:
    """The graph for the slots of `shape`, as they are taken."""
    graph = measured([0j, *(mission.slot(place, shape) for place in of.values())])
    return tuple(
        {mission.names[i]: tuple(mission.names[j] for j in lists[i]) for i in range(1, len(mission.names))}
        for lists in graph
    )
