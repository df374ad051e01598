"""A recording fed to the monitor's own figures, as they were fed when it was made.

The formation error was looked at whenever it was published, and that is recorded, so what is judged by it
(settling, the final error) comes out the same. While an edge is unknown nothing is published; the known edges
are then judged every `LOOK`. There is one clock: the recorder's system clock.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from formation.mission import Mission
from formation.topics import ERROR
from formation.wire import Now
from monitor.figures.keys import OWN
from monitor.figures.metrics import Metrics
from monitor.recording.reader import Recorded

LOOK = 0.1
"""As often as a live monitor looks [s]."""
_OWN = frozenset(one.key for one in OWN)


class Rerun:
    """Figures of a recording, as far as it has been taken in."""

    def __init__(self, mission: Mission) -> None:
        self.metrics = Metrics(mission)
        self._looked = float("-inf")  # [s, the recorder's system clock]

    def take(self, message: Recorded) -> None:
        """Take the next message of the file."""
        now = Now(message.wall, message.wall)
        if message.sample.key not in _OWN:
            self.metrics.take(message.sample, message.wall)
        elif message.sample.key == ERROR.key():
            self.metrics.observe(now)
            self._looked = message.wall
        if message.wall - self._looked > 1.5 * LOOK:
            self.metrics.observe_known(now)
            self._looked = message.wall


def run(mission: Mission, messages: Iterable[Recorded]) -> Iterator[tuple[Recorded, Metrics]]:
    """Each message, with the figures that include it."""
    one = Rerun(mission)
    for message in messages:
        one.take(message)
        yield message, one.metrics
