"""A queue of all messages to a process, from all its buses, for its main thread; queries in both directions.

A receive thread does as little as possible: it appends to a bounded queue and wakes the main thread,
unless the message can wait for another one. The main thread waits, drains the queue and answers queries,
so a slow main loop loses old samples (counted) but never stalls a link, and no core needs a lock.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple, Protocol

from formation.transport.runtime.clock import monotonic
from formation.wire import Sample

Handler = Callable[[bytes, float], bytes]
"""Answers ``handler(request, received)``; ``received`` is the time of arrival [s, monotonic]."""
MAX_QUERIES = 64
"""Most queries that wait to be served; more are refused."""


class Query(Protocol):
    """A query that waits for its answer."""

    @property
    def request(self) -> bytes:
        """The payload of the query."""

    def answer(self, reply: bytes) -> None:
        """Send the answer; the query must not be used afterwards."""

    def drop(self) -> None:
        """Refuse it."""


class Mailbox:
    """One bounded queue and one bell for all of a process's buses.

    `put`, `accept`, `ring` and `wake` are for any thread, `wake` also for signal handlers; all else is for
    the main thread.
    """

    def __init__(self, capacity: int = 1024, clock: Callable[[], float] = monotonic) -> None:
        """`capacity` bounds the samples that wait to be drained; `clock` stamps queries [s, monotonic]."""
        self._clock = clock
        self.received: Counter[str] = Counter()
        """Messages that arrived on any bus, by key, overflowed ones included."""
        self.overflowed = 0
        """Messages that newer ones pushed out before they were drained."""
        self._samples: deque[Sample] = deque(maxlen=capacity)
        self._queries: deque[tuple[Query, Handler, float]] = deque()
        self._woken = False
        self._pressing = False  # whether any of the samples has rung
        self._counting = threading.Lock()
        # A lock used as a bell: held while there is nothing to do, released to wake the main thread. That
        # neither blocks nor takes a second lock, so unlike an Event's `set` it is safe in a signal handler.
        self._bell = threading.Lock()
        self._bell.acquire()

    def put(self, sample: Sample, *also_counted: Counter[str], wakes: bool = True) -> None:
        """Append `sample`, count it (in `also_counted` as well), and ring if it `wakes`."""
        with self._counting:
            self.received[sample.key] += 1
            for counts in also_counted:
                counts[sample.key] += 1
            self.overflowed += len(self._samples) == self._samples.maxlen
            self._samples.append(sample)
            self._pressing |= wakes
        if wakes:
            self.ring()

    def accept(self, query: Query, handler: Handler) -> None:
        """Queue `query` for `handler`; if there are too many, refuse it."""
        if len(self._queries) < MAX_QUERIES:
            self._queries.append((query, handler, self._clock()))
            self.ring()
        else:
            query.drop()

    def drain(self) -> list[Sample]:
        """All waiting samples, in order of arrival."""
        with self._counting:
            self._pressing = False
            return [self._samples.popleft() for _ in range(len(self._samples))]

    def serve(self) -> int:
        """Answer the waiting queries; return their number."""
        waiting = len(self._queries)
        for _ in range(waiting):
            query, handler, received = self._queries.popleft()
            query.answer(handler(query.request, received))
        return waiting

    def turn_away(self) -> None:
        """Drop the waiting queries, which will not be answered."""
        while self._queries:
            self._queries.popleft()[0].drop()

    def wait(self, timeout: float) -> bool:
        """Sleep until a waking sample or a query waits or `wake` is called, or `timeout` [s]; whether so."""
        deadline = time.monotonic() + timeout
        while not (self._pressing or self._queries or self._woken):
            left = deadline - time.monotonic()
            if left <= 0.0 or not self._bell.acquire(timeout=left):
                return False
        self._woken = False
        return True

    def wake(self) -> None:
        """Make the current or next `wait` return at once. Safe in a signal handler."""
        self._woken = True
        self.ring()

    def ring(self) -> None:
        """Wake a thread that sleeps in `wait`."""
        if self._bell.locked():  # else it rings already, which is usual at thousands of messages a second
            with suppress(RuntimeError):  # another thread was faster
                self._bell.release()


class Reply(NamedTuple):
    """One answer."""

    key: str
    payload: bytes
    ms: float
    """Round trip [ms]."""


class Question:
    """A query that was sent, and the answers received so far."""

    def __init__(self) -> None:
        self.replies: list[Reply] = []
        """Answers so far."""
        self._start = time.perf_counter()
        self._done = threading.Event()

    @property
    def over(self) -> bool:
        """Whether no more answers will come: all have answered, it timed out, or there is no queryable."""
        return self._done.is_set()

    def wait(self, patience: float) -> bool:
        """Wait until it is `over`, at most this time [s]; whether it is."""
        return self._done.wait(patience)

    def add_reply(self, key: str, payload: bytes) -> None:
        """Add an answer."""
        self.replies.append(Reply(key, payload, (time.perf_counter() - self._start) * 1e3))

    def end(self) -> None:
        """End the question: no more answers will come."""
        self._done.set()
