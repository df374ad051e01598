"""`formation order` and `formation stop`: order the robots of a running mission; each acknowledges it."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from formation.deploy.arguments import (
    add_json,
    add_links,
    add_mission,
    number,
    parser,
    print_result,
    read_mission,
)
from formation.deploy.links import no_answer_message, operator_bus
from formation.deploy.refusal import Refusal, refuse_errors
from formation.deploy.terminal.bar import message_if_slow
from formation.mission.file import (
    DESK,
    MISSION_HELP,
    MISSION_NAME,
    MissionError,
    parse_route,
    read,
)
from formation.mission.model import Mission
from formation.protocol.outcome import Outcome
from formation.protocol.request import TAKES, OperatorRequest
from formation.protocol.stops import MOTION
from formation.stability import intent
from formation.transport import asking, wiring
from formation.transport.asking import OPERATOR

DEFAULT_MISSION = "six_robots"
"""Default mission of `formation run`, and of `formation stop` where there are no bundles."""


class Verb(NamedTuple):
    """An order on the command line."""

    arguments: dict[str, str]
    """Values of the request, with their names in the help."""
    help: str


VERBS = {
    "stop": Verb({}, "every robot, at once, by this command and by the other robots; stopped until released"),
    "release": Verb({}, "end the stop in force; all robots then hold until run"),
    "hold": Verb({}, "every robot stands still where it is, until run"),
    "run": Verb({}, "drive; ends the hold in force, but not a stop"),
    "shape": Verb({"shape": "NAME"}, "take another of the mission's shapes"),
    "rotate": Verb({"degrees": "DEG"}, "turn the shape, counter-clockwise from how it is drawn"),
    "scale": Verb({"factor": "S"}, "scale the shape by this factor, from how it is drawn"),
    "speed": Verb(
        {"speed": "V", "degrees": "HEADING"}, "straight on from here, V m/s, towards HEADING degrees"
    ),
    "route": Verb({"legs": "FILE"}, "from here along the [[route]] of a TOML file, or of a mission"),
    "tune": Verb({"gains": "GAIN=…"}, "other gains of the law while driving: k_p=2.5 k_i=1, or one of them"),
}

SUMMARY = "Give an order to the robots of a running mission, and see which robots obey.\n\norders:\n"
EPILOGUE = """

Stop, hold, release and run go to each robot directly. The others go to the leader; its order travels
with the positions; of several, the newest counts. Release and run end the stop or the hold that was in
force when they were ordered; one that came later stays. Only run starts motion."""

EXAMPLES = """\
  formation order six_robots stop
  formation order six_robots release
  formation order six_robots shape wedge
  formation order six_robots rotate -30
  formation order six_robots speed 0.1 90    a tenth of a metre a second, to the left of x
  formation order six_robots tune k_p=3
  formation order my_mission.toml stop -e tcp/192.168.1.11:7460 -e tcp/192.168.1.12:7460
  formation order field stop                 robots with certificates, by the folder of their bundles
  formation order my_mission.toml stop -c field/desk/operator.json5     or with the operator's configuration

--json: what was ordered, with its id and when (at: seconds, system clock); leader: its name, or null;
acknowledged and refused: [{robot, ms, mode, reason, code}], ms since the first question; missing: robots
without an answer; standby: the one that would lead next; unreached: robots with an agent that
latched the stop or the hold, and cannot reach the robot; ends: ids of the stops or holds that this ended.

Exit code 0: every robot and the leader obey; 1: at least one did not answer, refused, or cannot be reached
(after stop: it is NOT STOPPED, use its own switch); 2: no robot was asked.
"""
STOP_EXAMPLES = f"""\
  formation stop                 the robots of the bundles in this folder; without bundles {DEFAULT_MISSION}
  formation stop field           the robots of the bundles in the folder field, with its operator.json5
  formation stop my_mission.toml -e tcp/192.168.1.11:7460 -e tcp/192.168.1.12:7460

Answers, flags and exit codes are those of `formation order`: 0: every robot and the leader have stopped;
1: at least one has not (NOT STOPPED: use its own switch); 2: no robot was asked.
Stopped robots stay stopped until `formation order MISSION release`.
"""
NEGATIVE = re.compile(r"-\.?\d")


def main(arguments: Sequence[str]) -> int:
    """Give an order; return the exit code."""
    # argparse takes -30 for a number, but -3e1 for a flag; what has a space in it is never one
    words = [f" {word}" if NEGATIVE.match(word) else word for word in arguments]
    options = _options().parse_intermixed_args(words)
    if options.mission in VERBS and not Path(options.mission).exists():
        name, *values = options.order or ["MISSION"]
        right = " ".join([name, options.mission, *(value.strip() for value in values)])
        raise Refusal(f"{options.mission} is an order, and MISSION comes first: formation order {right}")
    mission = read_mission(options.mission)
    return give(options, mission, _request(mission, options.order))


def stop(arguments: Sequence[str]) -> int:
    """Stop every robot, also where no mission is named; return the exit code."""
    flags = parser("stop", "Stop every robot of a running mission, at once.", STOP_EXAMPLES)
    flags.add_argument("mission", metavar="MISSION", nargs="?", help=MISSION_HELP)
    flags.add_argument("more", nargs="*", help=argparse.SUPPRESS)
    add_request_flags(flags)
    options = flags.parse_intermixed_args(arguments)
    if options.more:
        command = f"formation stop {shlex.quote(options.mission)}"
        raise Refusal(_takes_nothing_more("stop", options.more, command))
    named = options.mission is not None
    if not named:
        options.mission = mission_to_stop(Path())
        print(f"formation: stopping {options.mission}", file=sys.stderr, flush=True)
    mission = read_mission(options.mission)
    code = give(options, mission, intent.request_for(mission, "stop"))
    if code and not named:
        print("formation: if another mission runs: formation stop MISSION", file=sys.stderr)
    return code


def mission_to_stop(here: Path) -> str:
    """Return the mission to stop if none is named. Raises Refusal if bundles of several are here."""
    desks = [here / DESK, *sorted(here.glob(f"*/{DESK}"))]
    readable = [desk for desk in desks if os.access(desk / MISSION_NAME, os.R_OK)]
    # a link to one of them, such as `latest`, is no second fleet
    fleets = list({os.path.realpath(desk): str(desk.parent) for desk in reversed(readable)}.values())[::-1]
    if len(fleets) > 1:
        raise Refusal(f"several fleets are here: formation stop {', or formation stop '.join(fleets)}")
    return fleets[0] if fleets else DEFAULT_MISSION


def give(options: argparse.Namespace, mission: Mission, request: OperatorRequest) -> int:
    """Ask all robots concerned, and print the answers; return the exit code. Raises Refusal."""
    recipients = asking.addressed(mission, request.do)
    with operator_bus(options, mission, recipients.names) as bus:
        with message_if_slow(f"asking for up to {options.timeout:g} s"):
            outcome = asking.give(
                bus.question, recipients, request, options.timeout, linked=lambda: bus.links
            )
        _print_outcome(options, mission, outcome)  # at once: closing the bus may take its whole patience
    return 0 if outcome.obeyed else 1


def _print_outcome(options: argparse.Namespace, mission: Mission, outcome: Outcome) -> None:
    lines = [outcome.words()]
    ends = options.connect or wiring.endpoints(mission).agents.values()
    if not outcome.answers:
        lines.append(no_answer_message(mission, options, OPERATOR))
    elif outcome.missing and options.config is None and wiring.under_certificates(ends):
        lines.append(wiring.certificate_remedy(OPERATOR))
    if outcome.missing and (name := _not_the_operators(options.config)):
        lines.append(f"only the operator may give orders; {options.config} has the certificate of {name!r}")
    print_result(options, "\n".join(lines), outcome.report)


def _options() -> argparse.ArgumentParser:
    typed = {do: " ".join([do, *verb.arguments.values()]) for do, verb in VERBS.items()}
    orders = [f"  {typed[do]:<18}{verb.help}" for do, verb in VERBS.items()]
    options = parser("order", SUMMARY + "\n".join(orders) + EPILOGUE, EXAMPLES)
    options.usage = "formation order [options] MISSION ORDER"
    add_mission(options, law=False)
    options.add_argument("order", metavar="ORDER", nargs="*", help="one of those above")
    add_request_flags(options)
    return options


def add_request_flags(options: argparse.ArgumentParser) -> None:
    """Add the flags for asking robots and printing the answers."""
    options.add_argument(
        "--timeout",
        type=number(0.0, 600.0, "s", open_below=True),
        default=3.0,
        metavar="S",
        help="longest wait for answers [s] (default 3)",
    )
    add_json(options)
    add_links(options)


def _request(mission: Mission, words: Sequence[str]) -> OperatorRequest:
    """Return the typed request. Raises Refusal."""
    if not words:
        raise Refusal(f"an order is missing: must be one of {', '.join(VERBS)}")
    do, *given = (word.strip() for word in words)
    if do not in VERBS:
        raise Refusal(f"order {do!r}: must be one of {', '.join(VERBS)}")
    verb = VERBS[do]
    if do == "shape" and not given:
        raise Refusal(f"shape: must be one of {', '.join(mission.shapes)}")
    if do == "tune":
        return _request_for(mission, do, _gains(given))
    if given and do in MOTION:
        raise Refusal(_takes_nothing_more(do, given, f"formation order MISSION {do}"))
    if len(given) != len(verb.arguments):
        takes = " and ".join(verb.arguments.values()) or "nothing more"
        what_for = f" ({verb.help})" if verb.arguments else ""
        raise Refusal(f"{do} takes {takes}{what_for}; here: {' '.join(given) or 'nothing'}")
    what = {
        name: READERS[name](text) if name in READERS else _number(f"{do} {label}", text)
        for (name, label), text in zip(verb.arguments.items(), given, strict=True)
    }
    return _request_for(mission, do, what)


def _takes_nothing_more(do: str, given: Sequence[str], command: str) -> str:
    """Return why a stop, hold, release or run takes nothing more, such as a robot's name."""
    return (
        f"{do} is for all robots and takes nothing more; here: {' '.join(given)}. All robots: {command}."
        " One robot: on it, sudo systemctl stop formation-agent"
    )


def _request_for(mission: Mission, do: str, what: dict[str, Any]) -> OperatorRequest:
    with refuse_errors(ValueError):
        return intent.request_for(mission, do, **what)


def _gains(words: Sequence[str]) -> dict[str, float]:
    """Return ``k_p=2 k_i=1`` as a table."""
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
        given[name] = _number(f"tune {name}", value)
    return given


def _number(what: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise Refusal(f"{what}: {text!r}: must be a number without a unit") from None


def _route(file: str) -> Any:
    with refuse_errors(MissionError):
        return parse_route(*read(file))


READERS: dict[str, Callable[[str], Any]] = {"shape": str, "legs": _route}
"""Readers of values that are not numbers."""


def _not_the_operators(config: Path | None) -> str:
    """Return the owner of the certificate in `config`, if it is not the operator; empty else."""
    if config is None:
        return ""
    from formation.deploy.doctor import tls  # noqa: PLC0415 - takes longer than a stop

    credentials = tls.credentials_of(config)
    found = None if credentials is None else tls.read(OPERATOR, credentials)
    return "" if found is None or found.name == OPERATOR else found.name
