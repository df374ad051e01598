"""Names of logical keys on Zenoh in ROS 2, by either of its two routes to Zenoh.

    ros2dds     zenoh-bridge-ros2dds: the ROS name without its leading slash, `robot1/odom`
    rmw_zenoh   `<domain>/<ROS name>/<DDS type>/<type hash>`, with an attachment on each sample, and
                liveliness tokens from which `ros2 topic list` and `ros2 node info` know the nodes

The cores use logical keys only; the robot bus translates with this module. Pure.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import count
from typing import Self

from formation.ros2.definitions import type_hash
from formation.ros2.ros_names import Ros, RosNames, RosRobot, address
from formation.ros2.tokens import QOS, SENSOR_QOS, Token, dds_type, hidden

_ATTACHMENT = struct.Struct("<qqB16s")


@dataclass(frozen=True, slots=True)
class Naming:
    """ROS 2 names of the topics of some robots, and of the formation as a whole."""

    robots: Mapping[str, RosNames]
    formation: RosNames
    """Of the topics that belong to no robot."""

    def __post_init__(self) -> None:
        logical: dict[str, str] = {}
        for place in (*self.robots.values(), self.formation):
            for key in place.logical_keys():
                if (other := logical.setdefault(self.wire(key), key)) != key:
                    raise ValueError(
                        f"{other} and {key} cannot share a session: ROS calls both "
                        f"/{place.spelled(key)}; one of the robots needs another namespace"
                    )

    @classmethod
    def of(cls, known: Mapping[str, RosRobot], robots: Iterable[str]) -> Self:
        """Return the names of these of the `known` robots.

        KeyError for an unknown one, ValueError if two would share a name.

        Topics of the formation as a whole are named as the first robot's are.
        """
        places = {name: RosNames.of(name, known[name]) for name in robots}
        first = next(iter(places.values()), RosNames())
        return cls(places, RosNames(ros=first.ros, domain=first.domain))

    @classmethod
    def of_formation(cls, ros: Ros = "ros2dds", domain: int = 0) -> Self:
        """Names of the topics that belong to no robot, for the monitor."""
        return cls({}, RosNames(ros=ros, domain=domain))

    def wire(self, logical: str, ros_type: str | None = None) -> str:
        """The wire key of a logical one, with the type of its topic unless given another.

        KeyError for a robot that is not named here, ValueError for a key that is not in the topic table.
        """
        one = address(logical)
        place = self._place(one.robot)
        name = place.spelled(logical)
        if ros_type is None:
            ros_type = place.type(one.topic)
        if place.ros == "ros2dds" or not ros_type:
            return name
        return f"{place.domain}/{name}/{dds_type(ros_type)}/{type_hash(ros_type)}"

    def attachment(self, logical: str, sequence: int, wall: float, zid: str = "") -> bytes | None:
        """Attachment of sample number `sequence` (from 1, per key) of time `wall` [s since the epoch].

        None if ROS needs none. `zid` is the session's: it distinguishes two that publish on one key.
        """
        if self._place(address(logical).robot).ros == "ros2dds":
            return None
        gid = _gid(zid, self.wire(logical))
        seconds, rest = divmod(wall, 1.0)
        return _ATTACHMENT.pack(sequence, int(seconds) * 1_000_000_000 + int(rest * 1e9), 16, gid)

    def tokens(
        self, node: str, publications: Iterable[str], subscriptions: Iterable[str], zid: str
    ) -> tuple[str, ...]:
        """Liveliness tokens of a session `zid` that is the ROS node `node` of each of its robots.

        `publications` and `subscriptions` are logical keys. Only rmw_zenoh has tokens. Request all of a
        session at once: their ids are unique within the answer.
        """
        kept: dict[str, list[tuple[str, str]]] = {}
        for kind, keys in (("MP", publications), ("MS", subscriptions)):
            for key in keys:
                kept.setdefault(address(key).robot, []).append((kind, key))
        return tuple(
            token.key
            for token in _tokens(node, zid, ((self._place(robot), keys) for robot, keys in kept.items()))
        )

    def _place(self, robot: str) -> RosNames:
        return self.robots[robot] if robot else self.formation


@cache
def _gid(zid: str, wire: str) -> bytes:
    """Id of a publisher in rmw_zenoh."""
    return hashlib.blake2b(f"{zid}/{wire}".encode(), digest_size=16).digest()


def _tokens(node: str, zid: str, kept: Iterable[tuple[RosNames, list[tuple[str, str]]]]) -> Iterator[Token]:
    ids = count()
    for place, keys in kept:
        if place.ros == "ros2dds":
            continue
        node_id = next(ids)
        this = Token(place.domain, zid, node_id, node_id, "NN", place.namespace, hidden(node))
        yield this
        for kind, key in keys:
            topic = address(key).topic
            ros_type = place.type(topic)
            yield this._replace(
                id=next(ids),
                kind=kind,
                topic=place.spelled(key),
                type=ros_type,
                type_hash=type_hash(ros_type),
                qos=SENSOR_QOS if topic.sensor_data else QOS,
            )
