"""`formation deploy`: find the module of a sub-command and pass it the arguments."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import NamedTuple

from formation.deploy.arguments import parser


class Step(NamedTuple):
    """A sub-command: a module with ``main(arguments) -> exit code``, imported when asked for."""

    module: str
    summary: str


STEPS = {
    "certificates": Step(
        "formation.deploy.fleet.certificates", "a CA, and a short-lived certificate for each process"
    ),
    "bundle": Step(
        "formation.deploy.fleet.bundle", "one folder per robot with all that it needs, without internet"
    ),
    "push": Step("formation.deploy.fleet.push", "put the bundles on all robots over ssh, at the same time"),
    "status": Step(
        "formation.deploy.fleet.fleet_status", "which robots run which version and mission, since when"
    ),
    "rollback": Step("formation.deploy.fleet.rollback", "back to what the robots ran before the last push"),
}
"""Sub-commands, in the order of use."""

EXAMPLES = """\
  formation deploy certificates field.toml --out secrets
  formation deploy bundle field.toml --certificates secrets --out bundles
  formation deploy push bundles

`formation deploy COMMAND --help` says more.
"""


def main(arguments: Sequence[str]) -> int:
    """Run one step; return the exit code."""
    overview = "\n".join(f"  {name:<14}{step.summary}" for name, step in STEPS.items())
    options = parser(
        "deploy", f"Bring a mission onto robots, one command after the other.\n\n{overview}", EXAMPLES
    )
    options.usage = "formation deploy [-h] COMMAND ..."
    options.add_argument("command", metavar="COMMAND", choices=STEPS, help=argparse.SUPPRESS)
    options.add_argument("rest", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    if not arguments:
        options.print_help(sys.stderr)
        return 2
    chosen = options.parse_args(arguments)
    code: int = import_module(STEPS[chosen.command].module).main(chosen.rest)
    return code
