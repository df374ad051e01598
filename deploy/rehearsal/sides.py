"""The fleet's bus and the robots' sides in memory, with the interfaces of the real ones.

Both are `Exchange`s: a message goes to every process that subscribes to its key, each time after as long as
`ways` says. Keys are exact; the rehearsed processes use no wildcards.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable
from typing import TYPE_CHECKING, NamedTuple

from formation.topics import Topic
from formation.transport.bus_config import BusError
from formation.transport.mailbox import Handler
from formation.wire import Outgoing, Sample

if TYPE_CHECKING:
    from formation.deploy.rehearsal.engine import Engine, VirtualProcess

Ways = Callable[[str, str, int], Iterable[float]]
"""``ways(sender, receiver, size)``: the delay of each copy that arrives [s], by names of machines."""
Check = Callable[[Sample, float], Sample]
Permits = Callable[[str | None, str | None, str], bool]
"""``permits(sender, receiver, key)``: whether one may send the other that key, by their certificates."""
HEADER_BYTES = 80
"""Of each message, beside key, payload and attachment."""


class _Subscription(NamedTuple):
    port: FleetPort | RobotPort
    wakes: bool
    check: Check | None
    from_others: bool


class Exchange:
    """All links of one bus."""

    def __init__(self, engine: Engine, ways: Ways, permits: Permits = lambda *_: True) -> None:
        self.engine, self._ways, self._permits = engine, ways, permits
        self.subscriptions: defaultdict[str, list[_Subscription]] = defaultdict(list)
        self.answers: defaultdict[str, list[tuple[VirtualProcess, Handler]]] = defaultdict(list)
        self.watchers: list[Callable[[VirtualProcess, Outgoing], None]] = []
        """Called with each message when it is published."""
        self.receivers: list[Callable[[VirtualProcess, Outgoing, float], None]] = []
        """Called with each message when it arrives, and when it was published [s]."""
        self.repliers: list[Callable[[VirtualProcess, bytes, bytes], None]] = []
        """Called with each request and its answer, when a process gives it."""
        self.repeats: dict[str, float] = {}
        """Time after which messages of a key arrive again [s]; 0 for those that do not."""
        self.changes: dict[str, Callable[[bytes], bytes]] = {}
        """What changes the payloads of a key."""
        self.refused: dict[tuple[str, str, str], None] = {}
        """Refused messages in order: the names of sender and receiver, and the key."""

    def publish(self, port: FleetPort | RobotPort, out: Outgoing) -> None:
        """Send `out` to all subscribers."""
        if change := self.changes.get(out.key):
            out = out._replace(payload=change(out.payload))
        again = self.repeats.get(out.key, 0.0)
        for watcher in self.watchers:
            watcher(port.process, out)
        size = HEADER_BYTES + len(out.key) + len(out.payload) + len(out.attachment or b"")
        sender = port.process.machine.name
        for one in self.subscriptions.get(out.key, ()):
            if one.from_others and one.port is port:
                continue
            if not self._permits(port.process.certified, one.port.process.certified, out.key):
                self.refused[port.process.name, one.port.process.name, out.key] = None
                continue
            receiver = one.port.process.machine.name
            ways = (0.0,) if one.port is port else self._ways(sender, receiver, size)
            for delay in ways:
                self._deliver(one, out, delay)
                if again > 0.0:
                    self._deliver(one, out, delay + again)

    def ask(self, asker: str, key: str, request: bytes, take_reply: Callable[[bytes], None]) -> None:
        """Send a query from machine `asker` to all that answer `key`; `take_reply` receives each answer."""
        for process, handler in self.answers.get(key, ()):
            self._ask(asker, process, handler, request, take_reply)

    def _ask(
        self,
        asker: str,
        process: VirtualProcess,
        handler: Handler,
        request: bytes,
        take_reply: Callable[[bytes], None],
    ) -> None:
        def answered(reply: bytes) -> None:
            for replier in self.repliers:
                replier(process, request, reply)
            for delay in self._ways(process.machine.name, asker, len(reply)):
                self.engine.at(self.engine.now + delay, lambda: take_reply(reply))

        def accept() -> None:
            process.mailbox.accept(_Query(request, answered), handler)

        for delay in self._ways(asker, process.machine.name, len(request)):
            self.engine.at(self.engine.now + delay, lambda: process.arrive(accept, wakes=True))

    def _deliver(self, one: _Subscription, out: Outgoing, delay: float) -> None:
        process, sent = one.port.process, self.engine.now

        def put() -> None:
            now = process.clock()
            sample = Sample(out.key, out.payload, out.attachment, now.mono)
            sample = sample if one.check is None else one.check(sample, now.wall)
            process.mailbox.put(sample, one.port.received, wakes=one.wakes)
            for receiver in self.receivers:
                receiver(process, out, sent)

        self.engine.at(self.engine.now + delay, lambda: process.arrive(put, wakes=one.wakes))


class _Query(NamedTuple):
    request: bytes
    reply: Callable[[bytes], None]

    def answer(self, reply: bytes) -> None:
        self.reply(reply)

    def drop(self) -> None:
        """Refuse it."""


class _Port:
    """One process on an exchange."""

    def __init__(self, exchange: Exchange, process: VirtualProcess) -> None:
        self.process = process
        self.published: Counter[str] = Counter()
        self.received: Counter[str] = Counter()
        self._exchange, self._keys = exchange, dict[str, Topic]()
        self._is_plugged = True

    @property
    def advertised(self) -> Collection[str]:
        """Every key that this side may publish."""
        return self._keys.keys()

    def advertise(self, topic: Topic, key: str) -> None:
        """Declare that this process will publish `key`. Raises BusError."""
        if topic.qos is None:
            raise BusError(f"topic {topic.name!r} is a queryable: it is answered, not published")
        if key in self._keys:
            raise BusError(f"{key!r} is advertised already")
        self._keys[key] = topic

    def answer(self, key: str, handler: Handler) -> None:
        """Answer queries on `key`."""
        self._exchange.answers[key].append((self.process, handler))

    def unplug(self) -> None:
        """Leave the exchange: nothing is sent or received any more."""
        self._is_plugged = False
        for subscriptions in self._exchange.subscriptions.values():
            subscriptions[:] = [one for one in subscriptions if one.port is not self]
        for answers in self._exchange.answers.values():
            answers[:] = [one for one in answers if one[0] is not self.process]

    close = unplug

    def _send(self, out: Outgoing) -> None:
        if out.key not in self._keys:
            raise BusError(f"{out.key!r} is not advertised: {', '.join(self._keys) or 'none'}")
        if self._is_plugged:
            self.published[out.key] += 1
            self._exchange.publish(self, out)  # type: ignore[arg-type]


class FleetPort(_Port):
    """A process on the fleet's bus."""

    def __init__(self, exchange: Exchange, process: VirtualProcess) -> None:
        super().__init__(exchange, process)
        self.tamper: Callable[[Outgoing], Outgoing] | None = None
        """What an insider makes of each message of this process."""

    @property
    def refused(self) -> Counter[str]:
        """Nothing: the judge reports refused messages."""
        return Counter()

    @property
    def overflowed(self) -> int:
        """Messages that newer ones pushed out of the mailbox before they were drained."""
        return self.process.mailbox.overflowed

    def publish(self, key: str, payload: bytes, attachment: bytes | None = None) -> None:
        """Publish on an advertised key. Raises BusError for any other."""
        self.send([Outgoing(key, payload, attachment)])

    def send(self, outbox: Iterable[Outgoing]) -> None:
        """Publish all of `outbox`."""
        for out in outbox:
            self._send(out if self.tamper is None else self.tamper(out))

    def subscribe(self, key: str, *, wakes: bool = True, check: Check | None = None) -> None:
        """Put the samples of `key` into the mailbox."""
        self._exchange.subscriptions[key].append(_Subscription(self, wakes, check, from_others=False))

    def drain(self) -> list[Sample]:
        """All waiting samples, in order of arrival."""
        return self.process.mailbox.drain()


class RobotPort(_Port):
    """A process on the side of its robot, or of several; `routers` are the processes of the robots."""

    def __init__(self, exchange: Exchange, process: VirtualProcess, routers: list[VirtualProcess]) -> None:
        super().__init__(exchange, process)
        self._routers = routers

    @property
    def connected(self) -> bool:
        """Whether every router is there."""
        return all(router.alive for router in self._routers)

    def subscribe(self, topic: Topic, key: str, *, from_others: bool = False) -> None:  # noqa: ARG002
        """Put the samples of `key` into the mailbox; `from_others`: only those, and they do not wake."""
        subscription = _Subscription(self, not from_others, None, from_others)
        self._exchange.subscriptions[key].append(subscription)

    def publish(self, key: str, payload: bytes) -> None:
        """Publish on an advertised key; without its router the message is lost."""
        if self.connected:
            self._send(Outgoing(key, payload))

    def routed(self, key: str) -> bool | None:
        """Whether `key` has a subscriber; None while not connected."""
        return bool(self._exchange.subscriptions.get(key)) if self.connected else None
