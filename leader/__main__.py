"""`formation leader`, or `python -m formation.leader`: follow the route and give orders, or stand by."""

from __future__ import annotations

import argparse
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path

from formation.control.laws import why_unusable
from formation.leader.core import Leader
from formation.leader.process import TermFile, lead
from formation.mission.file import configuration_of, load
from formation.mission.model import Mission
from formation.transport import wiring
from formation.transport.runtime import flags
from formation.transport.runtime.process import BadInput, Process, Stop, one_of, run_process
from formation.transport.security.verifying import signer_of

EXAMPLES = """\
  formation leader six_robots
  formation leader six_robots --hold          wait until `formation order six_robots run`
  formation leader patrol --standby deputy    take the leader's place when it is gone
  formation leader my_mission.toml -l tcp/0.0.0.0:7447
  formation leader field --hold               with the configuration in this folder of bundles
  python -m formation.leader six_robots                 the same as the first"""
ONLY = ""
"""The standby if there is only one."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Lead until told to stop; return the exit code."""
    parser = flags.parser("leader", "Move along the mission's route and give the orders.", EXAMPLES)
    parser.add_argument(
        "--hold", action="store_true", help="hold until `run` is ordered, unless the fleet is under way"
    )
    parser.add_argument(
        "--standby",
        metavar="NAME",
        nargs="?",
        const=ONLY,
        help="be this one of the mission's standbys; without NAME its only one",
    )
    parser.add_argument(
        "--anew",
        action="store_true",
        help="begin at the start of the route, even if robots relay an earlier leader's place",
    )
    parser.add_argument(
        "--state", metavar="DIR", type=Path,
        help="keep the newest term in this folder: after a restart robots follow at once, even if the clock"
        " was set back (default: learned from the robots again)",
    )  # fmt: skip
    args = parser.parse_args(arguments)
    return run_process("leader", args, lambda stop: _run(args, stop))


def _run(args: argparse.Namespace, stop: Stop) -> None:
    mission = load(args.mission)
    if (why := why_unusable(mission.law.kind)) is not None:
        raise BadInput(f"{args.mission}: {why}")
    name = _candidate(mission, args.standby)
    part = "leader" if name == mission.leader else name
    args.config = args.config or configuration_of(args.mission, part)
    links = wiring.of_member(mission, name, wiring.endpoints(mission))
    called = "leader" if name == "leader" else f"leader {name}"
    config = flags.bus_config(args, mission, links, called)
    signer, verifier = signer_of(config, mission, name) or (None, None)
    terms = _term_file(args.state, name)
    leader = Leader(
        mission,
        name,
        hold=args.hold,
        anew=args.anew,
        publisher_id=secrets.token_hex(8),
        signer=signer,
        known=0 if terms is None else terms.read(),
    )
    with Process(called, args, config, stop) as process:
        try:
            process.play(lead(leader, process, verifier, None if terms is None else terms.save))
        finally:
            if terms is not None:
                terms.close()


def _term_file(folder: Path | None, name: str) -> TermFile | None:
    """Return the term file in `folder`. Raises BadInput."""
    try:
        return None if folder is None else TermFile(folder, name)
    except OSError as error:
        raise BadInput(f"--state {folder}: must be a writable folder: {error.strerror}") from None


def _candidate(mission: Mission, standby: str | None) -> str:
    """Return the name of this candidate. Raises BadInput."""
    if standby is None:
        return mission.leader
    if not mission.standbys:
        raise BadInput(
            f"--standby: {mission.name} has no standbys; list one in the mission: [standbys.NAME], "
            "with its endpoint if it is not to run on this machine"
        )
    if standby == ONLY:
        if len(mission.standbys) > 1:
            raise BadInput(f"--standby: say which one: {', '.join(mission.standbys)}")
        return next(iter(mission.standbys))
    return one_of("--standby", standby, mission.standbys)


if __name__ == "__main__":
    sys.exit(main())
