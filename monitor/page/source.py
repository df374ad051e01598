"""What the page shows, handed from the thread that watches to the thread that serves.

The one puts in, the other takes out, and neither waits for the other. Only the newest frame is kept: whoever
is too slow for ten a second gets fewer, never older ones. Nothing here knows whether it is live or a replay.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from threading import Lock
from typing import Any, NamedTuple

from monitor.figures.snapshot import Snapshot

HISTORY = 1200
"""Values of the formation error that a new page is given: ten minutes at two a second."""
EVENTS = 500
"""Newest events that it is given."""

AGAIN = b"retry: 1000\n"
"""After so long a page dials again [ms]."""


class Look(NamedTuple):
    """The formation of one moment, as it goes out."""

    number: int
    chunk: bytes
    """As a server-sent event."""
    frame: Mapping[str, Any]
    snapshot: Snapshot


class Greeting(NamedTuple):
    """What a connection begins with, and what is already in it."""

    chunk: bytes
    epoch: int
    events: int


class Source:
    """Newest frame, events, and what a new page needs to know. Methods may be called from any thread."""

    def __init__(self, about: Mapping[str, Any], clock: Callable[[], float]) -> None:
        """`about` is `frames.hello`; `clock` tells the time that the page is to have [s, system clock]."""
        self.look: Look | None = None
        """The newest frame there is."""
        self.epoch = 0
        """Another number: what was said before does not count any more, as after a jump in a replay."""
        self._about, self._clock = dict(about), clock
        self._history: deque[tuple[float, float | None]] = deque(maxlen=HISTORY)
        self._events: deque[tuple[int, Mapping[str, Any], bytes]] = deque(maxlen=EVENTS)
        self.shapes: tuple[str, ...] = tuple(about["shapes"])
        """That can be ordered."""
        self._lock = Lock()
        self._number = 0
        self._looking = 0
        self._wake: Callable[[], None] = _nobody

    # what the watching thread says

    @property
    def wanted(self) -> bool:
        """Whether anybody looks. If not, no frame needs to be made."""
        return self._looking > 0

    def show(self, frame: Mapping[str, Any], snapshot: Snapshot) -> None:
        """Take the newest frame, and the snapshot it was made of. Raises ValueError for what is no JSON."""
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
        self,
        history: Iterable[tuple[float, float | None]] = (),
        events: Iterable[Mapping[str, Any]] = (),
    ) -> None:
        """Have these instead of the history and the events so far; everybody is greeted anew."""
        points = [_point(*point) for point in history]
        told = [(event["n"], event, _event_chunk(event)) for event in events]
        with self._lock:
            self._history.clear()
            self._history.extend(points)
            self._events.clear()
            self._events.extend(told)
            self.look = None
            self.epoch += 1
        self._wake()

    # what the serving thread asks

    def wakes(self, wake: Callable[[], None] | None) -> None:
        """Have `wake` called, from the watching thread, whenever there is something new."""
        self._wake = wake or _nobody

    def looking(self, people: int) -> None:
        """So many look, or wait for one frame."""
        self._looking = people

    def greeting(self) -> Greeting:
        """What a connection begins with."""
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
        """The number of the newest event, and all that came after the one with number `after`."""
        with self._lock:
            news = [(number, chunk) for number, _, chunk in self._events if number > after]
        return (news[-1][0] if news else after), b"".join(chunk for _, chunk in news)


def _nobody() -> None:
    """Nobody serves."""


def _json(value: Mapping[str, Any]) -> bytes:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()


def _point(at: float, error: float | None) -> tuple[float, float | None]:
    return round(at, 2), None if error is None else round(error, 4)


def _event_chunk(event: Mapping[str, Any]) -> bytes:
    return _chunk("event", f"event-{event['n']}", _json(event))


def _chunk(kind: str, number: int | str, data: bytes) -> bytes:
    """One server-sent event."""
    return b"id: %s\nevent: %s\ndata: %s\n\n" % (str(number).encode(), kind.encode(), data)
