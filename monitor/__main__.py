"""`python -m monitor`: watch a fleet, measure the formation, record everything. It moves nothing."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path

from formation import wiring
from formation.bus import Bus
from formation.flags import bus_config, parser
from formation.law import LAWS
from formation.mission_file import parse, read
from formation.process import Stop, run_process, say
from monitor.core import Monitor
from monitor.keys import OWN, watched
from monitor.loop import CAPACITY, NAME, Watch
from monitor.recorder import Recorder

EXAMPLES = """\
  formation monitor six_robots
  formation monitor field.toml --record monday.mcap
  formation monitor field.toml --no-record -e tcp/192.168.1.11:7460 -e tcp/192.168.1.12:7460
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Watch until told to stop; the exit code."""
    flags = parser(
        "monitor", "Measure and record a fleet. It publishes nothing that a robot listens to.", EXAMPLES
    )
    file = flags.add_mutually_exclusive_group()
    file.add_argument(
        "--record", metavar="FILE", type=Path, help="MCAP file (default: recordings/MISSION-DATE-TIME.mcap)"
    )
    file.add_argument("--no-record", action="store_true", help="only measure")
    flags.add_argument(
        "--law",
        choices=list(LAWS),
        help="the law agents were told to use, if not the mission's: it is recorded",
    )
    flags.add_argument(
        "--snapshots", action="store_true", help="write JSON lines to stdout instead of lines for people"
    )
    args = flags.parse_args(argv)

    def watch(stop: Stop) -> None:
        text, source = read(args.mission)
        mission = parse(text, source)
        links = wiring.of_monitor(wiring.endpoints(mission))
        config = bus_config(args, mission, links, NAME)
        when = datetime.now().astimezone()
        path = args.record or Path("recordings") / f"{mission.name}-{when:%Y%m%d-%H%M%S}.mcap"
        with ExitStack() as stack:
            bus = stack.enter_context(Bus(config, capacity=CAPACITY))
            recorder = None
            if not args.no_record:
                keys = (*watched(mission), *OWN)
                recorder = stack.enter_context(
                    Recorder(path, mission.name, text, args.law or mission.law.kind, keys)
                )
            one = Watch(Monitor(mission), bus, recorder)
            one.declare()
            say("ready", process=NAME)
            one.run(stop, snapshots=args.snapshots)
        say("summary", **one.summary())

    return run_process(NAME, args, watch)


if __name__ == "__main__":
    sys.exit(main())
