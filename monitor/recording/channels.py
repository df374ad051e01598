"""A recording's metadata, and the schemas and channels of its messages: the same in every part."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from importlib.metadata import version
from uuid import uuid4

from mcap.records import Channel, Schema

from formation.ros2.messages import definition, type_hash

ABOUT = "formation"
"""Name of the metadata record about the recording."""
DISTRIBUTIONS = {"formation": "zenoh-formation"} | {
    name: name for name in ("eclipse-zenoh", "mcap", "numpy", "pydantic")
}
"""Distributions with versions stated in a recording, by their names in it."""
QOS = """\
- history: 1
  depth: 10
  reliability: 1
  durability: 2
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""
"""QoS for `ros2 bag play`: keep last 10, reliable, volatile. As numbers, which every ROS 2 reads. A
best-effort publisher would not be received by subscribers with the default, reliable, profile."""


def about(mission: str, text: str, law: str) -> dict[str, str]:
    """Return the metadata of every part; `text` is the mission's file, `law` the one in use."""
    return {
        "recording": uuid4().hex,
        "mission": mission,
        "mission_file": text,
        "law": law,
        "recorded_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": sys.version.split()[0],
        **{name: version(distribution) for name, distribution in DISTRIBUTIONS.items()},
    }


class Channels:
    """Every channel so far, and its schema. It only grows, so another thread may read it too."""

    def __init__(self) -> None:
        self.channels: list[Channel] = []
        self.schemas: list[Schema] = []
        self._numbers: dict[str, int] = {}
        self._adopted: set[tuple[type, int]] = set()

    def adopt(self, channel: Channel) -> None:
        """Take over a channel of another file, with its number; the first wins if two have one number."""
        if self._is_new(channel):
            self.channels.append(channel)

    def adopt_schema(self, schema: Schema) -> None:
        """Take over a schema of another file in the same way."""
        if self._is_new(schema):
            self.schemas.append(schema)

    def _is_new(self, kind: Channel | Schema) -> bool:
        name = type(kind), kind.id
        if name in self._adopted:
            return False
        self._adopted.add(name)
        return True

    def register(self, key: str, ros_type: str) -> int:
        """Add a channel for messages of `ros_type` on `key`; return its number."""
        schema = self._numbers.get(ros_type)
        if schema is None:
            schema = self._numbers[ros_type] = len(self.schemas) + 1
            text = definition(ros_type).encode()
            self.schemas.append(Schema(id=schema, name=ros_type, encoding="ros2msg", data=text))
        metadata = {"offered_qos_profiles": QOS, "topic_type_hash": type_hash(ros_type)}
        number = len(self.channels) + 1
        channel = Channel(
            id=number, topic=f"/{key}", message_encoding="cdr", schema_id=schema, metadata=metadata
        )
        self.channels.append(channel)
        return number
