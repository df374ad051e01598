"""`formation robot`, or `python -m formation.agent.simulated`: simulate one robot or several."""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Callable, Sequence
from importlib.util import find_spec

from formation.agent.simulated import faults
from formation.agent.simulated.flags import NEEDED, add_world_flags, unfit
from formation.agent.simulated.simulated import World, host, kinematic
from formation.mission.file import load
from formation.mission.model import Mission
from formation.transport import wiring
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBuses
from formation.transport.runtime import flags
from formation.transport.runtime.command_line import needs
from formation.transport.runtime.process import BadInput, Process, Stop, run_process
from formation.transport.wiring import Endpoints

EXAMPLES = """\
  formation robot six_robots                              all followers in one process
  formation robot six_robots --robot robot2               one of them
  formation robot six_robots --robot robot2 --robot robot3 --seed 7
  formation robot six_robots --robot robot2 -l tcp/0.0.0.0:7662      its agent says --robot-connect
  formation robot six_robots --world mujoco               all of them with mass, and wheels that slip
  formation robot six_robots --world mujoco --picture end.png
  formation robot six_robots --fault robot2:frozen@20+10  odometry frozen for 10 s, 20 s after the start
  python -m formation.agent.simulated six_robots                       the same as the first"""

NODE = "simulated_robot"
"""Name of its ROS 2 node."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Simulate until told to stop; return the exit code."""
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
    parser.add_argument("--seed", type=_seed, default=0, help="seed of all noise (default: 0)")
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
    args.listen = []  # these are the robots' own endpoints; the links with the fleet, if any, are dialled
    config = flags.bus_config(args, mission, fleet, name)

    def robots(mailbox: Mailbox) -> RobotBuses:
        return RobotBuses(mission, where, mailbox, mode="router", node=NODE)

    on_fleet = any(fleet) or bool(args.connect)
    with Process(name, args, config if on_fleet else None, stop, robots) as process:
        process.play(host(world, process))
        at_the_end()


def _world(args: argparse.Namespace, mission: Mission) -> tuple[World, Callable[[], None]]:
    """Return the robots, and a function to call when they have ended. Raises ValueError."""
    reason = unfit(args, mission)
    if reason is not None:
        raise ValueError(reason)
    if args.world == "kinematic":
        plants = faults.with_faults(kinematic, [faults.parse(text, mission) for text in args.fault])
        return World(mission, args.robot, args.seed, plants), lambda: None
    if args.robot:
        raise ValueError("--robot: a physics world has all robots of its mission; leave out --robot")
    for package in NEEDED:
        if find_spec(package) is None:
            raise ValueError(f"--world mujoco: {needs(package)}")
    # MuJoCo reads this when it is loaded; without a picture it need not load the renderer
    os.environ.setdefault("MUJOCO_GL", "egl" if args.picture else "disable")
    logging.getLogger("OpenGL").setLevel(logging.WARNING)  # it reports accelerators that do not matter here
    # loaded only for the physics world
    from formation.agent.simulated.physics.picture import in_physics  # noqa: PLC0415

    return in_physics(mission, args.seed, args.picture)


def _listened(given: Sequence[str], robots: Sequence[str], default: Endpoints) -> dict[str, str]:
    """Return where each robot listens. Raises BadInput."""
    if len(given) not in {0, 1, len(robots)}:
        each = ", ".join(robots)
        raise BadInput(
            f"-l is given {len(given)} times: must be once for all robots or once for each of {each}"
        )
    if not given:
        return {robot: default.robots[robot] for robot in robots}
    return dict(zip(robots, given if len(given) > 1 else [*given] * len(robots), strict=True))


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r}: must be a whole number of at least 0")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
