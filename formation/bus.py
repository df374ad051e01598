"""The bus: a process's one Zenoh session. The only module that imports zenoh.

Zenoh's receive thread does as little as can be: it stamps the sample, appends it to a bounded queue and rings
a bell. Everything else happens on the main thread, which waits for the bell, drains the queue and answers
queries, so a slow main loop loses old samples (counted) but never stalls a link, and no core needs a lock.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import NamedTuple, Self

import zenoh

from formation.bus_config import DEFAULTS, ONE_THREAD, BusConfig, BusError, plain
from formation.topics import Topic
from formation.wire import Outgoing, Sample

__all__ = ["Bus", "BusConfig", "BusError", "Reply"]

_PRIORITY = {
    "real_time": zenoh.Priority.REAL_TIME,
    "data": zenoh.Priority.DATA,
    "background": zenoh.Priority.BACKGROUND,
}
MAX_QUERIES = 64
"""Queries that may wait to be served; more are turned away."""
CLOSE_LIMIT = 1.5
"""How long `Bus.close` may take [s]: a little longer than the lease of a peer that hangs."""
_log = logging.getLogger(__name__)


class Reply(NamedTuple):
    """One answer to `Bus.ask`."""

    key: str
    payload: bytes
    ms: float
    """Round trip [ms]."""


class Bus:
    """A session on the bus. Use it as a context manager: an open session keeps the process from exiting.

    Methods are for one thread, the main one; only `wake` may be called from a signal handler or another
    thread.
    """

    def __init__(self, config: BusConfig, *, capacity: int = 1024) -> None:
        """Open the session. `capacity` bounds the samples that wait to be drained. Raises BusError."""
        self.published: Counter[str] = Counter()
        """Messages handed to Zenoh, by key."""
        self.received: Counter[str] = Counter()
        """Messages that arrived, by key, overflowed ones included."""
        self.overflowed = 0
        """Messages that arrived and were pushed out by newer ones before anybody drained them."""
        self._samples: deque[Sample] = deque(maxlen=capacity)
        self._queries: deque[tuple[zenoh.Query, str, Callable[[bytes], bytes]]] = deque()
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._woken = False
        self._counting = threading.Lock()
        # A lock used as a bell: held while there is nothing to do, released to wake the main thread. That
        # neither blocks nor takes a second lock, so unlike an Event's `set` it is safe in a signal handler.
        self._bell = threading.Lock()
        self._bell.acquire()
        os.environ.setdefault("ZENOH_RUNTIME", ONE_THREAD)
        self._session: zenoh.Session | None = _open(config)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def advertise(self, topic: Topic, key: str) -> None:
        """Declare that this process will publish `key`, with the topic's quality of service."""
        if topic.qos is None:
            raise BusError(f"topic {topic.name!r} is a queryable: it is answered, not published")
        if key in self._publishers:
            raise BusError(f"{key!r} is advertised already")
        with _named(key):
            self._publishers[key] = self._live.declare_publisher(
                key,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=_PRIORITY[topic.qos.priority],
                express=topic.qos.express,
            )

    def publish(self, key: str, payload: bytes, attachment: bytes | None = None) -> None:
        """Send on an advertised key. Drops, and never waits for long, where the network does not keep up."""
        self._publisher(key).put(payload, attachment=attachment)
        self.published[key] += 1

    def send(self, outbox: Iterable[Outgoing]) -> None:
        """Publish all of `outbox`."""
        for out in outbox:
            self.publish(out.key, out.payload, out.attachment)

    def watched(self, key: str) -> bool:
        """Whether anybody subscribes to an advertised key right now."""
        # The stub promises a bool; what comes is an object that is always true.
        return bool(self._publisher(key).matching_status.matching)  # type: ignore[attr-defined]

    def subscribe(self, key: str) -> None:
        """Have the samples of `key` put into the queue that `drain` empties. Wildcards are allowed."""
        pattern = "*" in key

        def receive(sample: zenoh.Sample) -> None:  # on Zenoh's thread: must return at once
            arrived = time.monotonic()
            name = str(sample.key_expr) if pattern else key
            attachment = sample.attachment
            taken = Sample(
                name,
                sample.payload.to_bytes(),
                None if attachment is None else attachment.to_bytes(),
                arrived,
            )
            with self._counting:
                self.received[name] += 1
                self.overflowed += len(self._samples) == self._samples.maxlen
                self._samples.append(taken)
            self._ring()

        with _named(key):
            self._live.declare_subscriber(key, zenoh.handlers.Callback(receive, indirect=False))

    def drain(self) -> list[Sample]:
        """All samples that wait, in order of arrival."""
        return [self._samples.popleft() for _ in range(len(self._samples))]

    def wait(self, timeout: float) -> bool:
        """Sleep until a sample or query waits or `wake` was called, at most `timeout` [s]; whether so."""
        deadline = time.monotonic() + timeout
        while not (self._samples or self._queries or self._woken):
            left = deadline - time.monotonic()
            if left <= 0.0 or not self._bell.acquire(timeout=left):
                return False
        self._woken = False
        return True

    def wake(self) -> None:
        """Have the current or next `wait` return at once. Safe in a signal handler."""
        self._woken = True
        self._ring()

    def answer(self, key: str, handler: Callable[[bytes], bytes]) -> None:
        """Answer queries on `key` with ``handler(request)``, called by `serve` on the main thread."""

        def receive(query: zenoh.Query) -> None:  # on Zenoh's thread: must return at once
            if len(self._queries) < MAX_QUERIES:
                self._queries.append((query, key, handler))
                self._ring()
            else:
                query.drop()  # type: ignore[no-untyped-call]

        with _named(key):
            self._live.declare_queryable(key, zenoh.handlers.Callback(receive, indirect=False))

    def serve(self) -> int:
        """Answer the queries that wait; how many."""
        waiting = len(self._queries)
        for _ in range(waiting):
            query, key, handler = self._queries.popleft()
            with query:
                payload = query.payload
                query.reply(key, handler(b"" if payload is None else payload.to_bytes()))
        return waiting

    def ask(self, key: str, payload: bytes, timeout: float) -> list[Reply]:
        """Query everybody who answers `key` (wildcards are allowed) and wait for all, at most `timeout` [s].

        That is everybody linked whom this session has heard of by now, and who does not answer in time is
        simply missing. Must not ask what this very process answers.
        """
        replies: list[Reply] = []
        done = threading.Event()
        start = time.perf_counter()

        def receive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                ms = (time.perf_counter() - start) * 1e3
                replies.append(Reply(str(reply.ok.key_expr), reply.ok.payload.to_bytes(), ms))

        with _named(key):
            self._live.get(
                key,
                zenoh.handlers.Callback(receive, done.set, indirect=False),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout,
                payload=payload,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )
        done.wait(timeout)
        return list(replies)

    def close(self) -> None:
        """Send what was published and close the session, within `CLOSE_LIMIT`; twice does no harm."""
        session, self._session = self._session, None
        if session is None:
            return
        while self._queries:
            self._queries.popleft()[0].drop()  # type: ignore[no-untyped-call]
        # Zenoh waits up to 10 s for a peer that has stopped reading; a daemon thread does not keep us.
        closing = threading.Thread(target=_close, args=(session,), name="bus-close", daemon=True)
        closing.start()
        closing.join(CLOSE_LIMIT)
        if closing.is_alive():
            _log.warning("the bus did not close within %g s: a peer has stopped reading", CLOSE_LIMIT)

    @property
    def _live(self) -> zenoh.Session:
        if self._session is None:
            raise BusError("the bus is closed")
        return self._session

    def _publisher(self, key: str) -> zenoh.Publisher:
        publisher = self._publishers.get(key)
        if self._session is None or publisher is None:
            known = ", ".join(self._publishers) or "none"
            raise BusError(
                "the bus is closed" if self._session is None else f"{key!r} is not advertised: {known}"
            )
        return publisher

    def _ring(self) -> None:
        with suppress(RuntimeError):  # it rings already
            self._bell.release()


def _open(config: BusConfig) -> zenoh.Session:
    settings = _settings(config)
    with _named(f"the bus cannot be opened, listening on {', '.join(config.listen) or 'nothing'}"):
        return zenoh.open(settings)


def _settings(config: BusConfig) -> zenoh.Config:
    settings = untouched = zenoh.Config()
    if config.config_file is not None:
        with _named(f"--config {str(config.config_file)!r}"):
            settings = zenoh.Config.from_file(config.config_file)
    left_open = [
        (path, value)
        for path, value in DEFAULTS
        if json.loads(settings.get_json(path)) == json.loads(untouched.get_json(path))
    ]
    for path, value in left_open + config.flags():
        settings.insert_json5(path, value)
    for path, value in config.overrides:
        with _named(f"--cfg {path}:{value}"):
            settings.insert_json5(path, value)
    return settings


def _close(session: zenoh.Session) -> None:
    try:
        session.close()  # type: ignore[no-untyped-call]
    except zenoh.ZError as error:
        _log.warning("the bus did not close cleanly: %s", plain(error))


@contextmanager
def _named(what: str) -> Iterator[None]:
    """Turn Zenoh's errors into a BusError that says of `what`."""
    try:
        yield
    except zenoh.ZError as error:
        raise BusError(f"{what}: {plain(error)}") from None
