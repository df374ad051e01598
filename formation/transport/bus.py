"""The bus: one Zenoh session of a process. Only this module and `formation.transport.session` import zenoh.

Zenoh's receive thread stamps each message and puts it into a mailbox; everything else happens on the main
thread. A process with several buses has one mailbox for them all.
"""

from __future__ import annotations

import ctypes
import logging
import os
import sys
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from typing import Self

import zenoh

from formation.topics import Topic
from formation.transport.bus_config import THREADS, BusConfig, BusError
from formation.transport.mailbox import Handler, Mailbox, Question, Reply
from formation.transport.runtime.clock import monotonic, wall
from formation.transport.session import closed, named, opened, refusals_of, setting, settings_of
from formation.wire import Outgoing, Sample

__all__ = ["Bus", "BusConfig", "BusError", "setting"]

_PRIORITY = {
    "real_time": zenoh.Priority.REAL_TIME,
    "data": zenoh.Priority.DATA,
    "background": zenoh.Priority.BACKGROUND,
}
_CONGESTION = {False: zenoh.CongestionControl.DROP, True: zenoh.CongestionControl.BLOCK}
# Messages that may be dropped use a link that drops, if there is one (an endpoint with ``?rel=0``): over TCP
# lost data are resent, and delay all later messages for seconds.
_RELIABILITY = {False: zenoh.Reliability.BEST_EFFORT, True: zenoh.Reliability.RELIABLE}
CLOSE_TIMEOUT_SECONDS = 1.5
"""Longest duration of `Bus.close` [s]: a little longer than the lease of a peer that hangs."""
_M_ARENA_MAX = -8
"""Of glibc's malloc.h."""
_LEFT: list[threading.Thread] = []
_log = logging.getLogger(__name__)


def still_closing() -> bool:
    """Whether a session is being closed in the background: an interpreter that exits meanwhile may abort."""
    return any(thread.is_alive() for thread in _LEFT)


class Bus:
    """A session on the bus. Use it as a context manager: an open session keeps the process from exiting.

    Methods are for one thread, the main one; only `wake` may be called from a signal handler or another
    thread, and `ask` and `question` from any thread.
    """

    def __init__(self, config: BusConfig, mailbox: Mailbox | None = None, *, capacity: int = 1024) -> None:
        """Open the session. Messages go into `mailbox`, by default one of its own.

        `capacity` bounds the samples that wait there to be drained. Raises BusError.
        """
        self.mailbox = mailbox or Mailbox(capacity)
        self.published: Counter[str] = Counter()
        """Messages handed to Zenoh, by key."""
        self.received: Counter[str] = Counter()
        """Messages that arrived on this bus, by key, overflowed ones included."""
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        os.environ.setdefault("ZENOH_RUNTIME", THREADS)
        share_one_heap()
        settings = settings_of(config)
        self._refusals = refusals_of(settings)
        self._session: zenoh.Session | None = opened(settings, config.name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def advertise(self, topic: Topic, key: str, *, waits: bool = False) -> None:
        """Declare that this process will publish `key`, with the topic's quality of service.

        If it `waits`, publishing takes as long as the slowest subscriber that has not been given up: not
        for a process that controls anything.
        """
        if topic.qos is None:
            raise BusError(f"topic {topic.name!r} is a queryable: it is answered, not published")
        if key in self._publishers:
            raise BusError(f"{key!r} is advertised already")
        with named(key):
            self._publishers[key] = self._live.declare_publisher(
                key,
                congestion_control=_CONGESTION[waits],
                priority=_PRIORITY[topic.qos.priority],
                express=topic.qos.express,
                reliability=_RELIABILITY[waits],
            )

    def publish(self, key: str, payload: bytes, attachment: bytes | None = None) -> None:
        """Publish on an advertised key. Drops, and never waits for long, if the network is too slow."""
        self._publisher(key).put(payload, attachment=attachment)
        self.published[key] += 1

    def send(self, outbox: Iterable[Outgoing]) -> None:
        """Publish all of `outbox`."""
        for out in outbox:
            self.publish(out.key, out.payload, out.attachment)

    def watched(self, key: str) -> bool:
        """Whether an advertised key has a subscriber now."""
        # The stub promises a bool; the object returned is always true.
        return bool(self._publisher(key).matching_status.matching)  # type: ignore[attr-defined]

    def subscribe(
        self,
        key: str,
        name: str = "",
        *,
        wakes: bool = True,
        others_only: bool = False,
        check: Callable[[Sample, float], Sample] | None = None,
    ) -> None:
        """Put the samples of `key` into the mailbox, as samples of `name` if that is given.

        Wildcards are allowed; then each sample has the key that it was published on. With `wakes` false
        they wait there until something else wakes the main thread. ``check(sample, wall)`` marks each on
        the receive thread, so that no step takes longer for it. `others_only`: not what this session
        publishes.
        """
        fixed = name or ("" if "*" in key else key)
        put, received = self.mailbox.put, self.received

        def receive(sample: zenoh.Sample) -> None:  # on Zenoh's thread: must return at once
            arrived = monotonic()
            attachment = sample.attachment
            taken = Sample(
                fixed or str(sample.key_expr),
                sample.payload.to_bytes(),
                None if attachment is None else attachment.to_bytes(),
                arrived,
            )
            put(taken if check is None else check(taken, wall()), received, wakes=wakes)

        with named(key):
            self._live.declare_subscriber(
                key,
                zenoh.handlers.Callback(receive, indirect=False),
                allowed_origin=zenoh.Locality.REMOTE if others_only else zenoh.Locality.ANY,
            )

    def claim(self, tokens: Iterable[str]) -> None:
        """Hold exactly these liveliness tokens. Zenoh also sends them to sessions linked later."""
        wanted = dict.fromkeys(tokens)
        for token in [held for held in self._tokens if held not in wanted]:
            self._tokens.pop(token).undeclare()  # type: ignore[no-untyped-call]
        for token in wanted:
            if token not in self._tokens:
                with named(token):
                    self._tokens[token] = self._live.liveliness().declare_token(token)

    @property
    def advertised(self) -> Collection[str]:
        """Every key that this bus may publish."""
        return self._publishers.keys()

    @property
    def refused(self) -> Counter[str]:
        """Number of refused messages and links so far, by kind; only for a bus with access control."""
        return Counter() if self._refusals is None else self._refusals.counts

    @property
    def overflowed(self) -> int:
        """Messages that newer ones pushed out of the mailbox before they were drained."""
        return self.mailbox.overflowed

    @property
    def zid(self) -> str:
        """Zenoh's id of this session."""
        return str(self._live.info.zid())

    @property
    def linked_routers(self) -> int:
        """Number of routers that this session is linked with now."""
        return 0 if self._session is None else len(self._session.info.routers_zid())

    @property
    def links(self) -> int:
        """Number of peers and routers that this session is linked with now."""
        return self.linked_routers + (0 if self._session is None else len(self._session.info.peers_zid()))

    def drain(self) -> list[Sample]:
        """All waiting samples, in order of arrival."""
        return self.mailbox.drain()

    def wait(self, timeout: float) -> bool:
        """`Mailbox.wait`."""
        return self.mailbox.wait(timeout)

    def answer(self, key: str, handler: Handler) -> None:
        """Answer queries on `key` by `handler`, which `Mailbox.serve` calls on the main thread."""

        def receive(query: zenoh.Query) -> None:  # on Zenoh's thread: must return at once
            self.mailbox.accept(_Query(query, key), handler)

        with named(key):
            self._live.declare_queryable(key, zenoh.handlers.Callback(receive, indirect=False))

    def ask(self, key: str, payload: bytes, timeout: float) -> list[Reply]:
        """Query all queryables of `key` (wildcards are allowed) and wait for all, at most `timeout` [s].

        These are the ones linked and known to this session by now; those that do not answer in time are
        missing. Must not query this very process.
        """
        question = self.question(key, payload, timeout)
        question.wait(timeout)
        return list(question.replies)

    def question(self, key: str, payload: bytes, timeout: float) -> Question:
        """Send a query as `ask` does, but return at once.

        A robot receives two questions in the order in which they were sent.
        """
        question = Question()

        def receive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                question.add_reply(str(reply.ok.key_expr), reply.ok.payload.to_bytes())

        with named(key):
            self._live.get(
                key,
                zenoh.handlers.Callback(receive, question.end, indirect=False),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout,
                payload=payload,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )
        return question

    def tokens(self, expression: str, timeout: float) -> list[str]:
        """The liveliness tokens that match `expression` and arrive within `timeout` [s]."""
        found: list[str] = []
        done = threading.Event()

        def receive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                found.append(str(reply.ok.key_expr))

        with named(expression):
            handler = zenoh.handlers.Callback(receive, done.set, indirect=False)
            self._live.liveliness().get(expression, handler, timeout=timeout)
        done.wait(timeout)
        return list(found)

    def close(self) -> None:
        """Send what was published, close the session in `CLOSE_TIMEOUT_SECONDS`; may be called twice."""
        session, self._session = self._session, None
        if session is None:
            return
        self.mailbox.turn_away()
        # Zenoh waits up to 10 s for a peer that has stopped reading, or that it is dialling; a daemon thread
        # does not delay the exit.
        closing = threading.Thread(target=closed, args=(session,), name="bus-close", daemon=True)
        closing.start()
        closing.join(CLOSE_TIMEOUT_SECONDS)
        if closing.is_alive():
            _LEFT.append(closing)
            _log.warning("the bus did not close within %g s: a peer does not answer", CLOSE_TIMEOUT_SECONDS)

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


class _Query:
    """A Zenoh query in the mailbox."""

    __slots__ = ("_key", "_query")

    def __init__(self, query: zenoh.Query, key: str) -> None:
        self._query, self._key = query, key

    @property
    def request(self) -> bytes:
        payload = self._query.payload
        return b"" if payload is None else payload.to_bytes()

    def answer(self, reply: bytes) -> None:
        with self._query:
            self._query.reply(self._key, reply)

    def drop(self) -> None:
        self._query.drop()  # type: ignore[no-untyped-call]


def share_one_heap() -> bool:
    """Use one heap for all threads from now on; whether the C library can. Call this before threads start.

    glibc gives each thread that allocates a heap of its own, and returns memory of none but the first. Memory
    of Zenoh's threads for links that come and go then fragments their heaps: a process grows with every
    outage, without leaking (docs/decisions/0033).
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has one heap anyway
    return mallopt is not None and mallopt(_M_ARENA_MAX, 1) == 1
