"""From a mission file, or the name of a shipped one, to a Mission; or to one clear error."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from formation.mission import Circle, Mission, RobotSpec, Straight, Waypoints


class MissionError(ValueError):
    """A mission that is not legal; the text names file, key, value and what is legal."""


def shipped() -> dict[str, Path]:
    """Missions that come with the package, by name."""
    folder = Path(str(files("deploy"))) / "missions"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load(mission: str | Path) -> Mission:
    """The mission in a TOML file, or the shipped one of that name. Raises MissionError."""
    return parse(*read(mission))


def read(mission: str | Path) -> tuple[str, str]:
    """Text of a mission file and the name to call it by. Raises MissionError."""
    path = shipped().get(str(mission), Path(mission))
    try:
        return path.read_text(encoding="utf-8"), str(mission)
    except FileNotFoundError:
        names = ", ".join(shipped())
        raise MissionError(
            f"{mission}: no such file, and no shipped mission of that name ({names})"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise MissionError(f"{mission}: cannot be read as UTF-8 text: {error}") from None


def parse(text: str, name: str = "mission") -> Mission:
    """The mission in TOML `text`; `name` is the file to blame. Raises MissionError."""
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise MissionError(f"{name}: not valid TOML: {error}") from None
    try:
        return Mission.model_validate(data)
    except ValidationError as error:
        raise MissionError(f"{name}: {_sentence(error)}") from None


def _sentence(error: ValidationError) -> str:
    details = error.errors(include_url=False)
    # an unknown key explains the missing one beside it, so it comes first
    first = min(details, key=lambda detail: detail["type"] != "extra_forbidden")
    # a wrong default is wrong again in every robot that inherits it: that is one mistake
    distinct = {(detail["loc"][-1], repr(detail["input"])) for detail in details}
    others = f" (and {len(distinct) - 1} more)" if len(distinct) > 1 else ""
    return f"{_explain(first)}{others}"


def _explain(detail: ErrorDetails) -> str:
    context: Mapping[str, Any] = detail.get("ctx", {})
    if detail["type"] == "mission":
        return f"{context['key']} = {_value(context['value'])}: {context['legal']}"
    # the tag of a leg's kind is pydantic's, not the file's
    loc = tuple(part for i, part in enumerate(detail["loc"]) if not (detail["loc"][0] == "route" and i == 2))
    loc = tuple(part for part in loc if part != "[key]")
    key = ".".join(str(part) for part in loc)
    value = _value(detail["input"])
    match detail["type"]:
        case "extra_forbidden":
            return f"unknown key {key}; legal here: {', '.join(_keys_at(detail['loc']))}"
        case "missing" if isinstance(detail["loc"][-1], int):
            return f"{key.rpartition('.')[0]} = {value}: should be [x, y], two numbers in metres"
        case "missing":
            return f"{key} is missing; legal here: {', '.join(_keys_at(detail['loc']))}"
        case "finite_number":
            return f"{key} = {value}: must be a finite number"
        case "string_pattern_mismatch":
            return f"{key} = {value}: must match {context['pattern']}"
        case _:
            message = (
                detail["msg"].replace("a valid tuple", "a list").replace("a valid dictionary", "a table")
            )
            message = message.removeprefix("Input should be ").removeprefix("Input ")
            return f"{key} = {value}: should be {message}"


def _value(value: Any) -> str:
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _keys_at(loc: tuple[int | str, ...]) -> list[str]:
    """Keys that the table holding the last part of `loc` may have."""
    model: type[BaseModel] = Mission
    match loc[:-1]:
        case ("robots", _):
            model = RobotSpec
        case ("robots", _, "start"):
            model = RobotSpec.model_fields["start"].annotation or model
        case ("route", _, kind):
            model = {"straight": Straight, "circle": Circle, "waypoints": Waypoints}[str(kind)]
        case (str(table),) if table in Mission.model_fields:
            annotation = Mission.model_fields[table].annotation
            if isinstance(annotation, type) and issubclass(annotation, BaseModel):
                model = annotation
    return list(model.model_fields)
