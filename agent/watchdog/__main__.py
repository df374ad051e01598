"""`formation watchdog`, or `python -m formation.agent.watchdog`: stop a robot if its agent falls silent."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence

from formation.agent.watchdog.core import Watchdog
from formation.agent.watchdog.process import park, watch
from formation.mission.file import load
from formation.transport.runtime import flags
from formation.transport.runtime.process import Process, Stop, follower_of, run_process

EXAMPLES = """\
  formation watchdog pair.toml --robot robot2                on the robot, beside its agent, all the time
  formation watchdog pair.toml --robot robot2 --once         the robot stands, and may be driven by hand
  formation watchdog pair.toml --robot robot2 --robot-connect tcp/127.0.0.1:7447
  python -m formation.agent.watchdog pair.toml --robot robot2   the same as the first"""

NODE = "formation_watchdog"
"""Name of its ROS 2 node."""
_log = logging.getLogger(__name__)


def main(arguments: Sequence[str] | None = None) -> int:
    """Watch until told to stop; return the exit code."""
    parser = flags.parser(
        "watchdog",
        "Stop the robot if its agent dies, hangs or is cut off: zero velocity after 3 periods of silence.",
        EXAMPLES,
        fleet=False,
    )
    parser.add_argument("--robot", required=True, metavar="NAME", help="the robot to watch")
    parser.add_argument(
        "--once",
        action="store_true",
        help="send zero velocity for half a second on behalf of an agent that is gone, then end:"
        " 0 if the robot listened, 1 if not",
    )
    flags.add_robot_connect(parser)
    args = parser.parse_args(arguments)
    return run_process(f"watchdog {args.robot}", args, lambda stop: _run(args, stop))


def _run(args: argparse.Namespace, stop: Stop) -> bool:
    """Whether all went well."""
    mission = load(args.mission)
    name = follower_of(mission, args.robot, args.mission)
    watchdog = Watchdog(mission, name)
    robot = flags.robot_bus(args, mission, name, NODE)
    with Process(f"watchdog {name}", args, None, stop, robot) as process:
        if args.once:
            listened = park(watchdog, process)
            if not listened:
                _log.error("NOT STOPPED: %s did not listen to zero velocity; use its own switch", name)
            return listened
        process.play(watch(watchdog, process))
    return True


if __name__ == "__main__":
    sys.exit(main())
