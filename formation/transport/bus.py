"""The bus: one Zenoh session of a process. Nobody but this and `formation.transport.session` imports zenoh.

Zenoh's receive thread stamps what arrives and puts it into a mailbox; everything else happens on the main
thread. A process with several buses has one mailbox for them all.
"""

from __future__ import annotations

import logging
import os
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from types import TracebackType
from typing import Self

import zenoh

from formation.topics import Topic
from formation.transport.bus_config import THREADS, BusConfig, BusError
from formation.transport.clock import monotonic, wall
from formation.transport.heap import share_one_heap
from formation.transport.mailbox import Handler, Mailbox
from formation.transport.question import Question, Reply
from formation.transport.session import closed, named, opened, refusals_of, setting, settings_of
from formation.wire import Outgoing, Sample

__all__ = ["Bus", "BusConfig", "BusError", "setting"]

_PRIORITY = {
    "real_time": zenoh.Priority.REAL_TIME,
    "data": zenoh.Priority.DATA,
    "background": zenoh.Priority.BACKGROUND,
}
_CONGESTION = {False: zenoh.CongestionControl.DROP, True: zenoh.CongestionControl.BLOCK}
# What may be dropped goes by a link that drops, where there is one (an endpoint with ``?rel=0``): over TCP
# what is lost comes later, and holds up for seconds what comes after it.
_RELIABILITY = {False: zenoh.Reliability.BEST_EFFORT, True: zenoh.Reliability.RELIABLE}
CLOSE_LIMIT = 1.5
"""How long `Bus.close` may take [s]: a little longer than the lease of a peer that hangs."""
_LEFT: list[threading.Thread] = []
_log = logging.getLogger(__name__)


def still_closing() -> bool:
    """Whether a session is being closed in the background: an interpreter that ends just then may abort."""
    return any(thread.is_alive() for thread in _LEFT)


class Bus:
    """A session on the bus. Use it as a context manager: an open session keeps the process from exiting.

    Methods are for one thread, the main one; only `wake` may be called from a signal handler or another
    thread, and `ask` and `question` from any thread.
    """

    def __init__(self, config: BusConfig, mailbox: Mailbox | None = None, *, capacity: int = 1024) -> None:
        """Open the session. What arrives goes into `mailbox`, by default one of its own.

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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def advertise(self, topic: Topic, key: str, *, waits: bool = False) -> None:
        """Declare that this process will publish `key`, with the topic's quality of service.

        If it `waits`, publishing takes as long as the slowest listener that has not been given up: that is
        for no process that steers anything.
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

    def subscribe(
        self,
        key: str,
        name: str = "",
        *,
        wakes: bool = True,
        others_only: bool = False,
        check: Callable[[Sample, float], Sample] | None = None,
    ) -> None:
        """Have the samples of `key` put into the mailbox, as samples of `name` if that is given.

        Wildcards are allowed; then each sample has the key that it was published on. With `wakes` false they
        wait there until something else wakes whoever waits. ``check(sample, wall)`` marks each as it arrives,
        on the receive thread, so that no step takes longer for it.
        `others_only`: not what this session publishes.
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
        """Hold exactly these liveliness tokens. Zenoh tells them again to whoever is linked later."""
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
        """What was refused to others so far, by kind; known only of a bus with access control."""
        return Counter() if self._refusals is None else self._refusals.counts

    @property
    def overflowed(self) -> int:
        """Messages that were pushed out of the mailbox by newer ones before anybody drained them."""
        return self.mailbox.overflowed

    @property
    def zid(self) -> str:
        """What Zenoh calls this session."""
        return str(self._live.info.zid())

    @property
    def linked_routers(self) -> int:
        """How many routers this session is linked with right now."""
        return 0 if self._session is None else len(self._session.info.routers_zid())

    @property
    def links(self) -> int:
        """How many peers and routers this session is linked with right now."""
        return self.linked_routers + (0 if self._session is None else len(self._session.info.peers_zid()))

    def drain(self) -> list[Sample]:
        """All samples that wait, in order of arrival."""
        return self.mailbox.drain()

    def wait(self, timeout: float) -> bool:
        """`Mailbox.wait`."""
        return self.mailbox.wait(timeout)

    def wake(self) -> None:
        """Have the current or next `wait` return at once. Safe in a signal handler."""
        self.mailbox.wake()

    def answer(self, key: str, handler: Handler) -> None:
        """Answer queries on `key` by `handler`, which `serve` calls on the main thread."""

        def receive(query: zenoh.Query) -> None:  # on Zenoh's thread: must return at once
            self.mailbox.accept(_Query(query, key), handler)

        with named(key):
            self._live.declare_queryable(key, zenoh.handlers.Callback(receive, indirect=False))

    def serve(self) -> int:
        """Answer the queries that wait; how many."""
        return self.mailbox.serve()

    def ask(self, key: str, payload: bytes, timeout: float) -> list[Reply]:
        """Query everybody who answers `key` (wildcards are allowed) and wait for all, at most `timeout` [s].

        That is everybody linked whom this session has heard of by now, and who does not answer in time is
        simply missing. Must not ask what this very process answers.
        """
        question = self.question(key, payload, timeout)
        question.wait(timeout)
        return list(question.replies)

    def question(self, key: str, payload: bytes, timeout: float) -> Question:
        """Put it as `ask` does, but wait for nobody.

        Of two questions to the same robot it hears that first which was put first.
        """
        question = Question()

        def receive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                question.take(str(reply.ok.key_expr), reply.ok.payload.to_bytes())

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
        """The liveliness tokens that match `expression` and that come in, at most `timeout` [s]."""
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
        """Send what was published and close the session, within `CLOSE_LIMIT`; twice does no harm."""
        session, self._session = self._session, None
        if session is None:
            return
        self.mailbox.turn_away()
        # Zenoh waits up to 10 s for a peer that has stopped reading, or that it is dialling; a daemon thread
        # does not keep us.
        closing = threading.Thread(target=closed, args=(session,), name="bus-close", daemon=True)
        closing.start()
        closing.join(CLOSE_LIMIT)
        if closing.is_alive():
            _LEFT.append(closing)
            _log.warning("the bus did not close within %g s: a peer does not answer", CLOSE_LIMIT)

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
    """A query of Zenoh's, as the mailbox keeps it."""

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
