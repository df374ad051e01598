"""Liveliness tokens by which ROS 2 shows its nodes on Zenoh. Pure.

Of rmw_zenoh, written and read: nodes, and what they publish and receive. A token is a key of 9 parts for a
node (NN), and of 13 for a part of a node (MP publishes, MS subscribes, SS serves, SC requests):

    @ros2_lv/<domain>/<zid>/<node id>/<id>/<kind>/<enclave>/<namespace>/<node>
    ... the same .../<topic>/<type>/<type hash>/<QoS>

Slashes inside a part are written as %.

Of zenoh-bridge-ros2dds, only read: its routes, one for each topic that ROS has on its side.

    @/<zid>/@ros2_lv/<kind>/<key>/<type>/<QoS>, without QoS if it is no topic

Slashes inside a part are written as §.
"""

from __future__ import annotations

from typing import NamedTuple

SPACE = "@ros2_lv"
KINDS = ("NN", "MP", "MS", "SS", "SC")
ROUTE_KINDS = ("MP", "MS", "SS", "SC", "AS", "AC")
QOS = "::,10:,:,:,,"
"""Reliable, volatile, the last 10 kept: ROS's default. Omitted parts are defaults."""
SENSOR_QOS = "2::,5:,:,:,,"
"""Best effort, volatile, the last 5 kept: ROS's sensor data."""


class Token(NamedTuple):
    """One node, or one publication, subscription, service or client of a node."""

    domain: int
    zid: str
    node_id: int
    id: int
    kind: str
    """One of KINDS."""
    namespace: str
    """Of the node, without leading slash; empty for the root."""
    node: str
    topic: str = ""
    """ROS name without its leading slash; empty for a node."""
    type: str = ""
    """ROS type, ``package/msg/Name``; empty for a node."""
    type_hash: str = ""
    qos: str = QOS
    enclave: str = "/"

    @property
    def key(self) -> str:
        """The token as rmw_zenoh declares it."""
        head = (
            SPACE, str(self.domain), self.zid, str(self.node_id), str(self.id), self.kind,
            _mangled(self.enclave), _mangled(f"/{self.namespace}"), self.node,
        )  # fmt: skip
        if self.kind == "NN":
            return "/".join(head)
        return "/".join((*head, _mangled(f"/{self.topic}"), dds_type(self.type), self.type_hash, self.qos))


def hidden(node: str) -> str:
    """Return the name of a node that ROS tools do not list by default: one without parameter services.

    `ros2 param list` waits 5 s for each listed node that has none.
    """
    return f"_{node}"


def all_tokens(domain: int) -> str:
    """Key expression of all tokens in a ROS domain."""
    return f"{SPACE}/{domain}/**"


def read(key: str) -> Token | None:
    """Parse the token in `key`; None for any other key."""
    parts = key.split("/")
    if len(parts) < 9 or not all(parts) or parts[0] != SPACE or parts[5] not in KINDS:
        return None
    if len(parts) < 13 and parts[5] != "NN":  # newer versions may say more
        return None
    domain, node_id, number = (
        int(p) if p.isascii() and p.isdigit() else None for p in (parts[1], *parts[3:5])
    )
    if domain is None or node_id is None or number is None:
        return None
    enclave, namespace = _demangled(parts[6]), _demangled(parts[7]).strip("/")
    node = Token(domain, parts[2], node_id, number, parts[5], namespace, parts[8], enclave=enclave)
    if node.kind == "NN":
        return node
    topic, dds, type_hash, qos = parts[9:13]
    return node._replace(
        topic=_demangled(topic).strip("/"), type=ros_type(_demangled(dds)), type_hash=type_hash, qos=qos
    )


class Route(NamedTuple):
    """One topic, service or action that a bridge carries because ROS has it on the bridge's side."""

    zid: str
    kind: str
    """MP: ROS has a publisher. MS: ROS has a subscriber. SS, SC, AS, AC: services and actions."""
    key: str
    """Key on Zenoh."""
    type: str
    """ROS type, ``package/msg/Name``."""


ROUTES = f"@/*/{SPACE}/**"
"""Key expression of all routes of all bridges."""


def read_route(key: str) -> Route | None:
    """Parse the bridge's route in `key`; None for any other key."""
    parts = key.split("/")
    if (
        len(parts) < 6
        or not all(parts)
        or parts[0] != "@"
        or parts[2] != SPACE
        or parts[3] not in ROUTE_KINDS
    ):
        return None
    return Route(parts[1], parts[3], parts[4].replace("§", "/"), parts[5].replace("§", "/"))


def dds_type(ros: str) -> str:
    """DDS name of a ROS type: ``std_msgs/msg/Float64`` is ``std_msgs::msg::dds_::Float64_``."""
    parts = ros.split("/")
    return f"{parts[0]}::{parts[1]}::dds_::{parts[2]}_" if len(parts) == 3 else ros


def ros_type(dds: str) -> str:
    """ROS name of a DDS type; types not made by ROS are left unchanged."""
    parts = dds.split("::")
    if len(parts) == 4 and parts[2] == "dds_" and parts[3].endswith("_"):
        return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"
    return dds


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def _demangled(name: str) -> str:
    return name.replace("%", "/")
