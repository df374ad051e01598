"""`formation order`: an operator's word to the robots of a running mission, acknowledged one by one."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import get_args

from deploy.arguments import as_json, number, parser, read_mission
from deploy.doctor import files
from deploy.refusal import Refusal
from deploy.terminal.waiting import waiting
from formation.mission import Mission
from formation.order import Do
from formation.transport import asking, wiring
from formation.transport.asking import OPERATOR
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.flags import add_zenoh, bus_config
from formation.transport.wiring import Links

EXAMPLES = """\
  formation order six_robots stop            every robot, at once; it stays stopped until released
  formation order six_robots release
  formation order six_robots hold            the leader, whose order travels with the positions
  formation order six_robots shape wedge     another shape of the mission; the one asked for last counts
  formation order my_mission.toml stop -e tcp/192.168.1.11:7460 -e tcp/192.168.1.12:7460
  formation order my_mission.toml stop -c operator/zenoh.json5      with the operator's certificate

Exit code 0: everyone asked has obeyed; 1: somebody did not answer, or refused; 2: nobody was asked.
"""


def main(arguments: Sequence[str]) -> int:
    """Give an order; the exit code."""
    options = _options().parse_args(arguments)
    mission = read_mission(options.mission)
    asked = asking.addressed(mission, options.do)
    try:
        request = asking.request_for(mission, options.do, options.shape)
    except ValueError as error:
        raise Refusal(str(error)) from None
    try:
        with (
            waiting(f"asking for up to {options.timeout:g} s"),
            Bus(_config(options, mission, asked)) as bus,
        ):
            answers = asking.ask(bus.ask, asked, request, options.timeout)
    except BusError as error:
        raise Refusal(str(error)) from None
    print(asking.words(request, asked, answers, options.timeout))
    ends = options.connect or wiring.endpoints(mission).agents.values()
    if len(answers) < len(asked) and options.config is None and wiring.under_certificates(ends):
        print("robots under certificates answer an operator who has one: -c FILE names his configuration")
    if len(answers) < len(asked) and (whose := _not_the_operators(options.config)):
        print(f"orders are taken from the operator, and {options.config} has the certificate of {whose!r}")
    if options.json:
        print(as_json(asking.report(request, asked, answers)))
    return 0 if asking.obeyed(asked, answers) else 1


def _options() -> argparse.ArgumentParser:
    options = parser(
        "order",
        "Hold, run, stop or release the robots of a running mission, or change their shape; see who obeys.",
        EXAMPLES,
    )
    options.add_argument("mission", metavar="MISSION", help="a TOML file, or the name of a shipped mission")
    options.add_argument(
        "do",
        choices=get_args(Do),
        help="hold, run, shape: by way of the leader; stop: each robot at once, until released",
    )
    options.add_argument(
        "shape", metavar="NAME", nargs="?", help="with shape: which of the mission's shapes to take"
    )
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


def _not_the_operators(config: Path | None) -> str:
    """Whose certificate `config` names, if it is not the operator's; empty else."""
    papers = None if config is None else files.papers_of(config)
    read = None if papers is None else files.read(OPERATOR, papers)
    return "" if read is None or read.name == OPERATOR else read.name


def _config(options: argparse.Namespace, mission: Mission, asked: Iterable[str]) -> BusConfig:
    where = wiring.endpoints(mission).agents
    return bus_config(options, mission, Links((), tuple(where[name] for name in asked)), OPERATOR)
