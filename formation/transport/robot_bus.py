"""The robot's side: a session with the robot's own ROS 2 router, in logical keys.

The router is zenoh-bridge-ros2dds, rmw_zenohd, or a simulated robot that replaces both. It may start later
than this process, and come and go, without blocking it. `formation.ros2.naming` has the ROS 2 name of each
key and the attachments; both are invisible outside.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, Self

from formation.mission.model import Mission
from formation.ros2.naming import Naming
from formation.ros2.ros_names import address
from formation.topics import Topic
from formation.transport.bus import Bus, BusConfig, BusError
from formation.transport.mailbox import Handler, Mailbox
from formation.transport.wiring import by_endpoint
from formation.wire import BadMessage

REDIAL_PERIOD = 0.5
"""Time after which dialling is repeated [s]."""
MAX_CLOSE_DELAY = 1.0
"""Longest time that a running attempt delays `close` [s]."""
_CDR = (b"\x00\x01", b"\x00\x00")
"""First bytes of a payload: plain CDR, little or big endian."""
_log = logging.getLogger(__name__)


class RobotBus:
    """A session on the robot's side. Methods are for the main thread, and none of them waits.

    As a ``client`` it dials until a router answers and again whenever the link is lost; as a ``router`` it
    is the one that others dial: the simulated robot.
    """

    def __init__(
        self,
        endpoints: Iterable[str],
        naming: Naming,
        mailbox: Mailbox,
        *,
        mode: Literal["client", "router"] = "client",
        node: str = "formation_agent",
        awaited: bool = True,
    ) -> None:
        """`endpoints` to dial (a client has one link, with the first that answers), or to listen on.

        `node` is the name of its ROS 2 node; a missing router is logged only if it is `awaited`. Raises
        BusError for an invalid endpoint, and for a router with an endpoint that is taken.
        """
        self.published: Counter[str] = Counter()
        """Messages handed to Zenoh, by logical key."""
        self.received: Counter[str] = Counter()
        """Messages that arrived, by logical key."""
        ends = tuple(dict.fromkeys(endpoints))
        self._router = mode == "router"
        listen, connect = (ends, ()) if self._router else ((), ends)
        self._config = BusConfig(
            listen=listen, connect=connect, mode=mode, name=node, connect_flag="--robot-connect"
        )
        self._naming, self._mailbox, self._node = naming, mailbox, node
        self._advertised: dict[str, _Line] = {}
        self._subscribed: dict[str, tuple[str, bool]] = {}  # wire key, and whether from others only
        self._answered: dict[str, Handler] = {}
        self._zid = ""
        self._level = logging.INFO if awaited else logging.DEBUG
        self._bus: Bus | None = None
        self._changing = threading.Lock()
        self._closing = threading.Event()
        self._opener = threading.Thread(target=self._open_at_last, name="robot-bus", daemon=True)
        if self._router:
            self._open()
        else:
            self._opener.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def connected(self) -> bool:
        """Whether the router is linked; true for a router itself."""
        bus = self._bus
        return bus is not None and (self._router or bus.linked_routers > 0)

    def advertise(self, topic: Topic, key: str) -> None:
        """Declare that this process will publish logical `key`, with the topic's quality of service.

        Raises BusError if it is advertised already or a queryable, KeyError and ValueError as
        `Naming.wire`.
        """
        if key in self._advertised:
            raise BusError(f"{key!r} is advertised already")
        if topic.qos is None:
            raise BusError(f"topic {topic.name!r} is a queryable: it is answered, not published")
        attached = self._naming.attachment(key, 1, 0.0) is not None
        line = _Line(topic, self._naming.wire(key, _type(topic)), attached)
        with self._changing:
            self._advertised[key] = line
            if self._bus is not None:
                self._bus.advertise(topic, line.wire)
                self._claim(self._bus)

    def subscribe(self, topic: Topic, key: str, *, from_others: bool = False) -> None:
        """Put the samples of logical `key` into the mailbox, under that name.

        `from_others`: those of other processes only, and they do not wake this one. Raises BusError if it is
        subscribed to already, KeyError and ValueError as `Naming.wire`.
        """
        if key in self._subscribed:
            raise BusError(f"{key!r} is subscribed to already")
        wire = self._naming.wire(key, _type(topic))
        with self._changing:
            self._subscribed[key] = wire, from_others
            if self._bus is not None:
                self._bus.subscribe(wire, key, wakes=not from_others, others_only=from_others)
                self._claim(self._bus)

    def answer(self, key: str, handler: Handler) -> None:
        """Answer queries on logical `key` as `Bus.answer` does. Errors as `Naming.wire`."""
        wire = self._naming.wire(key)
        with self._changing:
            self._answered[wire] = handler
            if self._bus is not None:
                self._bus.answer(wire, handler)

    def publish(self, key: str, payload: bytes) -> None:
        """Publish on an advertised key; before the session is open this does nothing.

        Raises BadMessage for a payload that would block a bridge's route for good: one that is empty or
        has no CDR header.
        """
        line = self._line(key)
        if len(payload) <= 4 or payload[:2] not in _CDR:
            raise BadMessage(
                f"{len(payload)} bytes without a CDR header on {key}: a bridge would choke on it"
            )
        bus = self._bus
        if bus is None:
            return
        attachment = None
        if line.attached:
            line.sequence += 1
            attachment = self._naming.attachment(key, line.sequence, time.time(), self._zid)
        bus.publish(line.wire, payload, attachment)
        self.published[key] += 1

    def routed(self, key: str) -> bool | None:
        """Whether logical `key` has a subscriber; None while not connected."""
        line, bus = self._line(key), self._bus
        return bus.watched(line.wire) if bus is not None and self.connected else None

    def close(self) -> None:
        """Send what was published and close the session; a second call has no effect."""
        self._closing.set()
        if self._opener.is_alive():
            self._opener.join(MAX_CLOSE_DELAY)
        with self._changing:
            bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()

    def _line(self, key: str) -> _Line:
        line = self._advertised.get(key)
        if line is None:
            raise BusError(f"{key!r} is not advertised: {', '.join(self._advertised) or 'none'}")
        return line

    def _open_at_last(self) -> None:
        """Open the session as soon as a router answers, on a separate thread."""
        where = " or ".join(self._config.connect)
        failures = 0
        while not self._closing.is_set():
            try:
                self._open()
            except BusError as error:
                if failures == 0:
                    _log.log(self._level, "waiting for a router: %s", error)
                failures += 1
                self._closing.wait(REDIAL_PERIOD)
            except Exception:  # noqa: BLE001 - a thread that ended here would leave the robot without a link
                _log.exception("the session with the router at %s could not be set up", where)
                self._closing.wait(REDIAL_PERIOD)
            else:
                _log.log(self._level, "connected with the router at %s", where)
                return

    def _open(self) -> None:
        bus = Bus(self._config, self._mailbox)
        try:
            with self._changing:
                if not self._closing.is_set():
                    self._declare(bus)
                    self._bus = bus
        finally:
            if self._bus is not bus:
                bus.close()

    def _declare(self, bus: Bus) -> None:
        self._zid, self.received = bus.zid, bus.received
        for line in self._advertised.values():
            bus.advertise(line.topic, line.wire)
        for key, (wire, from_others) in self._subscribed.items():
            bus.subscribe(wire, key, wakes=not from_others, others_only=from_others)
        for wire, handler in self._answered.items():
            bus.answer(wire, handler)
        self._claim(bus)

    def _claim(self, bus: Bus) -> None:
        bus.claim(self._naming.tokens(self._node, self._advertised, self._subscribed, self._zid))


class RobotBuses:
    """Several robots' buses as one: a session with each router, because a client has a link with one only.

    Robots behind one endpoint share a session. Keys are logical, so each identifies its session.
    """

    def __init__(
        self,
        mission: Mission,
        where: Mapping[str, str],
        mailbox: Mailbox,
        *,
        mode: Literal["client", "router"] = "client",
        node: str,
        awaited: bool = True,
    ) -> None:
        """`where` are the robots' endpoints, by name. As a ``router``, one is opened on each of them.

        Missing routers are logged only if they are `awaited`. Raises BusError for an endpoint that is invalid
        or taken, and for robots behind one endpoint that ROS 2 could not distinguish.
        """
        self._by_robot: dict[str, RobotBus] = {}
        try:
            for endpoint, robots in by_endpoint(where).items():
                naming = Naming.of(mission.robots, robots)
                bus = RobotBus((endpoint,), naming, mailbox, mode=mode, node=node, awaited=awaited)
                self._by_robot.update(dict.fromkeys(robots, bus))
        except ValueError as clash:
            self.close()
            raise BusError(f"{endpoint}: {clash}") from None
        except BusError:
            self.close()
            raise

    @property
    def published(self) -> Counter[str]:
        """Messages handed to Zenoh, by logical key."""
        return sum((bus.published for bus in self._each), Counter[str]())

    @property
    def received(self) -> Counter[str]:
        """Messages that arrived, by logical key."""
        return sum((bus.received for bus in self._each), Counter[str]())

    @property
    def connected(self) -> bool:
        """Whether every router is linked."""
        return all(bus.connected for bus in self._each)

    def advertise(self, topic: Topic, key: str) -> None:
        """As `RobotBus.advertise`."""
        self._of(key).advertise(topic, key)

    def subscribe(self, topic: Topic, key: str, *, from_others: bool = False) -> None:
        """As `RobotBus.subscribe`."""
        self._of(key).subscribe(topic, key, from_others=from_others)

    def answer(self, key: str, handler: Handler) -> None:
        """As `RobotBus.answer`."""
        self._of(key).answer(key, handler)

    def publish(self, key: str, payload: bytes) -> None:
        """As `RobotBus.publish`."""
        self._of(key).publish(key, payload)

    def routed(self, key: str) -> bool | None:
        """As `RobotBus.routed`."""
        return self._of(key).routed(key)

    def close(self) -> None:
        """Close them all; a second call has no effect."""
        for bus in self._each:
            bus.close()

    @property
    def _each(self) -> tuple[RobotBus, ...]:
        return tuple(dict.fromkeys(self._by_robot.values()))

    def _of(self, key: str) -> RobotBus:
        return self._by_robot[address(key).robot]


@dataclass(slots=True)
class _Line:
    """A publication: its destination and its progress."""

    topic: Topic
    wire: str
    attached: bool
    """Whether ROS needs an attachment on each sample."""
    sequence: int = 0


def _type(topic: Topic) -> str | None:
    """The type to write into keys; None for the one in the robot's mission entry."""
    return None if topic.alternative else topic.type
