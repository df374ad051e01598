"""`python -m agent`: one follower's controller as a process of its own."""

from __future__ import annotations

import secrets
import sys
from collections.abc import Sequence

from agent.core import Agent
from formation import wiring
from formation.flags import bus_config, parser
from formation.law import LAWS
from formation.mission_file import load
from formation.process import Process, Stop, one_of, run_process
from formation.topics import ORDER, STATUS

EXAMPLES = """\
  formation agent six_robots --robot robot2
  formation agent field.toml --robot robot2 -l tcp/0.0.0.0:7460 -e tcp/192.168.1.11:7460 -e tcp/127.0.0.1:7447
  formation agent field.toml --robot robot2 --law paper --cfg transport/link/tx/lease:2000
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Drive one robot until told to stop; the exit code."""
    flags = parser(
        "agent", "Drive one follower: its own odometry and its neighbours in, commands out.", EXAMPLES
    )
    flags.add_argument(
        "--robot", required=True, metavar="NAME", help="which follower of the mission to drive"
    )
    flags.add_argument("--law", choices=list(LAWS), help="overrule the mission's law")
    args = flags.parse_args(argv)

    def drive(stop: Stop) -> None:
        mission = load(args.mission)
        name = one_of("--robot", args.robot, mission.followers)
        links = wiring.of_agent(mission, name, wiring.endpoints(mission))
        agent = Agent(mission, name, args.law, voice=secrets.token_hex(8))
        config = bus_config(args, mission, links, f"agent {name}")
        with Process(f"agent {name}", args, config, stop) as process:
            process.declare(agent)
            process.bus.answer(ORDER.key(name), agent.request)
            process.ready(STATUS.key(name))
            process.run(agent)

    return run_process(args.robot, args, drive)


if __name__ == "__main__":
    sys.exit(main())
