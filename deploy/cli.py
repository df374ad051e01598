"""The `formation` command: finds the module of a subcommand and hands it the arguments.

A subcommand is imported when it is asked for and not before, so that `formation agent` on a robot starts fast
and needs nothing that only a desk has. Exit codes: 0 as wished, 1 it ran but not as wished, 2 nothing was
started because of what was asked, 130 interrupted.
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

from deploy.refusal import Refusal


class Command(NamedTuple):
    """A subcommand: a module with ``main(arguments) -> exit code``."""

    module: str
    group: str
    summary: str


HERE = "on this machine"
ALONE = "one process, for a machine of its own"
FIELD = "in the field"
COMMANDS = {
    "run": Command("deploy.run", HERE, "start every process of a mission here, watch it, record it"),
    "check": Command("deploy.check", HERE, "is this mission stable, how fast, how much delay does it bear?"),
    "simulate": Command("deploy.simulate", HERE, "many starts, faster than real time, without a network"),
    "order": Command("deploy.order", HERE, "stop a running mission's robots, or give them any other order"),
    "watch": Command("deploy.watch", HERE, "a table of any running fleet in the terminal"),
    "replay": Command("deploy.replay", HERE, "play a recording to the live page, and onto keys of its own"),
    "recover": Command("deploy.recover", HERE, "make a recording whole that was cut off"),
    "report": Command("deploy.report", HERE, "a recording as a page and figures; two, side by side"),
    "new": Command("deploy.new", HERE, "write a mission: a line, wedge, circle, … of so many robots"),
    "assign": Command("deploy.assign", HERE, "who takes which slot, and whom to measure"),
    "missions": Command("deploy.shelf", HERE, "list the missions that are shipped"),
    "agent": Command("agent.__main__", ALONE, "control one robot"),
    "leader": Command("leader.__main__", ALONE, "go along the route and give the orders"),
    "guard": Command("agent.robots.guard.__main__", ALONE, "stop one robot when its agent falls silent"),
    "robot": Command("agent.robots.__main__", ALONE, "simulate one robot or several"),
    "monitor": Command("monitor.__main__", ALONE, "measure, record and show on a page"),
    "deploy": Command("deploy.field.cli", FIELD, "bring a mission onto robots: certificates, bundles, push"),
    "doctor": Command("deploy.doctor.cli", FIELD, "what is wrong with a robot or a team, and what to do"),
}
EXTRAS = {
    **dict.fromkeys(
        ("rich", "mcap", "lz4", "zstandard", "starlette", "uvicorn", "prometheus_client"), "monitor"
    ),
    "matplotlib": "plot",
    "jinja2": "plot",
    "markupsafe": "plot",
    "cryptography": "field",
    "foxglove": "foxglove",
    **dict.fromkeys(("mujoco", "PIL"), "physics"),
}
"""The extra that brings a package which a robot does without."""

EXAMPLES = """\
examples:
  formation run                          six robots, until they hold the paper's formation
  formation new wedge --robots 7         a mission of your own, into wedge_7.toml
  formation check two_chains             what the eigenvalues say of a mission
  formation simulate six_robots --runs 100 --seed 1
  formation order six_robots stop        in a second terminal, while it runs
  formation watch six_robots             and what that does, in a third
  formation replay recordings/six.mcap   what happened, once more
  formation agent my_mission.toml --robot robot2

MISSION is a TOML file or the name of a shipped mission. `formation COMMAND --help` says more.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # as stderr: no sign is worth a traceback
    try:
        code = _dispatch(sys.argv[1:] if arguments is None else arguments)
        sys.stdout.flush()
    except SystemExit as stop:  # argparse has said what there is to say
        code = stop.code if isinstance(stop.code, int) else 2
    except Refusal as refusal:
        print(f"formation: {refusal}", file=sys.stderr)
        code = 2
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        print(f"formation: this needs {error.name}: pip install 'formation[{extra}]'", file=sys.stderr)
        code = 2
    except BrokenPipeError:  # whoever read the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except KeyboardInterrupt:
        print("\nformation: interrupted", file=sys.stderr)
        code = 130
    if arguments is None:
        _leave(code)
    return code


def _leave(code: int) -> None:
    """End here and now, with this code, if the interpreter's own end might become another."""
    bus = sys.modules.get("formation.transport.bus")
    if bus is not None and bus.still_closing():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _dispatch(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        prog="formation",
        usage="formation [-h] [--version] COMMAND ...",
        description="Decentralised formation control of unicycle robots, one agent process per robot."
        + _overview(),
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"formation {version('formation')}")
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
