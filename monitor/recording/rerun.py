"""Feed a recording to the monitor's own metrics, as they were fed live.

The live monitor judged the formation error at the moments of its publication, which are recorded, so settling
and the final error come out the same. While an edge is unknown nothing is published; the known edges are then
judged every `LOOK_PERIOD`. There is one clock: the recorder's system clock.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from formation.mission.model import Mission
from formation.monitor.metrics.keys import OWN
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.recording.reader import Recorded
from formation.topics import ERROR
from formation.wire import Now

LOOK_PERIOD = 0.1
"""Time between two looks of a live monitor [s]."""
_OWN = frozenset(one.key for one in OWN)


class Rerun:
    """Metrics of a recording up to the newest message taken."""

    def __init__(self, mission: Mission) -> None:
        self.metrics = Metrics(mission)
        self._looked = float("-inf")  # [s, the recorder's system clock]

    def process_message(self, message: Recorded) -> None:
        """Take the next message of the file."""
        now = Now(message.wall, message.wall)
        if message.sample.key not in _OWN:
            self.metrics.process_sample(message.sample, message.wall)
        elif message.sample.key == ERROR.key():
            self.metrics.observe(now)
            self._looked = message.wall
        if message.wall - self._looked > 1.5 * LOOK_PERIOD:
            self.metrics.observe_known(now)
            self._looked = message.wall


def run(mission: Mission, messages: Iterable[Recorded]) -> Iterator[tuple[Recorded, Metrics]]:
    """Yield each message with the metrics that include it."""
    one = Rerun(mission)
    for message in messages:
        one.process_message(message)
        yield message, one.metrics
