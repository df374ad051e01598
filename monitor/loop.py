"""The monitor on its buses: record first, understand later.

Everything that has arrived is taken in one go, fifty times a second. That is often enough for people and
for 10 Hz figures, and at thousands of messages a second far cheaper than waking for each.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from typing import Any, Protocol

from formation.rate import Rate
from formation.transport.bus import Bus
from formation.transport.linger import Linger
from formation.transport.process import Stop, clocks, say
from formation.transport.robot_bus import RobotBus
from formation.transport.robot_buses import RobotBuses
from formation.wire import Now, Sample
from monitor.core import Monitor
from monitor.figures.events import Event
from monitor.figures.words import as_json, line
from monitor.page.showing import Showing
from monitor.recording.recorder import Recorder

NAME = "monitor"
CAPACITY = 65_536
"""Messages that may wait: ten seconds of 6000 a second, while the disk is busy."""
PERIOD = 0.02
"""[s]"""
QUIET = 0.2
"""At the end: nothing for so long means that nothing more is coming [s] …"""
LAST_CALL = 1.0
"""… and so long after the wish to stop it ends even if a fleet goes on talking [s]."""
_log = logging.getLogger(__name__)


class Outlet(Protocol):
    """Whoever else is told every message."""

    def take(self, sample: Sample, wall: float) -> None:
        """Take one, as received, that arrived at `wall` [s, our system clock]. Must not wait for anybody."""


class Watch:
    """Pumps messages from the buses, which share one mailbox, into the recording and the figures."""

    def __init__(
        self,
        monitor: Monitor,
        bus: Bus,
        recorder: Recorder | None,
        stage: RobotBuses,
        ros: RobotBus | None = None,
        page: Showing | None = None,
        outlet: Outlet | None = None,
    ) -> None:
        """`stage` leads to simulated robots, `ros` to where ROS 2 wants the figures, `outlet` to others."""
        self._monitor, self._bus, self._recorder = monitor, bus, recorder
        self._stage, self._ros, self._page, self._outlet = stage, ros, page, outlet
        self._linger = Linger()
        self._told = 0  # number of the newest event that was said with a snapshot

    def declare(self) -> None:
        """Declare all that is published and listened to. Raises BusError."""
        for topic, key in self._monitor.publications:
            self._bus.advertise(topic, key)
            if self._ros is not None:
                self._ros.advertise(topic, key)
        for topic, key in self._monitor.truths:
            self._stage.subscribe(topic, key)
        for key in self._monitor.subscriptions:
            self._bus.subscribe(key)

    def run(self, stop: Stop, *, snapshots: bool) -> None:
        """Watch until told to stop, and then until what was sent before has arrived.

        With `snapshots` tell programs five times a second, without tell people every two.
        """
        tell = Rate(5.0 if snapshots else 0.5)
        while not stop:
            now = clocks()
            self._pump(now)
            if self._page is not None:
                self._page.step(now, self._recorder)
            self._linger.tend(now.mono)
            if tell.tick(now.mono):
                self._tell(now, snapshots=snapshots)
            time.sleep(PERIOD)
        _log.info("stopping: %s", stop.reason)
        self._drain()

    def summary(self) -> dict[str, Any]:
        """What is said on stdout at the end. Ask once the recording is closed."""
        snapshot = self._monitor.metrics.snapshot(clocks())
        rejected = self._monitor.metrics.rejections.by_key
        return {
            "process": NAME,
            "published": dict(self._bus.published),
            "received": dict(self._bus.received),
            "robot": {
                "published": dict(self._ros.published) if self._ros else {},
                "received": dict(self._stage.received),
            },
            "dropped": {**rejected, "overflowed": self._bus.overflowed},
            "refused": dict(self._bus.refused),
            "rejected": dict(snapshot.rejected),
            "missed": snapshot.missed,
            "recorded": dict(self._recorder.recorded) if self._recorder else {},
            "recording": str(self._recorder.path) if self._recorder else None,
            "recording_failure": self._recorder.failure if self._recorder else None,
            "recording_lost": self._recorder.lost if self._recorder else 0,
            "recording_parts": [str(path) for path in self._recorder.paths] if self._recorder else [],
            "formation_error": snapshot.final_error,
            "known": snapshot.known_verdict.as_json(),
            "settling_time": snapshot.settling_time,
            "settled_at": snapshot.settled_at,
            "converged": snapshot.converged,
        }

    def _pump(self, now: Now) -> int:
        inbox = self._bus.drain()
        self._record(inbox, now)
        for out in self._monitor.step(now, inbox):
            self._bus.publish(out.key, out.payload, out.attachment)
            if self._ros is not None:
                self._ros.publish(out.key, out.payload)
            self._record([Sample(out.key, out.payload, out.attachment, now.mono)], now)
        if self._recorder is not None:
            self._recorder.flush(now.mono)
            for notice in self._recorder.notices():
                self._monitor.note(Event(now.wall, notice.level, "", "recording", notice.text))
        return len(inbox)

    def _record(self, samples: Sequence[Sample], now: Now) -> None:
        ahead = now.wall - now.mono
        if self._recorder is not None:
            for sample in samples:
                self._recorder.write(sample, sample.arrived + ahead)
        if self._outlet is not None:
            for sample in samples:
                self._outlet.take(sample, sample.arrived + ahead)

    def _drain(self) -> None:
        end = heard = time.monotonic()
        end += LAST_CALL
        while (now := clocks()).mono < min(end, heard + QUIET):
            if self._pump(now):
                heard = now.mono
            time.sleep(PERIOD)

    def _tell(self, now: Now, *, snapshots: bool) -> None:
        snapshot = self._monitor.metrics.snapshot(now)
        failure = self._recorder.failure if self._recorder else None
        if snapshots:
            news = [one for one in self._monitor.events if one.number > self._told]
            self._told = news[-1].number if news else self._told
            say(
                "snapshot",
                **as_json(snapshot),
                events=[one.event._asdict() for one in news],
                overflowed=self._bus.overflowed,
                recording_failure=failure,
            )
        else:
            _log.info("%s%s", line(snapshot), f"  NOT RECORDING: {failure}" if failure else "")
