"""Data for the page, handed from the watching thread to the serving thread.

Neither thread waits for the other. Only the newest frame is kept: a client that is too slow for ten a second
gets fewer frames, never older ones. It works the same for live data and a replay.
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from threading import Lock
from typing import Any, NamedTuple

from formation.monitor.metrics.feed import rounded
from formation.monitor.metrics.snapshot import Snapshot

HISTORY_RATE = 2.0
"""Rate of the formation error's history for new pages [Hz]."""
HISTORY_VALUES = 1200
"""Number of its values: ten minutes."""
MAX_EVENTS = 500
"""Number of newest events for a new page."""

AGAIN = b"retry: 1000\n"
"""Time after which a page reconnects [ms]."""


class Look(NamedTuple):
    """The formation at one moment, as sent."""

    number: int
    chunk: bytes
    """The frame as a server-sent event."""
    frame: Mapping[str, Any]
    snapshot: Snapshot


class Greeting(NamedTuple):
    """The start of a stream, and the newest data already in it."""

    chunk: bytes
    epoch: int
    events: int


class Source:
    """Newest frame, events, and the data for a new page. Methods may be called from any thread."""

    def __init__(
        self,
        about: Mapping[str, Any],
        clock: Callable[[], float],
        mono: Callable[[], float] = time.monotonic,
    ) -> None:
        """`about` is `frames.hello`; `clock` gives the time for the page [s, system clock].

        `mono` gives the time of steps [s, monotonic].
        """
        self.look: Look | None = None
        """The newest frame."""
        self.epoch = 0
        """Changes when earlier data becomes invalid, as after a jump in a replay."""
        self._about, self._clock, self._mono = dict(about), clock, mono
        self._stepped = mono()
        self._history: deque[tuple[float, float | None]] = deque(maxlen=HISTORY_VALUES)
        self._events: deque[tuple[int, Mapping[str, Any], bytes]] = deque(maxlen=MAX_EVENTS)
        self.shapes: tuple[str, ...] = tuple(about["shapes"])
        """Shapes that can be ordered."""
        self._lock = Lock()
        self._number = 0
        self._clients = 0
        self._wake: Callable[[], None] = lambda: None

    # news from the watching thread

    @property
    def wanted(self) -> bool:
        """Whether any client is connected. If not, no frame needs to be made."""
        return self._clients > 0

    def step(self) -> None:
        """Record that the watching thread has shown all that is new."""
        self._stepped = self._mono()

    def show(self, frame: Mapping[str, Any], snapshot: Snapshot) -> None:
        """Take the newest frame and its snapshot. Raises ValueError if it is not valid JSON."""
        data = _json(frame)
        with self._lock:
            self._number += 1
            self.look = Look(self._number, _chunk("frame", self._number, data), frame, snapshot)
        self._wake()

    def observe(self, at: float, error: float | None) -> None:
        """Remember the formation error [m] of a moment [s]; twice a second is enough."""
        with self._lock:
            self._history.append(_point(at, error))

    def note(self, event: Mapping[str, Any]) -> None:
        """Take an event: n, which only grows, at, level, robot, kind, text. Raises ValueError as `show`."""
        chunk = _event_chunk(event)
        with self._lock:
            self._events.append((event["n"], event, chunk))
        self._wake()

    def tell(self, **about: Any) -> None:
        """Change what new pages are told, such as the recording's path."""
        with self._lock:
            self._about.update(about)

    def restart(
        self, history: Iterable[tuple[float, float | None]] = (), events: Iterable[Mapping[str, Any]] = ()
    ) -> None:
        """Replace the history and the events; all clients are greeted again."""
        points = [_point(*point) for point in history]
        encoded = [(event["n"], event, _event_chunk(event)) for event in events]
        with self._lock:
            self._history.clear()
            self._history.extend(points)
            self._events.clear()
            self._events.extend(encoded)
            self.look = None
            self.epoch += 1
        self._wake()

    # requests from the serving thread

    def set_wake(self, wake: Callable[[], None] | None) -> None:
        """Call `wake`, from the watching thread, whenever there is news."""
        self._wake = wake or (lambda: None)

    @property
    def step_age(self) -> float:
        """Time since the newest step, or since the start [s]."""
        return self._mono() - self._stepped

    def set_clients(self, count: int) -> None:
        """Set the number of clients that look, or wait for one frame."""
        self._clients = count

    def greeting(self) -> Greeting:
        """Return the start of a stream."""
        with self._lock:
            hello = {
                "recording": None,
                **self._about,
                "history": list(self._history),
                "events": [event for _, event, _ in self._events],
                "now": self._clock(),
            }
            last = self._events[-1][0] if self._events else -1
            epoch = self.epoch
        return Greeting(AGAIN + _chunk("hello", f"hello-{epoch}", _json(hello)), epoch, last)

    def events(self, after: int) -> tuple[int, bytes]:
        """Return the number of the newest event, and all events after number `after`."""
        with self._lock:
            news = [(number, chunk) for number, _, chunk in self._events if number > after]
        return (news[-1][0] if news else after), b"".join(chunk for _, chunk in news)


def _point(at: float, error: float | None) -> tuple[float, float | None]:
    return round(at, 2), rounded(error, 4)


def _event_chunk(event: Mapping[str, Any]) -> bytes:
    return _chunk("event", f"event-{event['n']}", _json(event))


def _json(value: Mapping[str, Any]) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def _chunk(kind: str, number: int | str, data: str) -> bytes:
    return f"id: {number}\nevent: {kind}\ndata: {data}\n\n".encode()
