"""`formation order`: an operator's word to the robots of a running mission, acknowledged one by one."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from deploy.arguments import as_json, number, parser, read_mission
from deploy.refusal import Refusal
from deploy.terminal.waiting import waiting
from formation.mission import Mission
from formation.mission_file import MissionError, parse_route, read
from formation.order import TAKES, OperatorRequest
from formation.outcome import Outcome
from formation.transport import asking, wiring
from formation.transport.asking import OPERATOR
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.flags import add_zenoh, bus_config
from formation.transport.wiring import Links


class Verb(NamedTuple):
    """An order as it is typed."""

    takes: dict[str, str]
    """What belongs to the request, and what the help calls it."""
    means: str


VERBS = {
    "stop": Verb({}, "every robot, at once, told by us and by each other; stopped until released"),
    "release": Verb({}, "end the stop in force; everybody then holds until run"),
    "hold": Verb({}, "every robot stands still where it is, until run"),
    "run": Verb({}, "drive; ends the hold in force, but not a stop"),
    "shape": Verb({"shape": "NAME"}, "take another of the mission's shapes"),
    "rotate": Verb({"degrees": "DEG"}, "turn the shape, counter-clockwise from how it is drawn"),
    "scale": Verb({"factor": "S"}, "make the shape so many times as large as it is drawn"),
    "speed": Verb(
        {"speed": "V", "degrees": "HEADING"}, "straight on from here, V m/s, towards HEADING degrees"
    ),
    "route": Verb({"legs": "FILE"}, "from here along the [[route]] of a TOML file, or of a mission"),
    "tune": Verb({"gains": "GAIN=…"}, "other gains of the law while driving: k_p=2.5 k_i=1, or one of them"),
}

WHAT = "Give an order to the robots of a running mission, and see who obeys.\n\norders:\n"
AFTER = """

Stop, hold, release and run go to each robot directly. The others go to the leader, whose order travels
with the positions; of several, the newest counts. Release and run end the stop or the hold that was in
force when they were ordered; one that came later stays. Only run starts motion."""

EXAMPLES = """\
  formation order six_robots stop
  formation order six_robots release
  formation order six_robots shape wedge
  formation order six_robots rotate -30
  formation order six_robots speed 0.1 90    a tenth of a metre a second, to the left of x
  formation order six_robots tune k_p=3 k_i=1.5
  formation order my_mission.toml stop -e tcp/192.168.1.11:7460 -e tcp/192.168.1.12:7460
  formation order my_mission.toml stop -c operator/zenoh.json5      with the operator's certificate

--json: what was ordered, with its id and when (at: seconds, system clock); leader: who leads, or null;
acknowledged and refused: [{robot, ms, mode, reason, code}], ms since the first question; missing: robots
without an answer; standing_by: who would lead if the leader were gone; unreached: robots whose agent has
latched the stop or the hold, and cannot reach the robot; ends: ids of the stops or holds that this ended.

Exit code 0: every robot and the leader obey; 1: at least one did not answer, refused, or cannot be reached
(after stop: it is NOT STOPPED, use its own switch); 2: nobody was asked.
"""
NEGATIVE = re.compile(r"-\.?\d")


def main(arguments: Sequence[str]) -> int:
    """Give an order; the exit code."""
    # argparse takes -30 for a number, but -3e1 for a flag; what has a space in it is never one
    words = [f" {word}" if NEGATIVE.match(word) else word for word in arguments]
    options = _options().parse_intermixed_args(words)
    mission = read_mission(options.mission)
    request = _request(mission, options.order)
    asked = asking.addressed(mission, request.do)
    try:
        with Bus(_config(options, mission, asked.names)) as bus:
            with waiting(f"asking for up to {options.timeout:g} s"):
                outcome = asking.give(bus.question, asked, request, options.timeout, linked=lambda: bus.links)
            _tell(options, mission, outcome)  # at once: to close the bus may take as long as its patience
    except BusError as error:
        raise Refusal(str(error)) from None
    return 0 if outcome.obeyed else 1


def _tell(options: argparse.Namespace, mission: Mission, outcome: Outcome) -> None:
    print(outcome.words(), flush=True)
    ends = options.connect or wiring.endpoints(mission).agents.values()
    if outcome.missing and options.config is None and wiring.under_certificates(ends):
        print("robots under certificates answer an operator who has one: -c FILE names his configuration")
    if outcome.missing and (whose := _not_the_operators(options.config)):
        print(f"orders are taken from the operator, and {options.config} has the certificate of {whose!r}")
    if options.json:
        print(as_json(outcome.report()), flush=True)


def _options() -> argparse.ArgumentParser:
    orders = [f"  {_typed(do):<18}{verb.means}" for do, verb in VERBS.items()]
    options = parser("order", WHAT + "\n".join(orders) + AFTER, EXAMPLES)
    options.usage = "formation order [options] MISSION ORDER"
    options.add_argument("mission", metavar="MISSION", help="a TOML file, or the name of a shipped mission")
    options.add_argument("order", metavar="ORDER", nargs="*", help="one of those above")
    options.add_argument(
        "--timeout",
        type=number(0.0, 600.0, open_below=True),
        default=3.0,
        metavar="S",
        help="wait so long for answers (default 3)",
    )
    options.add_argument("--json", action="store_true", help="one JSON object as the last line on stdout")
    links = options.add_argument_group(
        "links (without -e and endpoints in FILE those that the mission implies)"
    )
    add_zenoh(links, connect="endpoint of an agent or the leader to dial; repeatable")
    return options


def _typed(do: str) -> str:
    return " ".join([do, *VERBS[do].takes.values()])


def _request(mission: Mission, words: Sequence[str]) -> OperatorRequest:
    """What was typed. Raises Refusal."""
    if not words:
        raise Refusal(f"an order is missing: must be one of {', '.join(VERBS)}")
    do, *given = (word.strip() for word in words)
    if do not in VERBS:
        raise Refusal(f"order {do!r}: must be one of {', '.join(VERBS)}")
    verb = VERBS[do]
    if do == "shape" and not given:
        raise Refusal(f"shape: must be one of {', '.join(mission.shapes)}")
    if do == "tune":
        return _asked(mission, do, _gains(given))
    if len(given) != len(verb.takes):
        takes = " and ".join(verb.takes.values()) or "nothing more"
        raise Refusal(f"{do} takes {takes}; here: {' '.join(given) or 'nothing'}")
    what = {name: READ_AS.get(name, _number)(text) for name, text in zip(verb.takes, given, strict=True)}
    return _asked(mission, do, what)


def _asked(mission: Mission, do: str, what: dict[str, Any]) -> OperatorRequest:
    try:
        return asking.request_for(mission, do, **what)
    except ValueError as error:
        raise Refusal(str(error)) from None


def _gains(words: Sequence[str]) -> dict[str, float]:
    """``k_p=2 k_i=1`` as a table."""
    legal = " and ".join(TAKES["tune"])
    if not words:
        raise Refusal(f"tune takes gains as k_p=2 k_i=1; those that can be tuned are {legal}")
    given: dict[str, float] = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not equals:
            raise Refusal(f"{word!r}: must be a gain as k_p=2; those that can be tuned are {legal}")
        if name not in TAKES["tune"]:
            raise Refusal(f"tune: no gain {name!r} can be tuned; those that can are {legal}")
        if name in given:
            raise Refusal(f"tune: {name} is given twice")
        try:
            given[name] = _number(value)
        except Refusal as refusal:
            raise Refusal(f"tune: {name}: {refusal}") from None
    return given


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise Refusal(f"{text!r}: must be a number") from None


def _route(file: str) -> Any:
    try:
        return parse_route(*read(file))
    except MissionError as error:
        raise Refusal(str(error)) from None


READ_AS: dict[str, Callable[[str], Any]] = {"shape": str, "legs": _route}
"""What is no number."""


def _not_the_operators(config: Path | None) -> str:
    """Whose certificate `config` names, if it is not the operator's; empty else."""
    if config is None:
        return ""
    from deploy.doctor import files  # noqa: PLC0415 - takes longer than a stop

    papers = files.papers_of(config)
    found = None if papers is None else files.read(OPERATOR, papers)
    return "" if found is None or found.name == OPERATOR else found.name


def _config(options: argparse.Namespace, mission: Mission, asked: Sequence[str]) -> BusConfig:
    where = wiring.endpoints(mission).agents
    return bus_config(options, mission, Links((), tuple(where[name] for name in asked)), OPERATOR)
