"""`formation guard`, or `python -m agent.robots.guard`: stop a robot whose agent has fallen silent."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from agent.robots.guard.core import Guard
from agent.robots.guard.loop import park, watch
from formation.mission_file import load
from formation.transport import flags
from formation.transport.process import FAILED, Process, Stop, one_of, run_process

EXAMPLES = """\
  formation guard pair.toml --robot robot2                on the robot, beside its agent, all the time
  formation guard pair.toml --robot robot2 --once         the robot stands, and may be driven by hand
  formation guard pair.toml --robot robot2 --robot-connect tcp/127.0.0.1:7447
  python -m agent.robots.guard pair.toml --robot robot2   the same as the first"""

NODE = "formation_guard"
"""What ROS 2 calls it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Guard until told to stop; the exit code."""
    parser = flags.parser(
        "guard",
        "Stop a robot whose agent dies, hangs or is cut off: zero velocity after 3 periods of silence.",
        EXAMPLES,
        fleet=False,
    )
    parser.add_argument("--robot", required=True, metavar="NAME", help="whose agent to watch")
    parser.add_argument(
        "--once",
        action="store_true",
        help="say zero velocity for half a second on behalf of an agent that is gone, then end:"
        " 0 if the robot listened, 1 if not",
    )
    flags.add_robot_connect(parser)
    args = parser.parse_args(arguments)
    heard = []
    code = run_process(f"guard {args.robot}", args, lambda stop: heard.append(_run(args, stop)))
    return code if code or all(heard) else FAILED


def _run(args: argparse.Namespace, stop: Stop) -> bool:
    """Whether all went well."""
    mission = load(args.mission)
    name = one_of("--robot", args.robot, mission.followers)
    guard = Guard(mission, name)
    robot = flags.robot_bus(args, mission, name, NODE)
    with Process(f"guard {name}", args, None, stop, robot) as process:
        if args.once:
            return park(guard, process)
        watch(guard, process)
    return True


if __name__ == "__main__":
    sys.exit(main())
