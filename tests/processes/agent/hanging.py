"""A process that hangs at its first sample: ``python -m tests.processes.agent.hanging ENDPOINT``."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Sequence

from formation.topics import ODOM
from formation.transport.bus_config import BusConfig
from formation.transport.runtime.flags import parser
from formation.transport.runtime.process import Process, Stop, say
from formation.wire import Now, Outgoing, Sample

ODOM_KEY = ODOM.key("robot2")


class Hanging:
    """Core that hangs in the step with its first sample."""

    publications = ()
    subscriptions = (ODOM_KEY,)
    dropped: dict[str, int] = {}  # noqa: RUF012 - it drops nothing
    due = math.inf

    def step(self, _now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        if inbox:
            say("hanging")
            time.sleep(600.0)
        return []

    def halt(self, _now: Now, _reason: str) -> list[Outgoing]:
        return []


def main(endpoint: str) -> None:
    args = parser("hanging", "Hang.", "").parse_args(["six_robots"])
    with Stop() as stop, Process("hanging", args, BusConfig(listen=(endpoint,)), stop) as process:
        process.declare(Hanging())
        process.ready()

        def count() -> None:
            while process.bus.received[ODOM_KEY] < 4:
                time.sleep(0.01)
            say("received", number=process.bus.received[ODOM_KEY])

        threading.Thread(target=count, daemon=True).start()
        process.play(process.loop(Hanging()))


if __name__ == "__main__":
    main(sys.argv[1])
