"""From a mission file, or the name of a shipped one, to a Mission; or to one clear error."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, Field, ValidationError
from pydantic_core import ErrorDetails

from formation.mission.model import (
    Bounds,
    Cohesion,
    Collisions,
    LawSpec,
    Mission,
    SimulatedRobot,
    SimulationSpec,
    Standby,
)
from formation.mission.robot import Post, RobotDefaults, RobotSpec, ScanSpec, SimulatedScanner, Start, Wall
from formation.mission.route import Circle, Leg, Straight, Waypoints
from formation.mission.tables import NAME, TITLE, Table, as_tuple

SPELLINGS = {
    NAME: "a small letter, and then small letters, digits and _ only",
    TITLE: "a letter or digit, and then letters, digits, - and _ only",
}
"""What a pattern asks for, in words."""


MAX_MISSION_BYTES = 1024 * 1024
"""Longest mission file that is read [bytes]. A mission of 200 robots has a tenth of that."""
MAX_KEY_PARTS = 32
"""Parts of a dotted key, as `a.b.c` has three. No key of a mission has more than four."""
_PIECES = re.compile(
    r'"""(?:[^\\]|\\.)*?"""|\'\'\'.*?\'\'\'|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'|#[^\n]*|[\w+-]+|[ \t]+|.',
    re.DOTALL,
)
MAX_ROBOTS = 500
"""Robots of a mission file, the leader among them: analysis and rules compare each with each."""
MAX_OTHERS = 3
"""Mistakes of a mission that are named after the first."""
LEGAL = "; legal here: "
MISSION_HELP = "a TOML file, a folder of bundles, or the name of a shipped mission"
"""What a command line takes as MISSION."""
MISSION_NAME, DESK = "mission.toml", "desk"
"""In a folder of bundles: a mission's file, and the folder of what the desk needs."""


class RouteFile(Table):
    """A file that holds a route and nothing else."""

    route: Annotated[tuple[Leg, ...], BeforeValidator(as_tuple), Field(min_length=1)]


T = TypeVar("T", Mission, RouteFile)


class MissionError(ValueError):
    """A mission that is not legal; the text names file, key, value and what is legal."""


class TomlError(ValueError):
    """Text that is no TOML, or beyond the limits; a sentence says which."""


def shipped() -> dict[str, Path]:
    """Missions that come with the package, by name."""
    folder = Path(str(files("formation.deploy"))) / "missions"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def file_of(mission: str | Path) -> Path:
    """The file of a mission: a TOML file, that of a folder of bundles, or a shipped one by name or title.

    Raises OSError for a folder that cannot be read, ValueError for what is no path.
    """
    path = Path(mission)
    for inside in (path / MISSION_NAME, path / DESK / MISSION_NAME):
        if inside.is_file():
            return inside
    names = shipped()
    if str(mission) in names:
        return names[str(mission)]
    return path if path.exists() else names.get(str(mission).replace("-", "_"), path)


def configuration_of(mission: str | Path, process: str) -> Path | None:
    """Zenoh's configuration of a desk's process, where `mission` is a folder of bundles with one."""
    for folder in (Path(mission), Path(mission) / DESK):
        if (file := folder / f"{process}.json5").is_file():
            return file
    return None


def load(mission: str | Path) -> Mission:
    """The mission in a TOML file, or the shipped one of that name. Raises MissionError."""
    return parse(*read(mission))


def read(mission: str | Path) -> tuple[str, str]:
    """Text of a mission file and the name to call it by. Raises MissionError."""
    if not str(mission):  # it would be the present folder
        raise MissionError("'': names no mission; name a TOML file, a shipped mission or a folder of bundles")
    try:
        path = file_of(mission)
        # a pipe is waited for, a device has no end
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise MissionError(f"{mission}: must be a file, is a pipe or a device")
        with path.open("rb") as file:
            data = file.read(MAX_MISSION_BYTES + 1)
        if len(data) > MAX_MISSION_BYTES:
            raise MissionError(f"{mission}: is longer than {MAX_MISSION_BYTES} bytes, the most that is read")
        return data.decode(), str(mission)
    except FileNotFoundError:
        names = ", ".join(shipped())
        raise MissionError(
            f"{mission}: no such file, and no shipped mission of that name ({names})"
        ) from None
    except MissionError:
        raise
    except IsADirectoryError:
        raise MissionError(
            f"{mission}: is a folder without bundles; name a TOML file, a shipped mission or a folder that"
            " `formation deploy bundle` has made"
        ) from None
    except OSError as error:
        raise MissionError(f"{mission}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise MissionError(f"{mission}: cannot be read as UTF-8 text: {error}") from None
    except ValueError as error:  # no path at all, such as one with a zero byte
        raise MissionError(f"{str(mission)!r}: cannot be read: {error}") from None


def parse(text: str, name: str = "mission") -> Mission:
    """The mission in TOML `text`; `name` is the file to blame. Raises MissionError."""
    data = _toml(text, name)
    if isinstance(robots := data.get("robots"), dict) and len(robots) > MAX_ROBOTS:
        raise MissionError(f"{name}: robots = {len(robots)} items: should have at most {MAX_ROBOTS} items")
    return _validated(Mission, data, name)


def parse_route(text: str, name: str = "route") -> tuple[Leg, ...]:
    """The ``[[route]]`` in TOML `text`, which may be a mission's; `name` is to blame. Raises MissionError."""
    data = _toml(text, name)
    if not data.keys().isdisjoint({"robots", "shapes"}):
        return parse(text, name).route
    return _validated(RouteFile, data, name).route


def loads(text: str) -> dict[str, Any]:
    """The tables in TOML from a stranger, within limits of length, depth and time. Raises TomlError.

    `tomllib` takes minutes for a key of ten thousand parts, fails in its own ways on long numbers and deep
    lists, and has no limit of its own.
    """
    if len(text) > MAX_MISSION_BYTES:
        raise TomlError(f"is longer than {MAX_MISSION_BYTES} bytes, the most that is read")
    if _longest_key(text) > MAX_KEY_PARTS:
        raise TomlError(f"not a mission: a key of over {MAX_KEY_PARTS} parts")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise TomlError(f"not valid TOML: {error}") from None
    except RecursionError:
        raise TomlError("not a mission: lists or tables a thousand deep") from None
    except ValueError:  # of Python's own int()
        raise TomlError("not a mission: a number of over 4300 digits") from None


def _longest_key(text: str) -> int:
    """Most names in a row with dots between them."""
    longest, names, dotted = 0, 0, True
    for piece in _PIECES.findall(text):
        if piece == ".":
            dotted = True
        elif piece[0] in "\"'" or piece[0].isalnum() or piece[0] in "_+-":
            names = names + 1 if dotted else 1
            dotted, longest = False, max(longest, names)
        elif not piece.isspace() or "\n" in piece:
            names, dotted = 0, False
    return longest


def _toml(text: str, name: str) -> dict[str, Any]:
    try:
        return loads(text)
    except TomlError as error:
        raise MissionError(f"{name}: {error}") from None


def _validated(cls: type[T], data: dict[str, Any], name: str) -> T:
    try:
        return cls.model_validate(data)
    except ValidationError as error:
        details = error.errors(include_url=False)
    # an unknown key explains the missing one beside it, so it comes first
    details.sort(key=lambda detail: detail["type"] != "extra_forbidden")
    # a wrong default is wrong again in every robot that inherits it: that is one mistake
    distinct: dict[tuple[Any, str], ErrorDetails] = {}
    for detail in details:
        distinct.setdefault((detail["loc"][-1:], _value(detail["input"])), detail)
    first, *others = distinct.values()
    text = _explain(first, cls)
    if others:
        text += f"; also: {'; '.join(_explain(one, cls).partition(LEGAL)[0] for one in others[:MAX_OTHERS])}"
    if len(others) > MAX_OTHERS:
        text += f"; and {len(others) - MAX_OTHERS} more"
    raise MissionError(f"{name}: {text}")


def _explain(detail: ErrorDetails, whole: type[BaseModel]) -> str:
    context: Mapping[str, Any] = detail.get("ctx", {})
    # the tag of a leg's kind, and the mark of a bad key, are pydantic's and not the file's
    place = [part for part in detail["loc"] if part not in {"straight", "circle", "waypoints", "[key]"}]
    key, value = ".".join(_printable(str(part)) for part in place), _value(detail["input"])
    match detail["type"]:
        case "mission":
            return f"{context['key']} = {_value(context['value'])}: {context['legal']}"
        case "extra_forbidden":
            here = _keys_beside(detail["loc"], whole)
            legal = f"unknown key {key}{_elsewhere(detail, whole)}{LEGAL}{here}"
        case "missing" if isinstance(place[-1], int):
            legal = f"{key.rpartition('.')[0]} = {value}: should be [x, y], two numbers in metres"
        case "missing":
            legal = f"{key} is missing{LEGAL}{_keys_beside(detail['loc'], whole)}"
        case "string_pattern_mismatch":
            legal = f"{key} = {value}: should be {SPELLINGS[context['pattern']]}"
        case "float_type" | "int_type" if isinstance(detail["input"], str):
            legal = f"{key} = {value}: should be a number, without quotes and without a unit"
        case "tuple_type" if place == ["route"]:
            legal = "route: should be [[route]] in double brackets, a table for each leg"
        case _:
            wanted = detail["msg"].removeprefix("Input should be ").removeprefix("Input ")
            wanted = wanted.replace("a valid tuple", "a list").replace("a valid dictionary", "a table")
            wanted = wanted.partition(" or instance of ")[0]  # of a class, which no file has
            legal = f"{key} = {value}: should be {wanted}"
    return legal


def _elsewhere(detail: ErrorDetails, whole: type[BaseModel]) -> str:
    """Return where an unknown key belongs if the whole mission has it, as one that stands below a table."""
    key = str(detail["loc"][-1])
    if len(detail["loc"]) == 1 or key not in whole.model_fields:
        return ""
    if isinstance(detail["input"], dict):
        return f": a table of its own, [{key}]"
    if isinstance(detail["input"], list) and detail["input"] and isinstance(detail["input"][0], dict):
        return f": tables of their own, [[{key}]]"
    return f": {key} belongs to the whole mission, above the first table of the file"


def _value(value: Any) -> str:
    try:
        text = "nothing" if value is None else repr(list(value) if isinstance(value, tuple) else value)
    except ValueError:  # Python does not write a number of over 4300 digits
        text = "a number of over 4300 digits"
    return _cut(text)


def _printable(key: str) -> str:
    return _cut(key if key.isprintable() else repr(key)[1:-1])


def _cut(text: str) -> str:
    return text if len(text) <= 80 else text[:77] + "..."


def _keys_beside(loc: tuple[int | str, ...], whole: type[BaseModel]) -> str:
    """The keys that the table which holds the last part of `loc` may have, in a file that is a `whole`."""
    tables: dict[str, type[BaseModel]] = {
        "law": LawSpec,
        "robot": RobotDefaults,
        "simulated_robot": SimulatedRobot,
        "simulated_scanner": SimulatedScanner,
        "simulation": SimulationSpec,
        "posts": Post,
        "walls": Wall,
        "scan": ScanSpec,
        "robots": RobotSpec,
        "standbys": Standby,
        "collisions": Collisions,
        "cohesion": Cohesion,
        "bounds": Bounds,
        "start": Start,
        "straight": Straight,
        "circle": Circle,
        "waypoints": Waypoints,
    }
    named = [tables[str(part)] for part in loc[:-1] if part in tables]
    return ", ".join((named[-1] if named else whole).model_fields)
