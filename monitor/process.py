"""The monitor on its buses: each message is recorded before it is decoded.

Messages are processed together, fifty times a second. That is enough for people and for 10 Hz metrics, and
at thousands of messages a second far cheaper than waking for each.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from formation.mission.model import Mission
from formation.monitor.core import Monitor, newer_than
from formation.monitor.metrics.event import WARNING, Event
from formation.monitor.metrics.keys import OWN
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.metrics.words import as_json, line
from formation.monitor.recording.recorder import Recorder
from formation.monitor.web import frames
from formation.monitor.web.source import HISTORY_RATE, Source
from formation.transport.linger import Linger
from formation.transport.runtime.loop import FleetSide, Pauses, RobotSide, StopRequest
from formation.transport.runtime.process import clocks, say
from formation.transport.runtime.rate import Rate
from formation.wire import Now, Outgoing, Sample

NAME = "monitor"
MAX_WAITING_MESSAGES = 65_536
"""Number of messages that may wait: ten seconds of 6000 a second, while the disk is busy."""
STEP_PERIOD = 0.02
"""[s]"""
QUIET_TIME = 0.2
"""Silence after which, at the end, no more messages are expected [s]."""
STOP_TIMEOUT_SECONDS = 1.0
"""Longest time to go on after a request to stop while the fleet still sends [s]."""
MAX_WARNING_RATE = 0.1
"""Highest rate of reports about a failing page, and about too many messages [Hz]."""
_log = logging.getLogger(__name__)


class PageUpdater:
    """Update the page of one monitor: a frame for every new snapshot, and every event.

    Failures here are logged, and the monitor goes on.
    """

    def __init__(self, mission: Mission, monitor: Monitor, source: Source) -> None:
        self._mission, self._monitor, self._source = mission, monitor, source
        self._history, self._warnings = Rate(HISTORY_RATE), Rate(MAX_WARNING_RATE)
        self._begun = math.inf
        self._shown: Snapshot | None = None
        self._reported = 0

    def step(self, now: Now, recorder: Recorder | None) -> None:
        """Show what is new since the last step. Call it right after the monitor's step."""
        self._begun = min(self._begun, now.mono)
        try:
            for number, event in newer_than(self._monitor.events, self._reported):
                self._reported = number
                self._source.note(frames.event(number, event))
            self._frame(now, recorder)
            self._source.step()
        except Exception:  # noqa: BLE001 - the monitor must go on without a page
            if self._warnings.tick(now.mono):
                _log.exception("the page cannot be updated")

    def _frame(self, now: Now, recorder: Recorder | None) -> None:
        snapshot = self._monitor.snapshot
        if snapshot is None or snapshot is self._shown:
            return
        self._shown = snapshot
        if self._history.tick(now.mono):
            self._source.observe(now.wall, snapshot.formation_error)
        if self._source.wanted:
            recording = _recording(recorder, now.mono - self._begun)
            metrics = self._monitor.metrics
            frame = frames.frame(self._mission, metrics, now, snapshot=snapshot, recording=recording)
            self._source.show(frame, snapshot)


def _recording(recorder: Recorder | None, seconds: float) -> Mapping[str, Any] | None:
    if recorder is None:
        return None
    path, failure = str(recorder.paths[-1]), recorder.failure
    return {"path": path, "bytes": recorder.bytes, "seconds": round(seconds, 1), "failure": failure}


class MonitorLoop:
    """Move messages from the buses, which share one mailbox, into the recording and the metrics."""

    def __init__(
        self,
        monitor: Monitor,
        bus: FleetSide,
        recorder: Recorder | None,
        stage: RobotSide,
        ros: RobotSide | None = None,
        page: PageUpdater | None = None,
        export: Callable[[Sample, float], None] | None = None,
        clock: Callable[[], Now] = clocks,
        tend: Callable[[float], None] | None = None,
    ) -> None:
        """`stage` is the bus to simulated robots, `ros` that for metrics in ROS 2.

        `export` takes every message, as received, and its arrival [s, our system clock]. It must not block.
        `tend` is called after each step with the time [s, monotonic]; by default it tends sockets.
        """
        self._clock, self._tend = clock, tend or Linger().tend
        self._monitor, self._bus, self._recorder = monitor, bus, recorder
        self._stage, self._ros, self._page, self._export = stage, ros, page, export
        self._reported = 0  # number of the newest event sent with a snapshot
        self._overflowed, self._warnings = 0, Rate(MAX_WARNING_RATE)

    def declare(self) -> None:
        """Declare all publications and subscriptions. Raises BusError."""
        for one in OWN:
            self._bus.advertise(one.topic, one.key)
            if self._ros is not None:
                self._ros.advertise(one.topic, one.key)
        for topic, key in self._monitor.truth_topics:
            self._stage.subscribe(topic, key)
        for key in self._monitor.subscriptions:
            self._bus.subscribe(key)

    def run(self, stop: StopRequest, *, snapshots: bool) -> Pauses:
        """Watch until told to stop, and then until earlier messages have arrived; nothing ends a pause early.

        With `snapshots`, print for programs five times a second, else for people every two seconds.
        """
        print_rate = Rate(5.0 if snapshots else 0.5)
        while not stop:
            now = self._clock()
            self._process_messages(now)
            if self._page is not None:
                self._page.step(now, self._recorder)
            self._tend(now.mono)
            if print_rate.tick(now.mono):
                self._print_state(now, snapshots=snapshots)
            yield STEP_PERIOD
        _log.info("stopping: %s", stop.reason)
        yield from self._drain()

    def summary(self) -> dict[str, Any]:
        """Return the summary for stdout. Call it after closing the recording."""
        snapshot = self._monitor.metrics.snapshot(self._clock())
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

    @property
    def unrecorded(self) -> str:
        """Why the recording, if there is one, lacks messages that arrived; empty if it has all."""
        if self._recorder is None:
            return ""
        numbers = {"lost by the disk": self._recorder.lost, "arrived too fast": self._bus.overflowed}
        found = [f"{number} {why}" for why, number in numbers.items() if number]
        return ", ".join(filter(None, [self._recorder.failure, *found]))

    def _process_messages(self, now: Now) -> int:
        inbox = self._bus.drain()
        self._publish(self._monitor.watch_clock(now), now)
        self._record(inbox, now)
        self._watch_overflow(now)
        self._publish(self._monitor.step(now, inbox), now)
        if self._recorder is not None:
            self._recorder.flush(now.mono)
            for notice in self._recorder.notices():
                self._monitor.note(Event(now.wall, notice.level, "", "recording", notice.text))
        return len(inbox)

    def _watch_overflow(self, now: Now) -> None:
        """Note messages that came while too many waited; at most every 10 s."""
        lost = self._bus.overflowed - self._overflowed
        if lost and self._warnings.tick(now.mono):
            self._overflowed += lost
            text = f"{lost} messages came while the monitor was busy: neither measured nor recorded"
            self._monitor.note(Event(now.wall, WARNING, "", "recording", text))

    def _publish(self, outbox: Sequence[Outgoing], now: Now) -> None:
        for out in outbox:
            self._bus.publish(out.key, out.payload, out.attachment)
            if self._ros is not None:
                self._ros.publish(out.key, out.payload)
            self._record([Sample(out.key, out.payload, out.attachment, now.mono)], now)

    def _record(self, samples: Sequence[Sample], now: Now) -> None:
        ahead = now.wall - now.mono
        for sample in samples:
            if self._recorder is not None:
                self._recorder.write(sample, sample.arrived + ahead)
            if self._export is not None:
                self._export(sample, sample.arrived + ahead)

    def _drain(self) -> Pauses:
        end = received = self._clock().mono
        end += STOP_TIMEOUT_SECONDS
        while (now := self._clock()).mono < min(end, received + QUIET_TIME):
            if self._process_messages(now):
                received = now.mono
            yield STEP_PERIOD

    def _print_state(self, now: Now, *, snapshots: bool) -> None:
        snapshot = self._monitor.metrics.snapshot(now)
        failure = self._recorder.failure if self._recorder else None
        if snapshots:
            news = newer_than(self._monitor.events, self._reported)
            self._reported = news[-1].number if news else self._reported
            say(
                "snapshot",
                **as_json(snapshot),
                events=[one.event._asdict() for one in news],
                overflowed=self._bus.overflowed,
                recording_failure=failure,
            )
        else:
            _log.info("%s%s", line(snapshot), f"  NOT RECORDING: {failure}" if failure else "")
