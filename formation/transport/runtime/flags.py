"""The common flags of all processes: the mission, the links as known from Zenoh, and the monitor."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from formation.mission.file import MISSION_HELP
from formation.mission.model import Mission
from formation.transport.bus_config import MODES, BusConfig, parse_override
from formation.transport.mailbox import Mailbox
from formation.transport.runtime.command_line import Parser
from formation.transport.wiring import Links, endpoints

if TYPE_CHECKING:
    from formation.transport.robot_bus import RobotBus

LEVELS = ("debug", "info", "warning", "error")
MAX_ROS_DOMAIN = 232


def parser(command: str, what: str, examples: str, *, fleet: bool = True) -> argparse.ArgumentParser:
    """A parser for `formation COMMAND` with the common flags; `examples` are printed unchanged at its end.

    Without `fleet` it is for a process that has no links with the fleet, and so none with a monitor.
    """
    flags = Parser(f"formation {command}", what, examples)
    flags.add_argument("mission", metavar="MISSION", help=MISSION_HELP)
    if fleet:
        links = flags.add_argument_group(
            "links with the fleet (without -l, -e and endpoints in FILE those that the mission implies)"
        )
        add_zenoh(
            links,
            connect="endpoint to dial, such as tcp/192.168.1.12:7447; repeatable",
            listen="endpoint to accept links on; repeatable",
        )
        links.add_argument(
            "--no-multicast-scouting", action="store_true", help="accepted; multicast is always off"
        )
    under = flags.add_argument_group("under a supervisor")
    if fleet:
        under.add_argument(
            "--await-monitor", metavar="SECONDS", type=_seconds, default=0.0,
            help="publish nothing until a monitor records this process, at most so long (default: 0)",
        )  # fmt: skip
    else:
        flags.set_defaults(await_monitor=0.0)
    under.add_argument(
        "--parent", metavar="PID", type=int, help="stop cleanly once this is no longer the parent process"
    )
    under.add_argument("--log-level", choices=LEVELS, default="info", help="(default: info)")
    return flags


def bus_config(args: argparse.Namespace, mission: Mission, default: Links, name: str) -> BusConfig:
    """The bus configuration of a process called `name`. Raises BusError for flags that cannot work.

    `default` are the mission's links; one -l or -e replaces them all, and so does a FILE that names
    endpoints.
    """
    given = Links(tuple(args.listen), tuple(args.connect))
    return BusConfig(
        listen=given.listen,
        connect=given.connect,
        implied=None if any(given) else default,
        mode=args.mode,
        namespace=mission.team or "",
        config_file=args.config,
        overrides=tuple(parse_override(text) for text in args.cfg),
        name=name,
    )


def add_zenoh(links: argparse._ArgumentGroup, *, connect: str, listen: str = "") -> None:
    """Add the flags known from Zenoh; `connect` and `listen` describe -e, and -l if it has one."""
    links.add_argument("-m", "--mode", choices=MODES, help="Zenoh session mode (default: peer)")
    links.add_argument("-e", "--connect", metavar="ENDPOINT", action="append", default=[], help=connect)
    if listen:
        links.add_argument("-l", "--listen", metavar="ENDPOINT", action="append", default=[], help=listen)
    else:
        links.set_defaults(listen=[])
    links.add_argument("-c", "--config", metavar="FILE", type=Path, help="Zenoh configuration file (JSON5)")
    links.add_argument(
        "--cfg", metavar="KEY:VALUE", action="append", default=[],
        help="one Zenoh setting, which outranks all others, such as transport/link/tx/lease:2000; repeatable",
    )  # fmt: skip


def add_robot_connect(flags: argparse.ArgumentParser) -> None:
    """Add ``--robot-connect``, for a process that is a client of one robot's router."""
    flags.add_argument(
        "--robot-connect", metavar="ENDPOINT",
        help="the robot's own ROS 2 bridge or router, such as tcp/127.0.0.1:7447 (default: the mission's"
        " robot_endpoint, or the place of the simulated robot)",
    )  # fmt: skip


def robot_bus(
    args: argparse.Namespace, mission: Mission, robot: str, node: str
) -> Callable[[Mailbox], RobotBus]:
    """Return a function that opens the bus of `robot`, as a client with the node name `node`."""
    # the modules for ROS 2's messages take long to load, and an operator's stop does not need them
    from formation.ros2.naming import Naming  # noqa: PLC0415
    from formation.transport.robot_bus import RobotBus  # noqa: PLC0415

    endpoint = args.robot_connect or endpoints(mission).robots[robot]

    def opened(mailbox: Mailbox) -> RobotBus:
        return RobotBus((endpoint,), Naming.of(mission.robots, [robot]), mailbox, node=node)

    return opened


def ros_domain(text: str) -> int:
    """Parse a ROS domain id on the command line. Raises ArgumentTypeError."""
    if not text.isdecimal() or int(text) > MAX_ROS_DOMAIN:
        raise argparse.ArgumentTypeError(f"{text!r}: must be a ROS domain from 0 to {MAX_ROS_DOMAIN}")
    return int(text)


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0.0 <= seconds <= 3600.0:
        raise argparse.ArgumentTypeError(f"{text!r}: must be seconds from 0 to 3600")
    return seconds
