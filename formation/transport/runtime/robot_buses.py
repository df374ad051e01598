"""Several robots' buses as one: a session with each router, because a client has a link with one only."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Literal

from formation.mission.model import Mission
from formation.ros2.naming import Naming
from formation.ros2.ros_names import address
from formation.topics import Topic
from formation.transport.bus_config import BusError
from formation.transport.interfaces import Handler
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBus
from formation.transport.wiring import by_endpoint


class RobotBuses:
    """Robots behind one endpoint share a session. Keys are logical, so each identifies its session."""

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

        Missing routers are logged only if they are `awaited`.

        Raises BusError for an endpoint that is invalid or taken, and for robots behind one endpoint that
        ROS 2 could not distinguish.
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
