"""`python -m formation.agent`: run one follower's controller as a process."""

from __future__ import annotations

import argparse
import secrets
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from pathlib import Path

from formation.agent.core import Agent
from formation.agent.persistence.persistence import Persistence
from formation.agent.persistence.store import Store, boot_id
from formation.agent.process import drive
from formation.control.laws import LAWS, UNUSABLE, why_unusable
from formation.mission.file import load
from formation.transport import wiring
from formation.transport.runtime.flags import add_robot_connect, bus_config, parser, robot_bus
from formation.transport.runtime.process import BadInput, Process, Stop, follower_of, run_process
from formation.transport.security.verifying import verifier_of

EXAMPLES = """\
  formation agent six_robots --robot robot2
  formation agent field.toml --robot robot2 --readonly           everything but moving
  formation agent field.toml --robot robot2 --robot-connect tcp/127.0.0.1:7447
  formation agent field.toml --robot robot2 -l tcp/0.0.0.0:7460 -e tcp/192.168.1.11:7460
  formation agent field.toml --robot robot2 -c zenoh.json5       certificates, access rules, endpoints
  formation agent field.toml --robot robot2 --state /var/lib/formation     keeps a stop over a restart
  formation agent field.toml --robot robot2 --law paper --cfg transport/link/tx/lease:2000
"""
NODE = "formation_agent"
"""Name of its ROS 2 node."""


def main(argv: Sequence[str] | None = None) -> int:
    """Drive one robot until told to stop; return the exit code."""
    flags = parser("agent", "Control one follower by its odometry and its neighbours' positions.", EXAMPLES)
    flags.add_argument(
        "--robot", required=True, metavar="NAME", help="which follower of the mission to drive"
    )
    flags.add_argument("--law", choices=[*LAWS, *UNUSABLE], help="the control law, instead of the mission's")
    flags.add_argument(
        "--readonly", action="store_true", help="do everything but send the robot commands: nothing moves"
    )
    flags.add_argument(
        "--state", metavar="DIR", type=Path,
        help="folder that keeps an operator's stop or hold, and the robot's heading and odometry frame, over"
        " a restart (default: nothing is kept)",
    )  # fmt: skip
    add_robot_connect(flags)
    args = flags.parse_args(argv)
    return run_process(args.robot, args, lambda stop: _run(args, stop))


def _run(args: argparse.Namespace, stop: Stop) -> None:
    mission = load(args.mission)
    if (why := why_unusable(args.law or mission.law.kind)) is not None:
        raise BadInput(f"{args.mission}: {why}")
    name = follower_of(mission, args.robot, args.mission)
    links = wiring.of_member(mission, name, wiring.endpoints(mission))
    config = bus_config(args, mission, links, f"agent {name}")
    verifier = verifier_of(config, mission)
    carried = {} if verifier is None else {"certificate": verifier.carry}
    agent = Agent(
        mission, name, args.law, readonly=args.readonly, publisher_id=secrets.token_hex(8), **carried
    )
    robot = robot_bus(args, mission, name, NODE)
    with _store(args.state, name) as state, Process(f"agent {name}", args, config, stop, robot) as process:
        persistence = None if state is None else Persistence(agent, state, boot_id())
        process.play(drive(agent, process, persistence=persistence, verifier=verifier))


def _store(folder: Path | None, robot: str) -> AbstractContextManager[Store | None]:
    """Open the state files in `folder`. Raises BadInput."""
    try:
        return nullcontext() if folder is None else closing(Store(folder, robot))
    except OSError as error:
        raise BadInput(
            f"--state {folder}: must be a folder that can be written to: {error.strerror}"
        ) from None


if __name__ == "__main__":
    sys.exit(main())
