"""`python -m tests.processes.fleet.blind_robots …`: simulated robots whose scanners a signal blinds.

They are those of `python -m formation.agent.simulated`; SIGUSR1 has every scanner fall silent, and SIGUSR2
speak again.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence

from formation.agent.simulated import __main__ as robots
from formation.agent.simulated.simulated import World
from formation.topics import SCAN
from formation.wire import Now, Outgoing, Sample


class Blind(World):
    """Robots whose scans are kept back while `blind`."""

    blind = False

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """What they say, less what they do not see."""
        result = super().step(now, inbox)
        return [out for out in result if not (Blind.blind and out.key.endswith(f"/{SCAN.name}"))]


def _see(number: int, _frame: object) -> None:
    Blind.blind = number == signal.SIGUSR1


if __name__ == "__main__":
    for number in (signal.SIGUSR1, signal.SIGUSR2):
        signal.signal(number, _see)
    vars(robots)["World"] = Blind
    sys.exit(robots.main())
