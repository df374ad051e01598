"""What the subcommands share: how they read their arguments, refuse them, and print their result."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Mapping
from typing import Any

from deploy.refusal import Refusal
from formation.law import LAWS
from formation.mission import Mission
from formation.mission_file import MissionError, load


def parser(command: str, summary: str, examples: str = "") -> argparse.ArgumentParser:
    """A parser for `formation COMMAND`."""
    return argparse.ArgumentParser(
        prog=f"formation {command}",
        description=summary,
        epilog=f"examples:\n{examples}" if examples else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )


def add_mission(to: argparse.ArgumentParser, default: str | None = None, *, law: bool = True) -> None:
    """The MISSION argument, and with `law` --law, which overrides what it says."""
    to.add_argument(
        "mission",
        metavar="MISSION",
        nargs=None if default is None else "?",
        default=default,
        help="a TOML file, or the name of a shipped mission" + (f" (default {default})" if default else ""),
    )
    if law:
        to.add_argument("--law", choices=list(LAWS), help="the control law, instead of the mission's")


def read_mission(name: str, law: str | None = None) -> Mission:
    """The mission, under `law` if one is given. Raises Refusal."""
    try:
        mission = load(name)
    except MissionError as error:
        raise Refusal(str(error)) from None
    if law is None:
        return mission
    return mission.model_copy(update={"law": mission.law.model_copy(update={"kind": law})})


def number(lowest: float, highest: float = math.inf, *, open_below: bool = False) -> Callable[[str], float]:
    """An argument type: a finite number from `lowest` (or above it) to `highest`."""

    def read(text: str) -> float:
        value = float(text)
        low = value > lowest if open_below else value >= lowest
        if not (math.isfinite(value) and low and value <= highest):
            below = f"above {lowest:g}" if open_below else f"at least {lowest:g}"
            above = f"at most {highest:g}" if math.isfinite(highest) else "finite"
            raise argparse.ArgumentTypeError(f"{text}: must be {below} and {above}")
        return value

    read.__name__ = "number"  # argparse: invalid number value: 'x'
    return read


def whole(lowest: int, highest: int | None = None) -> Callable[[str], int]:
    """An argument type: a whole number from `lowest` to `highest`."""

    def read(text: str) -> int:
        value = int(text)
        if value < lowest or (highest is not None and value > highest):
            above = "" if highest is None else f" and at most {highest}"
            raise argparse.ArgumentTypeError(f"{text}: must be at least {lowest}{above}")
        return value

    read.__name__ = "whole number"
    return read


def as_json(result: Mapping[str, Any]) -> str:
    """One line of strict JSON: what is not finite becomes null."""
    return json.dumps(_finite(result), allow_nan=False, ensure_ascii=False)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
