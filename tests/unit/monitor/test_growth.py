from __future__ import annotations

import gc
import random
import tracemalloc
from collections.abc import Iterator

import pytest

from formation.monitor.core import MAX_EVENTS, Monitor
from formation.monitor.metrics.events import Event
from formation.wire import Sample
from tests.support.monitored import Fleet, command, now, odometry, status
from tests.support.mutations import mutated


def traffic(fleet: Fleet, rng: random.Random, start: float, end: float) -> Iterator[Sample]:
    """Six robots on a bad radio, and somebody who sends rubbish."""
    gone = {name for name in fleet.mission.names if rng.random() < 0.2}
    for sample in fleet.positions(start, end):
        if sample.key.partition("/")[0] not in gone:
            yield sample
            yield command("robot2", sample.arrived, rng.random(), 0.1)
            yield odometry("robot3", sample.arrived)
        yield status("robot4", sample.arrived, rng.choice(("run", "hold", "stop")), f"at {sample.arrived}")
        if rng.random() < 0.3:
            yield sample._replace(payload=mutated(rng, [sample.payload]))
            yield sample._replace(attachment=rng.randbytes(20), key=f"robot{rng.randrange(12)}/position")


@pytest.mark.slow
def test_monitor_memory_does_not_grow_over_time() -> None:
    fleet, rng = Fleet(), random.Random(3)
    monitor = Monitor(fleet.mission)
    for number in range(MAX_EVENTS):
        monitor.note(Event(1000.0, 20, "", "operator", f"number {number} of those that are kept {'.' * 60}"))

    def watch(start: int, seconds: int) -> int:
        """So many seconds of it; the bytes that are held afterwards."""
        for second in range(start, start + seconds):
            samples = sorted(traffic(fleet, rng, second, second + 1.0), key=lambda sample: sample.arrived)
            for part in range(10):
                monitor.step(now(second + part / 10), samples[part::10])
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = watch(10, 10)
        after = watch(20, 30)
    finally:
        tracemalloc.stop()
    assert monitor.metrics.rejections.by_key
    assert len(monitor.events) == MAX_EVENTS
    assert after - before < 100_000  # of 8000 messages, each of which takes more than 100 bytes
