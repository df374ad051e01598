"""`formation leader`, or `python -m leader`: go along the route and give the orders."""

from __future__ import annotations

import argparse
import secrets
import sys
from collections.abc import Sequence

from formation.mission_file import load
from formation.transport import flags, wiring
from formation.transport.process import Process, Stop, run_process
from leader.core import Leader
from leader.loop import lead

EXAMPLES = """\
  formation leader six_robots
  formation leader six_robots --hold          wait at the start until `formation order six_robots run`
  formation leader my_mission.toml -l tcp/0.0.0.0:7447
  python -m leader six_robots                 the same as the first"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Lead until told to stop; the exit code."""
    parser = flags.parser("leader", "Go along the mission's route and give the orders.", EXAMPLES)
    parser.add_argument("--hold", action="store_true", help="wait at the start until told to run")
    args = parser.parse_args(arguments)
    return run_process("leader", args, lambda stop: _run(args, stop))


def _run(args: argparse.Namespace, stop: Stop) -> None:
    mission = load(args.mission)
    links = wiring.of_leader(mission, wiring.endpoints(mission))
    name = f"leader {mission.leader}"
    with Process(name, args, flags.bus_config(args, mission, links, name), stop) as process:
        lead(Leader(mission, hold=args.hold, voice=secrets.token_hex(8)), process)


if __name__ == "__main__":
    sys.exit(main())
