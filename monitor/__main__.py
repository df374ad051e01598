"""`python -m formation.monitor`: watch a fleet, measure the formation, record everything; move nothing."""

from __future__ import annotations

import argparse
import gc
import logging
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from formation.control.laws import LAWS, UNUSABLE
from formation.mission.file import configuration_of, parse, read
from formation.mission.model import Mission
from formation.monitor.core import Monitor
from formation.monitor.exporters import layout
from formation.monitor.metrics.keys import OWN, Watched, given_stage, usual_stage, watched
from formation.monitor.process import MAX_WAITING_MESSAGES, NAME, MonitorLoop, PageUpdater
from formation.monitor.recording.recorder import Recorder
from formation.monitor.recording.rotation import Rotation, add_rotation_flags, new_path
from formation.monitor.web import frames
from formation.monitor.web.address import Bind, add_page_flags, bind_flag
from formation.monitor.web.control import on_the_bus
from formation.monitor.web.server import EXPOSED, PageServer, page_server, words
from formation.monitor.web.source import Source
from formation.ros2.naming import Naming
from formation.ros2.ros_names import Ros
from formation.transport import wiring
from formation.transport.asking import OPERATOR
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError, parse_override
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBus, RobotBuses
from formation.transport.runtime.command_line import make_folder, needs
from formation.transport.runtime.flags import bus_config, parser, ros_domain
from formation.transport.runtime.process import BadInput, Stop, clocks, run_process, say

if TYPE_CHECKING:
    from formation.monitor.exporters.foxglove import Foxglove

EXAMPLES = """\
  formation monitor six_robots
  formation monitor field.toml --record monday.mcap
  formation monitor field.toml --no-record -e tcp/192.168.1.11:7460 -e tcp/192.168.1.12:7460
  formation monitor six_robots --foxglove
  formation monitor field --page 0.0.0.0:8460 --control      with what is in this folder of bundles
  formation monitor field.toml --ros tcp/127.0.0.1:7447 --ros-names rmw_zenoh
"""
READ_ONLY = """\
Open the address in Foxglove. It only shows: it takes no orders. But any program that can
reach the address sees everything, unencrypted; by default that is this machine alone.
"""
FOXGLOVE = Bind("127.0.0.1", 8765)
"""Foxglove's default address of a server."""
NODE = "formation_monitor"
"""The monitor's node name in ROS."""
SWITCH_INTERVAL = 0.0005
"""Python's thread switch interval [s]. Taking a message from the network needs only microseconds, but at the
default of 5 ms each one would wait as long while metrics are made."""
_log = logging.getLogger(__name__)


def main(argv: Sequence[str] | None = None) -> int:
    """Watch until told to stop; return the exit code: 1 if the recording lacks messages."""
    args = _flags().parse_args(argv)
    return run_process(NAME, args, lambda stop: _watch(args, stop))


def _watch(args: argparse.Namespace, stop: Stop) -> bool:
    """Watch until told to stop; return whether the recording, if there is one, has all messages."""
    text, source = read(args.mission)
    mission = parse(text, source)
    if args.foxglove_layout is not None:
        _write_layout(args.foxglove_layout, mission)
        return True
    if args.control:
        args.control_config = args.control_config or configuration_of(args.mission, OPERATOR)
    config = _links(args, mission)
    stage, ros_naming = _stage(args, mission), _ros_naming(args, mission)
    keys = (*watched(mission), *OWN)
    mailbox = Mailbox(MAX_WAITING_MESSAGES)
    with ExitStack() as stack:
        monitor = Monitor(mission, stage)
        page = _page(args, mission, monitor, stack)
        bus = stack.enter_context(Bus(config, mailbox))
        recorder = ros = showing = foxglove = None
        if not args.no_record:
            recorder = stack.enter_context(_recorder(args, mission, text, keys))
        truth = RobotBuses(mission, stage, mailbox, node=NODE, awaited=bool(args.stage))
        stack.callback(truth.close)
        if args.ros:
            ros = stack.enter_context(RobotBus((args.ros,), ros_naming, mailbox, node=NODE))
        if page is not None:
            page.source.tell(recording=str(recorder.path) if recorder else None)
            showing = PageUpdater(mission, monitor, page.source)
        if args.foxglove is not None:
            foxglove = stack.enter_context(_foxglove(args.foxglove, mission, keys))
            _log.info("foxglove: %s", foxglove.address)
        loop = MonitorLoop(
            monitor, bus, recorder, truth, ros, showing, None if foxglove is None else foxglove.forward_sample
        )
        loop.declare()
        if page is not None:
            page.start()
            _log.info("page: %s", words(args.page, page))
            if args.control and args.page and not args.page.is_of_this_machine:
                _log.warning("%s", EXPOSED)
        say(
            "ready",
            process=NAME,
            page=None if page is None else page.invitation,
            foxglove=None if foxglove is None else foxglove.address,
        )
        sys.setswitchinterval(SWITCH_INTERVAL)
        gc.freeze()  # objects made so far are not scanned again
        for pause in loop.run(stop, snapshots=args.snapshots):
            time.sleep(pause)
    return _recorded_all(loop)


def _links(args: argparse.Namespace, mission: Mission) -> BusConfig:
    """Return how it links with the fleet; warn if robots want a certificate and it has none."""
    args.config = args.config or configuration_of(args.mission, NAME)
    links = wiring.of_monitor(wiring.endpoints(mission))
    config = bus_config(args, mission, links, NAME)
    if args.config is None and wiring.under_certificates(config.connect or links.connect):
        _log.warning("%s", wiring.certificate_remedy(NAME))
    return config


def _recorded_all(ended: MonitorLoop) -> bool:
    say("summary", **ended.summary())
    if ended.unrecorded:
        _log.error("the recording lacks messages: %s", ended.unrecorded)
    return not ended.unrecorded


def _recorder(args: argparse.Namespace, mission: Mission, text: str, keys: Sequence[Watched]) -> Recorder:
    rotation = Rotation(args.rotate_size, args.rotate_time)
    law = args.law or mission.law.kind
    return Recorder(args.record or new_path(mission.name), mission.name, text, law, keys, rotation)


def _write_layout(path: Path, mission: Mission) -> None:
    if path.exists():
        raise BadInput(f"--foxglove-layout {path}: exists already; name a new file")
    try:
        make_folder(path.parent)
        with path.open("x", encoding="utf-8") as file:
            file.write(layout.text(mission))
    except OSError as error:
        raise BadInput(f"--foxglove-layout {path}: cannot be written: {error.strerror}") from None


def _foxglove(bind: Bind, mission: Mission, keys: Sequence[Watched]) -> Foxglove:
    """Return a server that sends `keys`. Raises BadInput."""
    try:
        from formation.monitor.exporters.foxglove import Foxglove  # noqa: PLC0415 - an optional extra
    except ModuleNotFoundError:
        text = f"--foxglove {needs('foxglove')}"
        raise BadInput(text) from None
    try:
        return Foxglove(bind.host, bind.port, f"formation: {mission.name}", keys)
    except OSError as error:
        raise BadInput(f"--foxglove {bind}: {error}") from None


def _page(
    args: argparse.Namespace, mission: Mission, monitor: Monitor, stack: ExitStack
) -> PageServer | None:
    """Return the page, not yet served, with its operator. Raises BadInput and BusError."""
    if args.control and args.no_page:
        raise BadInput("--control: needs the page; leave out --no-page")
    if args.control_config is not None and not args.control:
        raise BadInput("--control-config FILE: needs --control")
    if args.no_page:
        return None
    control = None
    if args.control:
        control = on_the_bus(
            mission, monitor.note, connect=args.connect, mode=args.mode, file=args.config,
            own_file=args.control_config, overrides=[parse_override(text) for text in args.cfg],
        )  # fmt: skip
        stack.callback(control.close)
    driven = mission.under(args.law) if args.law else mission
    about = frames.hello(driven, live=True, control=args.control, version=version("zenoh-formation"))
    try:
        server = page_server(args.page, Source(about, lambda: clocks().wall), control)
    except OSError as error:
        raise BadInput(f"--page {args.page or Bind()}: {error.strerror}") from None
    stack.callback(server.stop)
    return server


def _stage(args: argparse.Namespace, mission: Mission) -> dict[str, str]:
    """Return the endpoints of simulated robots, by robot. Raises BadInput."""
    if args.no_stage:
        return {}
    try:
        where = given_stage(mission, args.stage) if args.stage else usual_stage(mission)
    except ValueError as error:
        raise BadInput(str(error)) from None
    for endpoint in where.values():
        _check("--stage", endpoint)
    return where


def _ros_naming(args: argparse.Namespace, mission: Mission) -> Naming:
    """Return the naming of the monitor's own topics: from flags, else the first follower's."""
    if not args.ros and (args.ros_names is not None or args.ros_domain is not None):
        raise BadInput("--ros-names and --ros-domain: need --ros ENDPOINT")
    if args.ros:
        _check("--ros", args.ros)
    first = mission.robots[mission.followers[0]]
    domain = first.domain if args.ros_domain is None else args.ros_domain
    return Naming.of_formation(args.ros_names or first.ros, domain)


def _check(flag: str, endpoint: str) -> None:
    try:
        BusConfig(connect=(endpoint,), connect_flag=flag)
    except BusError as error:
        raise BadInput(str(error)) from None


def _flags() -> argparse.ArgumentParser:
    flags = parser(
        "monitor",
        "Measure a fleet, record it and show it on a page. It moves no robot, but for orders with --control.",
        EXAMPLES,
    )
    file = flags.add_mutually_exclusive_group()
    file.add_argument(
        "--record", metavar="FILE", type=Path, help="MCAP file (default: recordings/MISSION-DATE-TIME.mcap)"
    )
    file.add_argument("--no-record", action="store_true", help="only measure")
    flags.add_argument(
        "--law",
        choices=[*LAWS, *UNUSABLE],
        help="the law that agents use, if it is not the mission's; it is recorded",
    )
    flags.add_argument(
        "--snapshots", action="store_true", help="write JSON lines to stdout instead of lines for people"
    )
    add_rotation_flags(flags)
    add_page_flags(flags).add_argument(
        "--control-config", metavar="FILE", type=Path,
        help="Zenoh configuration with the operator's certificate (default: the monitor's own)",
    )  # fmt: skip
    group = flags.add_argument_group("Foxglove, live (extra: foxglove)", READ_ONLY)
    group.add_argument(
        "--foxglove", metavar="HOST:PORT", nargs="?", type=partial(bind_flag, port=FOXGLOVE.port),
        const=FOXGLOVE, help=f"serve every topic to it (default: {FOXGLOVE})",
    )  # fmt: skip
    group.add_argument(
        "--foxglove-layout", metavar="FILE", type=Path, help="write a layout for the mission, and end"
    )
    truth = flags.add_argument_group(
        "simulated robots (for ground truth; where there are none, none is known)"
    )
    where = truth.add_mutually_exclusive_group()
    where.add_argument(
        "--stage", metavar="[ROBOT,...=]ENDPOINT", action="append", default=[],
        help="where they listen; repeatable (default: this machine's ports for robots that the mission gives"
        " no endpoint)",
    )  # fmt: skip
    where.add_argument("--no-stage", action="store_true", help="do not look for any")
    ros = flags.add_argument_group("metrics as ROS 2 topics (formation/error, formation/diagnostics)")
    ros.add_argument(
        "--ros", metavar="ENDPOINT", help="ROS 2 bridge or router to publish them to, as a client"
    )
    ros.add_argument(
        "--ros-names",
        choices=get_args(Ros),
        help="how topics are spelled there (default: as the mission's robots)",
    )
    ros.add_argument(
        "--ros-domain", metavar="N", type=ros_domain, help="ROS domain (default: as the mission's robots)"
    )
    return flags


if __name__ == "__main__":
    sys.exit(main())
