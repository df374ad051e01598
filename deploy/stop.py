"""`formation stop`: stop every robot of a mission, as `formation order MISSION stop` does."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from formation.deploy.arguments import parser, read_mission
from formation.deploy.order import add_request_flags, give
from formation.deploy.refusal import Refusal
from formation.mission.file import DESK, MISSION_HELP, MISSION_NAME
from formation.transport import asking

DEFAULT = "six_robots"
"""Default mission of `formation run`."""
EXAMPLES = f"""\
  formation stop                 the robots of the bundles in this folder; without bundles {DEFAULT}
  formation stop field           the robots of the bundles in the folder field, with its operator.json5
  formation stop my_mission.toml -e tcp/192.168.1.11:7460 -e tcp/192.168.1.12:7460

Answers, flags and exit codes are those of `formation order`: 0: every robot and the leader have stopped;
1: at least one has not (NOT STOPPED: use its own switch); 2: no robot was asked.
Stopped robots stay stopped until `formation order MISSION release`.
"""


def main(arguments: Sequence[str]) -> int:
    """Stop; return the exit code."""
    options = _options().parse_args(arguments)
    named = options.mission is not None
    if not named:
        options.mission = found(Path())
        print(f"formation: stopping {options.mission}", file=sys.stderr, flush=True)
    mission = read_mission(options.mission)
    code = give(options, mission, asking.request_for(mission, "stop"))
    if code and not named:
        print("formation: if another mission runs: formation stop MISSION", file=sys.stderr)
    return code


def found(here: Path) -> str:
    """Return the mission to stop if none is named. Raises Refusal if bundles of several are here."""
    desks = [here / DESK, *sorted(here.glob(f"*/{DESK}"))]
    fleets = [str(desk.parent) for desk in desks if os.access(desk / MISSION_NAME, os.R_OK)]
    if len(fleets) > 1:
        raise Refusal(f"several fleets are here: formation stop {', or formation stop '.join(fleets)}")
    return fleets[0] if fleets else DEFAULT


def _options() -> argparse.ArgumentParser:
    options = parser("stop", "Stop every robot of a running mission, at once.", EXAMPLES)
    options.add_argument("mission", metavar="MISSION", nargs="?", help=MISSION_HELP)
    add_request_flags(options)
    return options
