"""`formation assign`: assign slots and neighbours so that robots drive as little as possible."""

from __future__ import annotations

import argparse
import json
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Any, Literal, NamedTuple

import numpy as np
import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable

from formation.control.arrays import FloatArray
from formation.deploy.arguments import add_json, add_mission, add_out, parser, print_result, read_mission
from formation.deploy.mission_files.files import check_out, is_shipped, write_mission
from formation.deploy.refusal import Refusal
from formation.deploy.terminal.units import metres
from formation.mission.file import file_of, parse
from formation.mission.model import Mission
from formation.slots.assignment import AIMS, Aim
from formation.slots.measuring import measured
from formation.slots.shape import PlacedShape

MAX_COORDINATE = 100_000
"""Largest magnitude of a mission's positions on each axis [m]."""
Lists = tuple[dict[str, tuple[str, ...]], ...]
"""The neighbours of each robot, and its fallback neighbours."""
EXAMPLES = """\
  formation assign my_mission.toml --dry-run           what would change, and the distance of each robot
  formation assign my_mission.toml                     the least sum of distances, written into the file
  formation assign my_mission.toml --least longest     the longest distance is as short as possible
  formation assign six_robots --out my_mission.toml --graph keep
  formation assign my_mission.toml --positions now.json    with {"robot1": [0.4, -1.2], …}

A robot takes its slot in every shape of the mission. Comments are not changed: check that they still fit.
To robots in the field it comes with `formation deploy bundle` and `formation deploy push`.
"""


class Places(NamedTuple):
    """The assignment, by follower."""

    slot_of: dict[str, str]
    """The robot that had the slots which it takes in every shape; its own name if it keeps its slots."""
    before: dict[str, float]
    """Its distance to the slot that it had [m]."""
    now: dict[str, float]
    """Its distance to the slot that it takes [m]."""
    neighbours: dict[str, tuple[str, ...]]
    fallbacks: dict[str, tuple[str, ...]]
    avoids: dict[str, tuple[str, ...] | Literal["all"]]
    """Other robots that it is to avoid; only for robots with a changed list."""


class Change(NamedTuple):
    """A new list or word for ``key`` in ``[group.name]``; no edit if it already has that value."""

    group: str
    name: str
    key: str
    value: tuple[Any, ...] | str
    default: tuple[Any, ...] | str = ()
    """The default if the table has no such key."""


def main(arguments: Sequence[str]) -> int:
    """Assign slots and neighbours; return the exit code."""
    options = _options().parse_args(arguments)
    mission = read_mission(options.mission)
    out = _out(options)
    at = {} if options.positions is None else positions(options.positions, mission)
    kept = options.graph == "keep"
    places = assign(mission, _shape(options, mission), at, AIMS[options.least], keep_graph=kept)
    written = None if out is None else _write(options.mission, mission, places, out)
    end = "nothing was written"
    if written is not None:
        state = "changed" if written else "unchanged"
        if options.out is not None:
            state = "written" if written else "written, nothing changed"
        end = f"{out}: {state}\n\nnext:\n  formation check {quote(str(out))}"
    text = "\n".join([*words(mission, places), "", end])
    print_result(options, text, lambda: report(mission, places, options.least, out))
    return 0


def words(mission: Mission, places: Places) -> Iterator[str]:
    """Yield the places for people."""
    width = max(len(name) for name in ("in all", "longest", *mission.followers)) + 2
    yield f"  {'robot':<{width}}{'takes the slot of':<{width + 14}}{'distance before':<17}{'now':<10}measures"
    for name, place in places.slot_of.items():
        other = "its own" if place == name else place
        seen = ", ".join(places.neighbours[name])
        if places.fallbacks[name]:
            seen += f", or else {', '.join(places.fallbacks[name])}"
        before, now = metres(places.before[name]), metres(places.now[name])
        yield f"  {name:<{width}}{other:<{width + 14}}{before:<17}{now:<10}{seen}"
    for title, total in (("in all", sum), ("longest", max)):
        before, now = metres(total(places.before.values())), metres(total(places.now.values()))
        yield f"  {title:<{width}}{'':<{width + 14}}{before:<17}{now}"


def report(mission: Mission, places: Places, least: str, out: Path | None) -> dict[str, Any]:
    """Return the places for a script."""
    return {
        "mission": mission.name,
        "least": least,
        "written": None if out is None else str(out),
        "distance": {
            when: {"total": sum(distances.values()), "longest": max(distances.values())}
            for when, distances in (("before", places.before), ("now", places.now))
        },
        "robots": {
            name: {
                "takes_slot_of": place,
                "distance_before": places.before[name],
                "distance_now": places.now[name],
                "neighbours": list(places.neighbours[name]),
                "fallback_neighbours": list(places.fallbacks[name]),
            }
            for name, place in places.slot_of.items()
        },
    }


def assign(mission: Mission, shape: str, at: Mapping[str, complex], aim: Aim, *, keep_graph: bool) -> Places:
    """Return the places in `shape` by `aim`, from `at` [m; world frame] if given there, else from the starts.

    Places that gain nothing stay as they are. With `keep_graph` slots measure each other as before.
    """
    names = mission.followers
    distances = _distances(mission, shape, at)
    places, own = aim.assign(distances), tuple(range(len(names)))
    if _rounded(aim.worth(distances, places)) >= _rounded(aim.worth(distances, own)):
        places = own
    slot_of = {name: names[place] for name, place in zip(names, places, strict=True)}
    graph = _kept_graph(mission, slot_of) if keep_graph else _new_graph(mission, shape, slot_of)
    neighbours, fallbacks = graph
    return Places(
        slot_of=slot_of,
        before={name: float(distances[i, i]) for i, name in enumerate(names)},
        now={
            name: float(distances[i, place])
            for i, (name, place) in enumerate(zip(names, places, strict=True))
        },
        neighbours=neighbours,
        fallbacks=fallbacks,
        avoids=_avoids(mission, slot_of, neighbours, fallbacks),
    )


def changes(mission: Mission, places: Places) -> Iterator[Change]:
    """Yield the changes of the mission's file."""
    for shape, slots in mission.shapes.items():
        for name, place in places.slot_of.items():
            yield Change("shapes", shape, name, slots[place])
    for name in mission.followers:
        yield Change("robots", name, "neighbours", places.neighbours[name])
        yield Change("robots", name, "fallback_neighbours", places.fallbacks[name])
    for name, avoided in places.avoids.items():
        yield Change("robots", name, "avoid", avoided, default=mission.robot.avoid)


def positions(path: Path, mission: Mission) -> dict[str, complex]:
    """Read robots' positions [m; world frame] from JSON such as {"robot1": [0.4, -1.2]}. Raises Refusal."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=_without_repeated_names)
    except OSError as error:
        raise Refusal(f"--positions {path}: {error.strerror}") from None
    except ValueError as error:
        raise Refusal(f"--positions {path}: not JSON that can be used: {error}") from None
    except RecursionError:
        raise Refusal(f"--positions {path}: nested too deeply") from None
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


def _without_repeated_names(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object read from JSON. Raises ValueError if a name is in it twice."""
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise ValueError(f"{name} is given twice")
        found[name] = value
    return found


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
    return tuple(round(distance, 9) for distance in worth)


def _kept_graph(mission: Mission, slot_of: Mapping[str, str]) -> Lists:
    """Return the mission's own graph from slot to slot."""
    taken_by = {place: name for name, place in slot_of.items()} | {mission.leader: mission.leader}
    return tuple(
        {
            name: tuple(taken_by[other] for other in getattr(mission.robots[place], key))
            for name, place in slot_of.items()
        }
        for key in ("neighbours", "fallback_neighbours")
    )


def _avoids(
    mission: Mission,
    slot_of: Mapping[str, str],
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
    taken_by = {place: name for name, place in slot_of.items()}
    avoids: dict[str, tuple[str, ...] | Literal["all"]] = {}
    for name, place in slot_of.items():
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


def _new_graph(mission: Mission, shape: str, slot_of: Mapping[str, str]) -> Lists:
    """Return the graph for the slots of `shape`, as assigned."""
    graph = measured([0j, *(mission.slot(place, shape) for place in slot_of.values())])
    return tuple(
        {mission.names[i]: tuple(mission.names[j] for j in lists[i]) for i in range(1, len(mission.names))}
        for lists in graph
    )


def edited(text: str, changes: Iterable[Change]) -> str:
    """Return a mission's TOML with these values; comments, order, layout and all other values stay.

    Raises ValueError, with the first key, if that cannot be done in place.
    """
    document: Any = tomlkit.parse(text)
    wanted, made = tomllib.loads(text), []
    newline = "\r\n" if "\r\n" in text else "\n"
    try:
        for change in changes:
            value, plain = _plain(change.value), wanted[change.group][change.name]
            if plain.get(change.key, _plain(change.default)) == value:
                continue
            made.append(f"{change.group}.{change.name}.{change.key}")
            table = document[change.group][change.name]
            if change.value == change.default:
                del plain[change.key], table[change.key]
                continue
            plain[change.key] = value
            if change.key in table:
                table[change.key] = value
            else:
                _add(table, change.key, value, newline)
        after = tomlkit.dumps(document)
        if tomllib.loads(after) == wanted:
            return after
    except (TOMLKitError, tomllib.TOMLDecodeError):
        pass
    raise ValueError(made[0])


def _add(table: Any, key: str, value: list[Any] | str, newline: str) -> None:
    """Add a key to a robot's table, on the line after its neighbours; to an inline table at its end."""
    if isinstance(table, InlineTable):
        table.append(key, value)
        return
    item, beside = tomlkit.item(value), table.item("neighbours")
    item.trivia.indent, item.trivia.trail = beside.trivia.indent, beside.trivia.trail
    beside.trivia.trail = beside.trivia.trail or newline  # at the end of the file there may be none
    # append() would put it behind the comments that belong to the next table
    table.value._insert_after("neighbours", key, item)  # noqa: SLF001


def _plain(value: tuple[Any, ...] | str) -> list[Any] | str:
    """Return the value as read from TOML."""
    return value if isinstance(value, str) else list(value)


def _write(source: str, mission: Mission, places: Places, out: Path) -> bool:
    """Write the mission with these places; return whether that changed it."""
    path = file_of(source)
    with path.open(encoding="utf-8", newline="") as file:
        before = file.read()
    try:
        text = edited(before, changes(mission, places))
    except ValueError as error:
        raise Refusal(
            f"{source}: {error} cannot be changed in place; write [shapes.NAME] and [robots.NAME] with a"
            " line for each key"
        ) from None
    parse(text, source)
    if text != before or out != path:
        write_mission(out, text)
    return text != before


def _out(options: argparse.Namespace) -> Path | None:
    """Return the file to write; None for none."""
    if options.dry_run:
        return None
    if options.out is not None:
        check_out(options.out, force=options.force)
    elif Path(options.mission).is_dir():
        raise Refusal(f"{options.mission} is a folder of bundles: name the file that they are made from")
    elif is_shipped(file_of(options.mission)):
        raise Refusal(
            f"{options.mission} is shipped, and is not changed: --out FILE for one of your own, or --dry-run"
        )
    return options.out or Path(options.mission)


def _shape(options: argparse.Namespace, mission: Mission) -> str:
    shape: str = options.shape or mission.first_shape
    if shape not in mission.shapes:
        raise Refusal(f"--shape {shape}: must be one of the mission's shapes: {', '.join(mission.shapes)}")
    return shape


def _options() -> argparse.ArgumentParser:
    options = parser("assign", "Choose each robot's slot, and the neighbours that it measures.", EXAMPLES)
    add_mission(options, law=False)
    options.add_argument(
        "--least",
        choices=AIMS,
        default="total",
        help="what to make least: the sum of all distances, or the longest (default %(default)s)",
    )
    options.add_argument("--shape", metavar="NAME", help="the shape to go into (default the mission's first)")
    options.add_argument(
        "--positions",
        type=Path,
        metavar="FILE",
        help="where robots are, instead of their starts: JSON, centres in metres by name",
    )
    options.add_argument(
        "--graph",
        choices=("new", "keep"),
        default="new",
        help="measure the nearest robots that are fewer hops from the leader, or as now from slot to slot "
        "(default %(default)s)",
    )
    options.add_argument("--dry-run", action="store_true", help="only show what would change")
    add_out(options, "write there, and leave MISSION as it is")
    options.add_argument("--force", action="store_true", help="overwrite an existing --out")
    add_json(options)
    return options
