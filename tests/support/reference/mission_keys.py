"""docs/reference/mission-keys.md: every key of a mission file, from the mission's model."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel
from pydantic_core import to_json

from formation.control.laws import LAWS
from formation.mission import model, robot, route, rules
from formation.mission.file import MAX_MISSION_BYTES, MAX_ROBOTS, SPELLINGS
from formation.mission.model import MAX_SHAPES, Mission
from formation.mission.tables import NAME, TITLE
from formation.sensing.models import MODELS
from formation.simulation.body import PROFILES
from tests.support.reference.markdown import docstrings, document, paragraph, table

TABLES: Mapping[str, type[BaseModel]] = {
    "Top level": Mission,
    "[law]": model.LawSpec,
    "[robot]": robot.RobotDefaults,
    "[robot.scan]": robot.ScanSpec,
    "[robot.seen]": robot.SeenSpec,
    "[robots.NAME]": robot.RobotSpec,
    "[robots.NAME.start]": robot.Start,
    "[[route]]: straight leg": route.Straight,
    "[[route]]: circle": route.Circle,
    "[[route]]: waypoints": route.Waypoints,
    "[standbys.NAME]": model.Standby,
    "[collisions]": model.Collisions,
    "[cohesion]": model.Cohesion,
    "[bounds]": model.Bounds,
    "[simulated_robot]": model.SimulatedRobot,
    "[simulated_scanner]": robot.SimulatedScanner,
    "[simulation]": model.SimulationSpec,
    "[[simulation.posts]]": robot.Post,
    "[[simulation.walls]]": robot.Wall,
}
"""Every table of a mission file, by its heading."""
UNITS = ("m", "s", "Hz", "m/s", "rad", "rad/s", "°", "1/m", "1/s", "1/s²")
INTRODUCTION = f"""A mission is one TOML file, UTF-8, of at most {MAX_MISSION_BYTES} bytes, with at most
{MAX_ROBOTS} robots and {MAX_SHAPES} shapes. Every process reads the same file. An unknown key, a wrong type
or a value outside its limits is refused with one line that names file, key, value and what is legal;
nothing is started. Angles in keys that end in `_deg` are degrees, counter-clockwise from x; all other
angles are radians."""
TYPES = f"""A *name* is {SPELLINGS[NAME]}; a *title* is {SPELLINGS[TITLE]}; both have at most 64 characters.
An *endpoint* is a protocol (tcp, tls, udp or quic), a host and a port, such as `"tls/192.168.1.12:7460"`."""
INHERITED = """Every key of [robot] may also stand here. A table such as `scan` then replaces the whole
table of [robot]. In addition:"""
SPECIAL = {
    "kind": " or ".join(f'`"{law}"`' for law in LAWS),
    "endpoint": "endpoint",
    "robot_endpoint": "endpoint",
}
"""Legal values of the keys that a validator checks and no type."""


def page() -> str:
    parts = [paragraph(INTRODUCTION), paragraph(TYPES)]
    for heading, cls in TABLES.items():
        described = (cls.__doc__ or "").splitlines()[0].removeprefix(f"{heading}: ")
        parts += [f"## {heading}", paragraph(described[0].upper() + described[1:])]
        if cls is robot.RobotSpec:
            parts.append(paragraph(INHERITED))
        parts.append(table(("key", "type and legal values", "default", "unit", "meaning"), rows(cls)))
        if cls is model.SimulatedRobot:
            parts += [paragraph("The values of each profile:"), _profiles()]
        if cls is robot.ScanSpec:
            parts += [paragraph("What follows from each model:"), _scanners()]
    parts += [
        "## Rules between keys",
        paragraph("A mission that breaks one of these rules is refused as well."),
    ]
    parts.append("\n".join(f"- {' '.join((rule.__doc__ or '').split())}" for rule in rules.RULES))
    return document("Mission keys", parts)


def rows(cls: type[BaseModel]) -> Iterator[tuple[str, str, str, str, str]]:
    """Key, legal values, default, unit and meaning of each key of a table, without inherited ones."""
    schema, meanings = cls.model_json_schema(), docstrings(cls)
    for key in cls.__annotations__:
        if key not in cls.model_fields:
            continue
        field = cls.model_fields[key]
        meaning, unit = _unit(meanings.get(key, ""))
        legal = SPECIAL.get(key) or _legal(schema["properties"][key])
        yield f"`{key}`", legal, "required" if field.is_required() else _default(field.default), unit, meaning


def _unit(meaning: str) -> tuple[str, str]:
    """The text without its unit, and the unit."""
    for found in re.finditer(r" ?\[([^\]]+)\]", meaning):
        if found[1].partition(";")[0] in UNITS:
            return meaning.replace(found[0], "", 1), found[1]
    return meaning, ""


def _default(value: Any) -> str:
    if isinstance(value, BaseModel) or value is None:
        return ""
    text = f"{value:g}" if isinstance(value, float) else to_json(value).decode()
    return "" if text == "{}" else f"`{text}`"


def _legal(schema: Mapping[str, Any]) -> str:
    """Type and legal values, in words."""
    if either := schema.get("anyOf", schema.get("oneOf")):
        return " or ".join(dict.fromkeys(_legal(one) for one in either if one.get("type") != "null"))
    if values := schema.get("enum", [schema["const"]] if "const" in schema else None):
        return " or ".join(f"`{to_json(value).decode()}`" for value in values)
    return _container(schema) if schema.get("type") in {"array", "object"} else _scalar(schema)


def _scalar(schema: Mapping[str, Any]) -> str:
    match schema.get("type"):
        case "number":
            return "number" + _limits(schema)
        case "integer":
            return "whole number" + _limits(schema)
        case "boolean":
            return "`true` or `false`"
        case "string":
            return {NAME: "name", TITLE: "title"}.get(schema.get("pattern", ""), "text")
    return "table"


def _container(schema: Mapping[str, Any]) -> str:
    if "prefixItems" in schema:
        return "two numbers" + _limits(schema["prefixItems"][0])
    least = schema.get("minItems", schema.get("minLength", schema.get("minProperties", 0)))
    count = f", at least {least}" if least else ""
    if schema["type"] == "array":
        items = _legal(schema["items"])
        plural = {"name": "list of names", "text": "list of names", "table": "tables"}
        return plural.get(items, f"list of pairs, each {items}") + count
    (values,) = schema["patternProperties"].values()
    return f"tables by name{count}" if "$ref" in values else f"name → {_legal(values)}"


def _limits(schema: Mapping[str, Any]) -> str:
    if "exclusiveMinimum" in schema:
        return f" above {_number(schema['exclusiveMinimum'])}, at most {_number(schema['maximum'])}"
    return (
        f" from {_number(schema['minimum'])} to {_number(schema['maximum'])}" if "minimum" in schema else ""
    )


def _number(value: float) -> str:
    return f"{value:g}".replace("e+0", "e")


def _profiles() -> str:
    names = tuple(PROFILES)
    keys = PROFILES[names[0]]._fields
    rows = ((f"`{key}`", *(f"{getattr(PROFILES[name], key):g}" for name in names)) for key in keys)
    return table(("key", *(f"`{name}`" for name in names)), rows)


def _scanners() -> str:
    simulated = robot.SimulatedScanner()
    rows: dict[str, list[str]] = {}
    for name in MODELS:
        spec = robot.ScanSpec.model_validate({"model": name})
        scanner = simulated.scanner(spec)
        own = {
            "rate": f"{spec.rate:g} Hz",
            "sweep": "as stated, negative" if spec.sweep is None else f"{spec.sweep:g} s",
            "beams": f"{scanner.beams}",
            "range_min": f"{scanner.range_min:g} m",
            "range_max": f"{scanner.range_max:g} m",
            "noise": f"{scanner.noise:g} m",
            "relative_noise": f"{scanner.relative_noise:g} beyond {scanner.growth_distance:g} m",
        }
        for key, value in own.items():
            rows.setdefault(key, []).append(value)
    return table(
        ("key", *(f"`{name}`" for name in MODELS)), ((f"`{key}`", *values) for key, values in rows.items())
    )
