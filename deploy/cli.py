"""The `formation` command: find the module of a subcommand and pass it the arguments.

A subcommand is imported only when it is used, so that `formation agent` on a robot starts fast and needs
no packages for the desk. Exit codes: 0 success, 1 it ran but failed, 2 nothing was started because of the
arguments, 130 interrupted.
"""

from __future__ import annotations

import argparse
import errno
import io
import os
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.metadata import version
from typing import NamedTuple

from formation.deploy.refusal import Refusal
from formation.transport.runtime.command_line import EXTRAS, Parser, needs


class Command(NamedTuple):
    """A subcommand: a function of a module, ``function(arguments) -> exit code``."""

    module: str
    """Below ``formation``."""
    summary: str
    group: str = ""
    function: str = "main"


HERE = "on this machine"
ALONE = "one process, for a machine of its own"
FIELD = "in the field"
COMMANDS = {
    "run": Command("deploy.local.run", "start every process of a mission here, watch it, record it", HERE),
    "check": Command(
        "deploy.check", "compute whether a mission is stable, how fast, and its delay margin", HERE
    ),
    "simulate": Command(
        "deploy.simulate", "simulate many starts, faster than real time, without a network", HERE
    ),
    "rehearse": Command(
        "deploy.rehearse", "run every process with faults, on a virtual clock, from one seed", HERE
    ),
    "stop": Command("deploy.order", "stop every robot of a running mission, at once", HERE, "stop"),
    "order": Command("deploy.order", "give a running mission's robots any order", HERE),
    "drive": Command("deploy.driving.drive", "drive the leader by hand: keys, gamepad, ROS topic", HERE),
    "follow": Command("deploy.driving.follow", "make goals and paths of ROS routes of the leader", HERE),
    "watch": Command("deploy.watch", "show any running fleet as a table in the terminal", HERE),
    "replay": Command(
        "deploy.recordings.replay",
        "play a recording to the live page, and on keys that no robot receives",
        HERE,
    ),
    "recover": Command("deploy.recordings.recover", "complete a recording that was cut off or damaged", HERE),
    "report": Command(
        "deploy.recordings.report", "make a page and figures of a recording, or of two side by side", HERE
    ),
    "new": Command(
        "deploy.mission_files.new", "write a mission: a line, wedge, circle, … of any number of robots", HERE
    ),
    "assign": Command("deploy.mission_files.assign", "choose slots, and the neighbours to measure", HERE),
    "missions": Command("deploy.mission_files.files", "list the shipped missions, and where they are", HERE),
    "agent": Command("agent.__main__", "control one robot", ALONE),
    "leader": Command("leader.__main__", "move along the route and give the orders", ALONE),
    "watchdog": Command("agent.watchdog.__main__", "stop one robot when its agent is silent", ALONE),
    "robot": Command("agent.simulated.__main__", "simulate one robot or several", ALONE),
    "monitor": Command("monitor.__main__", "measure, record and show on a page", ALONE),
    "deploy": Command(
        "deploy.cli", "install a mission on robots: certificates, bundles, push", FIELD, "deploy"
    ),
    "doctor": Command(
        "deploy.doctor.cli", "say what is wrong with a robot or a fleet, and what to do", FIELD
    ),
}
STEPS = {
    "certificates": Command(
        "deploy.fleet.certificates", "make a CA, and a short-lived certificate for each process"
    ),
    "bundle": Command(
        "deploy.fleet.bundle", "make one folder per robot with all that it needs, without internet"
    ),
    "push": Command("deploy.fleet.push", "put the bundles on all robots over ssh, at the same time"),
    "status": Command(
        "deploy.fleet.fleet_status", "say which robots run which version and mission, since when"
    ),
    "rollback": Command(
        "deploy.fleet.push", "go back to what the robots ran before the last push", function="rollback"
    ),
}
"""Sub-commands of `formation deploy`, in the order of use."""
EXAMPLES = """\
  formation run                          the paper's six robots, in a hexagon
  formation new wedge --robots 7         a mission of your own, into wedge_7.toml
  formation check two_chains             is it stable, how fast, which delay does it tolerate?
  formation simulate six_robots --runs 100 --seed 1
  formation stop                         in a second terminal, while it runs
  formation order six_robots shape wedge
  formation watch six_robots             in a third terminal: the table of robots
  formation replay recordings/six.mcap   see a recording again
  formation agent my_mission.toml --robot robot2

MISSION is a TOML file, a folder of bundles, or the name of a shipped mission.
`formation COMMAND --help` says more.
"""
DEPLOY_EXAMPLES = """\
  formation deploy certificates pair.toml --out secrets
  formation deploy bundle pair.toml --certificates secrets --out field
  formation deploy push field

`formation deploy COMMAND --help` says more.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    _open_closed_streams()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # as stderr: no character may cause a traceback
    try:
        code = _formation(sys.argv[1:] if arguments is None else arguments)
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
    except OSError as error:
        code = _unwritten(error)
    except KeyboardInterrupt:
        print("\nformation: interrupted", file=sys.stderr)
        code = 130
    if arguments is None:
        _leave(code)
    return code


def _open_closed_streams() -> None:
    """Connect streams that the caller has closed (`>&-`) with the null device.

    Otherwise the next file that is opened, such as a recording, would get the number of the closed stream.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: PTH123, SIM115


def _unwritten(error: OSError) -> int:
    """Drop the rest of the output if stdout has failed, and return the exit code; else raise `error`."""
    closed = isinstance(error, BrokenPipeError)
    if not closed and (error.errno not in {errno.ENOSPC, errno.EIO} or error.filename is not None):
        raise error
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if closed:  # by its reader
        return 1
    print(f"formation: the output cannot be written: {error.strerror}", file=sys.stderr)
    return 2


def _leave(code: int) -> None:
    """Exit at once with this code, if the interpreter's own shutdown might change it."""
    bus = sys.modules.get("formation.transport.bus")
    if bus is not None and bus.still_closing():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def deploy(arguments: Sequence[str]) -> int:
    """Run one step of `formation deploy`; return the exit code."""
    steps = "\n".join(f"  {name:<14}{step.summary}" for name, step in STEPS.items())
    usage = "formation deploy [-h] COMMAND ..."
    what = f"Install a mission on robots, one command after the other.\n\n{steps}"
    return _dispatch(Parser("formation deploy", what, DEPLOY_EXAMPLES, usage), STEPS, arguments)


def _formation(arguments: Sequence[str]) -> int:
    overview = ""
    for group in (HERE, ALONE, FIELD):
        named = [f"  {name:<10}{one.summary}" for name, one in COMMANDS.items() if one.group == group]
        overview += "\n".join(["", "", f"{group}:", *named])
    what = "Decentralised formation control of unicycle robots, one agent process per robot." + overview
    parser = Parser("formation", what, EXAMPLES, "formation [-h] [--version] COMMAND ...")
    parser.add_argument("--version", action="version", version=f"formation {version('zenoh-formation')}")
    return _dispatch(parser, COMMANDS, arguments)


def _dispatch(parser: Parser, commands: Mapping[str, Command], arguments: Sequence[str]) -> int:
    """Call the command that `arguments` begin with."""
    parser.add_argument("command", metavar="COMMAND", choices=commands, help=argparse.SUPPRESS)
    parser.add_argument("rest", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    if not arguments:
        parser.print_help(sys.stderr)
        return 2
    chosen = parser.parse_args(arguments)
    command = commands[chosen.command]
    code: int = getattr(import_module(f"formation.{command.module}"), command.function)(chosen.rest)
    return code
