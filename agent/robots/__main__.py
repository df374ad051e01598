"""`formation robot`, or `python -m agent.robots`: simulate one robot or several."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from agent.robots.loop import host
from agent.robots.simulated import World
from formation.mission_file import load
from formation.transport import flags, wiring
from formation.transport.mailbox import Mailbox
from formation.transport.process import BadInput, Process, Stop, run_process
from formation.transport.robot_buses import RobotBuses
from formation.transport.wiring import Endpoints

EXAMPLES = """\
  formation robot six_robots                              all followers in one process
  formation robot six_robots --robot robot2               one of them
  formation robot six_robots --robot robot2 --robot robot3 --seed 7
  formation robot six_robots --robot robot2 -l tcp/0.0.0.0:7662      its agent says --robot-connect
  python -m agent.robots six_robots                       the same as the first"""

NODE = "simulated_robot"
"""What ROS 2 calls it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Simulate until told to stop; the exit code."""
    what = (
        "Simulate one robot or several, in place of hardware. Each is a ROS 2 router as well, at the"
        " mission's robot_endpoint or at -l, which is given once for all of them or once for each."
    )
    parser = flags.parser("robot", what, EXAMPLES)
    parser.add_argument(
        "--robot",
        metavar="NAME",
        action="append",
        help="a robot to simulate; repeatable (default: all followers)",
    )
    parser.add_argument("--seed", type=_seed, default=0, help="of all noise (default: 0)")
    args = parser.parse_args(arguments)
    return run_process(" ".join(args.robot or ["robots"]), args, lambda stop: _run(args, stop))


def _run(args: argparse.Namespace, stop: Stop) -> None:
    mission = load(args.mission)
    try:
        world = World(mission, args.robot, args.seed)
    except ValueError as error:
        raise BadInput(str(error)) from None
    name = " ".join(["robot", *args.robot]) if args.robot else "robots"
    default = wiring.endpoints(mission)
    where = _listened(args.listen, world.robots, default)
    fleet = wiring.of_robots(mission, world.robots, default)
    args.listen = []  # these are the robots' own; with the fleet they are linked by dialling, if at all
    config = flags.bus_config(args, mission, fleet, name)

    def robots(mailbox: Mailbox) -> RobotBuses:
        return RobotBuses(mission, where, mailbox, mode="router", node=NODE)

    on_fleet = any(fleet) or bool(args.connect)
    with Process(name, args, config if on_fleet else None, stop, robots) as process:
        host(world, process)


def _listened(given: Sequence[str], robots: Sequence[str], default: Endpoints) -> dict[str, str]:
    """Where each robot listens. Raises BadInput."""
    if len(given) not in {0, 1, len(robots)}:
        each = ", ".join(robots)
        raise BadInput(
            f"-l is given {len(given)} times: must be once for all robots or once for each of {each}"
        )
    if not given:
        return {robot: default.robots[robot] for robot in robots}
    return dict(zip(robots, given if len(given) > 1 else [*given] * len(robots), strict=True))


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text}: must be at least 0")
    return value


if __name__ == "__main__":
    sys.exit(main())
