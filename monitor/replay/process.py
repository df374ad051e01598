"""Play a recording to the page and onto the bus, in turns of a few hundredths of a second.

Any thread may steer; a request is done at the beginning of the next turn. The metrics have precedence: if a
recording is played faster than this machine can, all messages are in the metrics, but late ones are not
published.
"""

from __future__ import annotations

import math
import time
from collections import deque
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any

from formation.mission.model import Mission
from formation.monitor.core import newer_than
from formation.monitor.metrics.event import Event, from_message
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.recording.reader import Recorded, Rerun
from formation.monitor.replay.echo import Echo
from formation.monitor.replay.player import Player
from formation.monitor.web import frames
from formation.monitor.web.source import HISTORY_RATE, HISTORY_VALUES, MAX_EVENTS, Source
from formation.ros2.messages import LogEntry, Number, decode
from formation.topics import ERROR, EVENTS
from formation.transport.runtime.rate import Rate
from formation.wire import BadMessage, Now

MAX_TURN_TIME = 0.05
"""Longest time for taking messages in one turn [s]."""
BATCH_MESSAGES = 100
"""Messages between two looks at the clock."""
MIN_PAUSE, MAX_PAUSE = 0.001, 0.02
"""Pause between two turns [s]."""
MAX_LATENESS = 0.2
"""At more than normal speed, a message that is later than this is not published [s, real]."""
FRAME_RATE = 10.0
"""Rate of frames [Hz]."""
STEERING_TIMEOUT_SECONDS = 2.0
"""How long a steering request waits for its turn [s]."""
SteeringRequest = tuple[str, float | None, "Future[dict[str, Any]]"]


class Picture:
    """The metrics, the error so far and the events of all messages since a beginning."""

    def __init__(self, mission: Mission) -> None:
        self.rerun = Rerun(mission)
        self.history: deque[tuple[float, float]] = deque(maxlen=HISTORY_VALUES)
        """The formation error [m] of moments [s, the recorder's system clock], two a second."""
        self.events: deque[tuple[int, Event]] = deque(maxlen=MAX_EVENTS)
        """The newest events with their numbers, oldest first."""
        self.shown_at, self.shown_event = -math.inf, 0
        """The newest moment of the history and the newest event that the page has."""
        self._happened = 0
        self._rate = Rate(HISTORY_RATE)

    def process_message(self, message: Recorded) -> None:
        """Take in the next message."""
        self.rerun.process_message(message)
        sample, mono = message.sample, message.sample.arrived
        try:
            if sample.key == ERROR.key() and self._rate.tick(mono):
                self.history.append((mono, decode(Number, sample.payload).value))
            elif sample.key == EVENTS.key():
                self._happened += 1
                event = from_message(decode(LogEntry, sample.payload))
                event = event._replace(at=event.at + (mono - message.wall))
                self.events.append((self._happened, event))
        except BadMessage:
            return  # of the monitor's own messages, which the metrics do not use either

    def show(self, source: Source, *, restarts: bool) -> None:
        """Tell the page what is new, or everything if it has another picture."""
        if restarts:
            source.restart(self.history, (frames.event(*one) for one in self.events))
        else:
            for error in newer_than(self.history, self.shown_at):
                source.observe(*error)
            for event in newer_than(self.events, self.shown_event):
                source.note(frames.event(*event))
        self.shown_at = self.history[-1][0] if self.history else -math.inf
        self.shown_event = self._happened


@dataclass(frozen=True, slots=True)
class ReplayState:
    """State of a replay. Times of the recording are on its recorder's system clock [s]."""

    position: float
    start: float
    end: float
    speed: float
    paused: bool
    seeking: bool
    finished: bool
    counted_from: float
    """Since when settling and counts are known: later than the start after a seek into a long recording."""
    drift: float
    """Additional playing time because it could not keep up [s, real]."""
    played: int
    """Messages played so far, repetitions included."""
    published: int
    """Messages published on the bus."""
    skipped: int
    """Messages that were too late for the bus."""
    seeks: int
    """Seeks so far: tells frames from before a seek from those after it."""

    def as_json(self) -> dict[str, Any]:
        """Return it for a frame, or as the answer to steering."""
        return {
            "t": round(self.position, 3),
            **{name: round(getattr(self, name), 3) for name in ("start", "end", "counted_from", "drift")},
            **{name: getattr(self, name) for name in ("speed", "paused", "seeking", "finished")},
            **{name: getattr(self, name) for name in ("skipped", "seeks")},
        }


class Replay:
    """Play one recording. `steer` may be called from any thread, all else from one."""

    def __init__(
        self,
        mission: Mission,
        player: Player,
        source: Source | None = None,
        echo: Echo | None = None,
        loop_from: float | None = None,
    ) -> None:
        """`source` is the page's, `echo` publishes on the bus.

        At its end it goes on from `loop_from` [s, the recorder's system clock], if given.
        """
        self._mission, self._player = mission, player
        self._source, self._echo, self._loop_from = source, echo, loop_from
        self._picture = Picture(mission)
        self._requests: SimpleQueue[SteeringRequest] = SimpleQueue()
        self._frames = Rate(FRAME_RATE)
        self._played = self._skipped = 0

    @property
    def state(self) -> ReplayState:
        """The state of the replay."""
        player = self._player
        return ReplayState(
            player.goal, player.start, player.end, player.speed, player.paused, player.seeking,
            player.finished, player.built_from, player.lost + player.behind, self._played,
            self._echo.published if self._echo else 0, self._skipped, player.seeks,
        )  # fmt: skip

    @property
    def snapshot(self) -> Snapshot:
        """The metrics at the position."""
        at = self._player.position
        return self._picture.rerun.metrics.snapshot(Now(at, at))

    def steer(self, do: str, to: float | None) -> dict[str, Any]:
        """Pause, play, seek to a time [s, recorder's system clock] or set the speed; return the new state.

        Raises ValueError for an invalid request.
        """
        done: Future[dict[str, Any]] = Future()
        self._requests.put((do, to, done))
        with suppress(TimeoutError):
            return done.result(STEERING_TIMEOUT_SECONDS)
        return self.state.as_json()

    def step(self, do: str, to: float | None = None) -> None:
        """Steer at once, in the thread that has the turns."""
        mono, player = time.monotonic(), self._player
        if do == "pause":
            player.pause()
        elif do == "play":
            player.play(mono)
        elif to is None:
            raise ValueError(f"{do}: where to? `to` must be a number")
        elif do == "seek":
            player.seek(to)
        else:
            player.set_speed(mono, to)

    def turn(self) -> float:
        """Do requests, take due messages, show them; return how long the next turn can wait [s].

        Returns after little more than `MAX_TURN_TIME`.
        """
        self._do_requests()
        was_seeking = self._player.seeking
        self._process_due()
        if self._source is not None:
            if self._player.seeking:
                self._show_while_seeking(self._source)
            else:
                self._show(self._source, restarts=was_seeking)
            self._source.step()
        if self._loop_from is not None and self._player.finished and not self._player.paused:
            self._player.seek(self._loop_from)
        return min(max(self._player.idle(time.monotonic()), MIN_PAUSE), MAX_PAUSE)

    def _do_requests(self) -> None:
        with suppress(Empty):
            while True:
                do, to, done = self._requests.get_nowait()
                try:
                    self.step(do, to)
                    done.set_result(self.state.as_json())
                except ValueError as error:
                    done.set_exception(error)

    def _process_due(self) -> None:
        end = time.monotonic() + MAX_TURN_TIME
        while (mono := time.monotonic()) < end:
            lost = self._player.lost
            batch = self._player.next_batch(mono, BATCH_MESSAGES)
            behind = self._player.behind > MAX_LATENESS or self._player.lost > lost
            late = behind and self._player.speed > 1.0
            if batch.restarts:
                self._picture = Picture(self._mission)
            for message, played in batch.due:
                self._picture.process_message(message)
                self._played += played
                if played and self._echo is not None:
                    if late:
                        self._skipped += 1
                    else:
                        self._echo.publish(message.sample)
            if len(batch.due) < BATCH_MESSAGES:
                return

    def _show_while_seeking(self, source: Source) -> None:
        """Show the last frame and the goal, while seeking, to pages opened meanwhile."""
        last = source.look
        if last is not None and source.wanted and self._frames.tick(time.monotonic()):
            source.show({**last.frame, "replay": self.state.as_json()}, last.snapshot)

    def _show(self, source: Source, *, restarts: bool) -> None:
        self._picture.show(source, restarts=restarts)
        if source.wanted and self._frames.tick(time.monotonic()):
            at, snapshot = self._player.position, self.snapshot
            frame = frames.frame(
                self._mission, self._picture.rerun.metrics, Now(at, at),
                snapshot=snapshot, replay=self.state.as_json(),
            )  # fmt: skip
            source.show(frame, snapshot)
