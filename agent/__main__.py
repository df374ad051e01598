"""`python -m agent`: one follower's controller as a process of its own."""

from __future__ import annotations

import argparse
import secrets
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from agent.core import Agent
from agent.keeping import Keeping
from agent.loop import drive
from formation.law import LAWS
from formation.mission_file import load
from formation.transport import wiring
from formation.transport.certified import verifier_of
from formation.transport.flags import add_robot_connect, bus_config, parser, robot_bus
from formation.transport.process import BadInput, Process, Stop, one_of, run_process

EXAMPLES = """\
  formation agent six_robots --robot robot2
  formation agent field.toml --robot robot2 --readonly           everything but moving
  formation agent field.toml --robot robot2 --robot-connect tcp/127.0.0.1:7447
  formation agent field.toml --robot robot2 -l tcp/0.0.0.0:7460 -e tcp/192.168.1.11:7460
  formation agent field.toml --robot robot2 -c zenoh.json5       certificates, access rules, endpoints
  formation agent field.toml --robot robot2 --state /var/lib/formation     stopped stays stopped
  formation agent field.toml --robot robot2 --law paper --cfg transport/link/tx/lease:2000
"""
NODE = "formation_agent"
"""What ROS 2 calls it."""


def main(argv: Sequence[str] | None = None) -> int:
    """Drive one robot until told to stop; the exit code."""
    flags = parser(
        "agent", "Drive one follower: its own odometry and its neighbours in, commands out.", EXAMPLES
    )
    flags.add_argument(
        "--robot", required=True, metavar="NAME", help="which follower of the mission to drive"
    )
    flags.add_argument("--law", choices=list(LAWS), help="overrule the mission's law")
    flags.add_argument(
        "--readonly", action="store_true", help="do everything but send the robot commands: nothing moves"
    )
    flags.add_argument(
        "--state", metavar="DIR", type=Path,
        help="keep what is to outlive this process in this folder: whether an operator has stopped the robot,"
        " and how it was on its way (default: nothing does)",
    )  # fmt: skip
    add_robot_connect(flags)
    args = flags.parse_args(argv)
    return run_process(args.robot, args, lambda stop: _run(args, stop))


def _run(args: argparse.Namespace, stop: Stop) -> None:
    mission = load(args.mission)
    name = one_of("--robot", args.robot, mission.followers)
    links = wiring.of_agent(mission, name, wiring.endpoints(mission))
    config = bus_config(args, mission, links, f"agent {name}")
    verifier = verifier_of(config, mission)
    carried = {} if verifier is None else {"certificate": verifier.carry}
    agent = Agent(mission, name, args.law, readonly=args.readonly, voice=secrets.token_hex(8), **carried)
    robot = robot_bus(args, mission, name, NODE)
    with Process(f"agent {name}", args, config, stop, robot) as process, _kept(args.state, name) as state:
        drive(agent, process, readonly=args.readonly, state=state, verifier=verifier)


@contextmanager
def _kept(folder: Path | None, robot: str) -> Iterator[Keeping | None]:
    """The files in `folder`. Raises BadInput."""
    if folder is None:
        yield None
        return
    try:
        keeping = Keeping(folder, robot)
    except OSError as error:
        raise BadInput(
            f"--state {folder}: must be a folder that can be written to: {error.strerror}"
        ) from None
    with closing(keeping):
        yield keeping


if __name__ == "__main__":
    sys.exit(main())
