"""`formation doctor`: name the faults of a robot or a fleet, and remedies. It moves nothing."""

from __future__ import annotations

import argparse
import json
import os
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TextIO

from formation.deploy.arguments import add_json, number, parser, print_result, read_mission, text_stream
from formation.deploy.doctor import gather, tls
from formation.deploy.doctor.agent import AGENT, LEADING, MISSION, NEIGHBOURS, REFUSALS
from formation.deploy.doctor.facts import Checked, examine
from formation.deploy.doctor.robot import CERTIFICATES, CLOCKS, ODOMETRY, ROBOT_LINK, WATCHDOG
from formation.deploy.doctor.sight import SCANNER, SIGHT
from formation.deploy.fleet.fleet import PREFIX
from formation.deploy.refusal import Refusal
from formation.deploy.terminal.bar import message_if_slow
from formation.mission.file import MISSION_HELP, configuration_of
from formation.mission.model import Mission
from formation.transport.asking import OPERATOR
from formation.transport.wiring import certificate_remedy, endpoints, members, role, under_certificates

EXAMPLES = """\
  formation doctor                                           on a robot that formation is installed on
  formation doctor field.toml --robot robot2 -c zenoh.json5  on a robot, by hand
  formation doctor field                                     at the desk: all robots, from outside

With --robot (or without MISSION) this machine is that robot, and everything is looked at. Without it only
what agents say of themselves, and whether they can be dialled. Nothing is published, so nothing moves.
Exit code 0: healthy; 1: something is wrong, as named.
"""
EXAMINATIONS = (
    AGENT, MISSION, ROBOT_LINK, WATCHDOG, ODOMETRY, SCANNER, SIGHT, CLOCKS, NEIGHBOURS, CERTIFICATES,
    REFUSALS,
)  # fmt: skip
"""All examinations, in the order of the report."""

TITLE_WIDTH = 13
"""Width of the column for an examination's name [characters]."""
LINE_WIDTH = 80
Checks = Mapping[str, Sequence[Checked]]
"""Results by robot (or desk)."""


class Style(NamedTuple):
    """The marks of results."""

    good: str
    bad: str
    arrow: str
    bold: str
    plain: str


PLAIN = Style("✓", "✗", "→", "", "")
ASCII = Style("+", "!", ">", "", "")
COLOUR = Style("\033[32m✓\033[0m", "\033[31m✗\033[0m", "→", "\033[1m", "\033[0m")


def main(arguments: Sequence[str]) -> int:
    """Examine; return the exit code."""
    options = _options().parse_args(arguments)
    current = options.prefix / "current"
    if options.mission is None:
        installed = current / "mission.toml"
        if not installed.is_file():
            raise Refusal(f"MISSION is missing, and none is installed here: there is no {installed}")
        mission = read_mission(str(installed))
        robot = options.robot or _robot_of(current / "VERSION.json", mission)
    else:
        mission, robot = read_mission(options.mission), options.robot
        if robot is None:
            options.config = options.config or configuration_of(options.mission, OPERATOR)
    with message_if_slow(f"listening for {options.seconds:g} s, and dialling"):
        checks = _desk(options, mission) if robot is None else _robot(options, mission, robot, current)
    text = words(checks, style(text_stream(options)))
    if robot is None and options.config is None and under_certificates(endpoints(mission).agents.values()):
        text += f"\n{certificate_remedy(OPERATOR)}"
    print_result(options, text, lambda: {"mission": mission.name, **as_object(checks)})
    return 0 if ok(checks) else 1


def _robot(options: argparse.Namespace, mission: Mission, robot: str, current: Path) -> Checks:
    if robot not in mission.followers:
        raise Refusal(
            f"--robot {robot!r}: must be a follower of {mission.name}: {', '.join(mission.followers)}"
        )
    config = options.config or (current / "zenoh.json5")
    if options.mission is None and not config.is_file():
        raise Refusal(f"{config} is missing: install this robot's bundle again")
    credentials = tls.credentials_of(config) if options.config or config.is_file() else None
    if options.certificates is not None:
        credentials = tls.credentials_in(options.certificates, [robot]).get(robot, credentials)
    there = current / "mission.toml"
    given = options.mission is not None
    facts = gather.robot_facts(
        mission,
        robot,
        options.seconds,
        credentials,
        there if given and there.is_file() else None,
        options.robot_connect or endpoints(mission).robots[robot],
    )
    return {robot: examine(EXAMINATIONS, facts)}


def _desk(options: argparse.Namespace, mission: Mission) -> Checks:
    credentials = None if options.config is None else tls.credentials_of(options.config)
    facts = gather.fleet_facts(
        mission, members(mission), options.seconds, options.config, credentials, options.certificates
    )
    checks = {
        "desk": examine((LEADING, CLOCKS, CERTIFICATES), gather.desk_facts(mission, credentials, facts))
    }
    checks.update((one.robot, examine(EXAMINATIONS, one)) for one in facts)
    return {name: checked for name, checked in checks.items() if checked}


def _robot_of(version: Path, mission: Mission) -> str:
    """Return the robot that this machine is, by its installation."""
    try:
        data: Any = json.loads(version.read_text(encoding="utf-8"))
        robot = str(data["robot"])
    except (OSError, ValueError, KeyError, TypeError):
        raise Refusal(f"{version} does not say which robot this is: give --robot NAME") from None
    if robot in mission.candidates:
        raise Refusal(
            f"this is the {role(mission, robot)}'s machine: give MISSION, and -c with the operator's"
            " configuration"
        )
    return robot


def words(checks: Checks, style: Style = PLAIN) -> str:
    """Return all results, grouped by robot."""
    lines: list[str] = []
    for name, checked in checks.items():
        lines.append(f"{style.bold}{name}{style.plain}")
        for one in checked:
            lines += _lines(one, style)
        lines.append("")
    counts = {name: sum(len(one.findings) for one in checked) for name, checked in checks.items()}
    found = sum(counts.values())
    if not found:
        return "\n".join([*lines, "healthy: nothing is wrong"])
    where = ", ".join(name for name, count in counts.items() if count)
    things = "1 thing is" if found == 1 else f"{found} things are"
    return "\n".join([*lines, f"{things} wrong: {where}"])


def as_object(checks: Checks) -> dict[str, Any]:
    """Return the results for programs."""
    robots = {
        name: {
            one.title: {
                "ok": not one.findings,
                "seen": one.seen,
                "findings": [f._asdict() for f in one.findings],
            }
            for one in checked
        }
        for name, checked in checks.items()
    }
    return {"ok": ok(checks), "robots": robots}


def ok(checks: Checks) -> bool:
    """Return whether there are no faults."""
    return not any(one.findings for checked in checks.values() for one in checked)


def _lines(one: Checked, style: Style) -> Iterator[str]:
    if not one.findings:
        yield from _wrapped(f"  {style.good} {one.title:<{TITLE_WIDTH}}", one.seen)
    for finding in one.findings:
        yield from _wrapped(f"  {style.bad} {one.title:<{TITLE_WIDTH}}", finding.sentence)
        yield from _wrapped(f"    {'':<{TITLE_WIDTH}}{style.arrow} ", finding.remedy, hang=2)


def _wrapped(head: str, text: str, hang: int = 0) -> Iterator[str]:
    column = 4 + TITLE_WIDTH
    first, *rest = textwrap.wrap(text, LINE_WIDTH - column - hang, break_on_hyphens=False) or [""]
    yield head + first
    yield from (" " * (column + hang) + line for line in rest)


def style(stream: TextIO) -> Style:
    """Return the marks of findings on `stream`: in colour on a terminal, unless NO_COLOR is set."""
    if not (stream.encoding or "").lower().startswith("utf"):
        return ASCII
    return COLOUR if stream.isatty() and not os.environ.get("NO_COLOR") else PLAIN


def _options() -> argparse.ArgumentParser:
    options = parser("doctor", "Name what is wrong, and what to do about it. Moves nothing.", EXAMPLES)
    options.add_argument(
        "mission", metavar="MISSION", nargs="?",
        help=f"{MISSION_HELP} (default: the one that is installed here)",
    )  # fmt: skip
    options.add_argument("--robot", metavar="NAME", help="this machine is that robot")
    options.add_argument(
        "-c", "--config", metavar="FILE", type=Path,
        help="Zenoh configuration: on a robot its agent's, for its certificates; at the desk the operator's",
    )  # fmt: skip
    options.add_argument(
        "--certificates",
        metavar="DIR",
        type=Path,
        help="examine these, made by `formation deploy certificates`",
    )
    options.add_argument(
        "--seconds",
        metavar="S",
        type=number(0.5, 600.0, "s"),
        default=3.0,
        help="time to listen [s] (default 3)",
    )
    options.add_argument(
        "--robot-connect", metavar="ENDPOINT",
        help="the robot's own bridge or router (default: the mission's robot_endpoint)",
    )  # fmt: skip
    options.add_argument(
        "--prefix",
        metavar="PATH",
        type=Path,
        default=PREFIX,
        help=f"where it is installed (default {PREFIX})",
    )
    add_json(options)
    return options
