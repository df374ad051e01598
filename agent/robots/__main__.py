"""`formation robot`, or `python -m agent.robots`: simulate one robot or several."""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Callable, Sequence
from importlib.util import find_spec

from agent.robots import faults
from agent.robots.flags import NEEDED, add_world_flags, unfit
from agent.robots.loop import host
from agent.robots.simulated import World, kinematic
from formation.mission import Mission
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
  formation robot six_robots --world mujoco               all of them with mass, and wheels that slip
  formation robot six_robots --world mujoco --picture end.png
  formation robot six_robots --fault robot2:frozen@20+10  odometry frozen for 10 s, 20 s after the start
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
    add_world_flags(parser)
    args = parser.parse_args(arguments)
    return run_process(" ".join(args.robot or ["robots"]), args, lambda stop: _run(args, stop))


def _run(args: argparse.Namespace, stop: Stop) -> None:
    mission = load(args.mission)
    try:
        world, at_the_end = _world(args, mission)
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
        at_the_end()


def _world(args: argparse.Namespace, mission: Mission) -> tuple[World, Callable[[], None]]:
    """The robots, and what is left to be done when they have ended. Raises ValueError for what cannot be."""
    reason = unfit(args)
    if reason is not None:
        raise ValueError(reason)
    if args.world == "kinematic":
        plants = faults.with_faults(kinematic, [faults.read(text) for text in args.fault])
        return World(mission, args.robot, args.seed, plants), lambda: None
    if args.robot:
        raise ValueError("--robot: a physics world has all robots of its mission; leave out --robot")
    for package in NEEDED:
        if find_spec(package) is None:
            raise ValueError(f"--world mujoco: this needs {package}: pip install 'formation[physics]'")
    # MuJoCo reads this when it is loaded; without a picture it need not load what renders
    os.environ.setdefault("MUJOCO_GL", "egl" if args.picture else "disable")
    logging.getLogger("OpenGL").setLevel(logging.WARNING)  # it would say what makes it no faster
    # what only the physics world needs is loaded for nobody else
    from agent.robots.physics.hosting import in_physics  # noqa: PLC0415

    return in_physics(mission, args.seed, args.picture)


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
