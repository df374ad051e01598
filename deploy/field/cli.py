"""`formation deploy`: finds the module of a sub-command and hands it the arguments."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import NamedTuple

from deploy.arguments import parser


class Step(NamedTuple):
    """A sub-command: a module with ``main(arguments) -> exit code``, imported when asked for."""

    module: str
    summary: str


STEPS = {
    "certificates": Step("deploy.field.certificates", "a CA, and a short-lived certificate for each process"),
    "bundle": Step("deploy.field.bundle", "one folder per robot with all that it needs, without internet"),
    "push": Step("deploy.field.push", "put the bundles on all robots over ssh, at the same time"),
    "status": Step("deploy.field.fleet_status", "which robots run which version and mission, since when"),
    "rollback": Step("deploy.field.rollback", "back to what the robots ran before the last push"),
}
"""In the order in which they are used."""

EXAMPLES = """\
  formation deploy certificates field.toml --out secrets
  formation deploy bundle field.toml --certificates secrets --out bundles
  formation deploy push bundles

`formation deploy COMMAND --help` says more.
"""


def main(arguments: Sequence[str]) -> int:
    """Run one step; the exit code."""
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
