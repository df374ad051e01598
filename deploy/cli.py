"""The `formation` command: find the module of a subcommand and pass it the arguments.

A subcommand is imported only when it is used, so that `formation agent` on a robot starts fast and needs
no packages for the desk. Exit codes: 0 success, 1 it ran but failed, 2 nothing was started because of the
arguments, 130 interrupted.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version
from typing import NamedTuple

from formation.deploy.refusal import Refusal
from formation.transport.runtime.command_line import EXTRAS, Parser, needs


class Command(NamedTuple):
    """A subcommand: a module with ``main(arguments) -> exit code``."""

    module: str
    group: str
    summary: str


HERE = "on this machine"
ALONE = "one process, for a machine of its own"
FIELD = "in the field"
COMMANDS = {
    "run": Command(
        "formation.deploy.run", HERE, "start every process of a mission here, watch it, record it"
    ),
    "check": Command(
        "formation.deploy.check", HERE, "is this mission stable, how fast, how much delay does it bear?"
    ),
    "simulate": Command(
        "formation.deploy.simulate", HERE, "many starts, faster than real time, without a network"
    ),
    "rehearse": Command(
        "formation.deploy.rehearse", HERE, "every process with faults, on a virtual clock, from one seed"
    ),
    "stop": Command("formation.deploy.stop", HERE, "stop every robot of a running mission, at once"),
    "order": Command("formation.deploy.order", HERE, "give a running mission's robots any order"),
    "watch": Command("formation.deploy.watch", HERE, "a table of any running fleet in the terminal"),
    "replay": Command(
        "formation.deploy.replay", HERE, "play a recording to the live page, and onto keys of its own"
    ),
    "recover": Command("formation.deploy.recover", HERE, "make a recording whole that was cut off"),
    "report": Command(
        "formation.deploy.report", HERE, "a recording as a page and figures; two, side by side"
    ),
    "new": Command(
        "formation.deploy.new", HERE, "write a mission: a line, wedge, circle, … of so many robots"
    ),
    "assign": Command("formation.deploy.assign", HERE, "choose slots, and the neighbours to measure"),
    "missions": Command("formation.deploy.mission_list", HERE, "what the shipped missions are, and where"),
    "agent": Command("formation.agent.__main__", ALONE, "control one robot"),
    "leader": Command("formation.leader.__main__", ALONE, "go along the route and give the orders"),
    "watchdog": Command(
        "formation.agent.watchdog.__main__", ALONE, "stop one robot when its agent falls silent"
    ),
    "robot": Command("formation.agent.simulated.__main__", ALONE, "simulate one robot or several"),
    "monitor": Command("formation.monitor.__main__", ALONE, "measure, record and show on a page"),
    "deploy": Command(
        "formation.deploy.fleet.cli", FIELD, "bring a mission onto robots: certificates, bundles, push"
    ),
    "doctor": Command(
        "formation.deploy.doctor.cli", FIELD, "what is wrong with a robot or a team, and what to do"
    ),
}
EXAMPLES = """\
examples:
  formation run                          six robots, until they hold the paper's formation
  formation new wedge --robots 7         a mission of your own, into wedge_7.toml
  formation check two_chains             what the eigenvalues say of a mission
  formation simulate six_robots --runs 100 --seed 1
  formation stop                         in a second terminal, while it runs
  formation order six_robots shape wedge
  formation watch six_robots             and what that does, in a third
  formation replay recordings/six.mcap   what happened, once more
  formation agent my_mission.toml --robot robot2

MISSION is a TOML file or the name of a shipped mission. `formation COMMAND --help` says more.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # as stderr: no character may cause a traceback
    try:
        code = _dispatch(sys.argv[1:] if arguments is None else arguments)
        sys.stdout.flush()
    except SystemExit as stop:  # argparse has printed the error
        code = stop.code if isinstance(stop.code, int) else 2
    except Refusal as refusal:
        print(f"formation: {refusal}", file=sys.stderr)
        code = 2
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRAS:
            raise
        print(f"formation: this {needs(package)}", file=sys.stderr)
        code = 2
    except BrokenPipeError:  # the reader of the output has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except KeyboardInterrupt:
        print("\nformation: interrupted", file=sys.stderr)
        code = 130
    if arguments is None:
        _leave(code)
    return code


def _leave(code: int) -> None:
    """Exit at once with this code, if the interpreter's own shutdown might change it."""
    bus = sys.modules.get("formation.transport.bus")
    if bus is not None and bus.still_closing():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _dispatch(arguments: Sequence[str]) -> int:
    parser = Parser(
        prog="formation",
        usage="formation [-h] [--version] COMMAND ...",
        description="Decentralised formation control of unicycle robots, one agent process per robot."
        + _overview(),
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"formation {version('zenoh-formation')}")
    parser.add_argument("command", metavar="COMMAND", choices=COMMANDS, help=argparse.SUPPRESS)
    parser.add_argument("rest", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    if not arguments:
        parser.print_help(sys.stderr)
        return 2
    chosen = parser.parse_args(arguments)
    module = import_module(COMMANDS[chosen.command].module)
    code: int = module.main(chosen.rest)
    return code


def _overview() -> str:
    text = ""
    for group in (HERE, ALONE, FIELD):
        text += f"\n\n{group}:\n"
        text += "\n".join(
            f"  {name:<10}{command.summary}" for name, command in COMMANDS.items() if command.group == group
        )
    return text
