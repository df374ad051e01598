"""`formation robot`, or `python -m agent.robots`: simulate one robot or several."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from agent.robots.loop import host
from agent.robots.simulated import World
from formation import flags, wiring
from formation.mission_file import load
from formation.process import BadInput, Process, Stop, run_process

EXAMPLES = """\
  formation robot six_robots                              all followers in one process
  formation robot six_robots --robot robot2               one of them
  formation robot six_robots --robot robot2 --robot robot3 --seed 7
  python -m agent.robots six_robots                       the same as the first"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Simulate until told to stop; the exit code."""
    parser = flags.parser("robot", "Simulate one robot or several, in place of hardware.", EXAMPLES)
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
    links = wiring.of_robots(mission, world.robots, wiring.endpoints(mission))
    config = flags.bus_config(args, mission, links, name)
    with Process(name, args, config, stop) as process:
        host(world, process)


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text}: must be at least 0")
    return value


if __name__ == "__main__":
    sys.exit(main())
