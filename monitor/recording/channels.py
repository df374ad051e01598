"""A recording's metadata, and the schemas and channels of its messages: the same in every part.

MCAP has no place for attachments, so they have a topic of their own: `<key>/attached` is a std_msgs/String
with the attachment's text. It stands just before its message, with the same times and sequence number.
"""

from __future__ import annotations

import struct
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from uuid import uuid4

from mcap.records import Channel, Schema

from formation.ros2.definitions import definition, type_hash
from formation.ros2.messages import MAX_PAYLOAD_BYTES, Text, decode
from formation.wire import BadMessage

ABOUT = "formation"
"""Name of the metadata record about the recording."""
DISTRIBUTIONS = {"formation": "zenoh-formation"} | {
    name: name for name in ("eclipse-zenoh", "mcap", "numpy", "pydantic")
}
"""Distributions with versions stated in a recording, by their names in it."""
VERSIONS = ("python", *DISTRIBUTIONS)
"""Names of all versions in a recording."""
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
SUFFIX = "/attached"
TYPE = Text.ROS_TYPE
_HEAD = struct.Struct("<4sI")
_CDR = b"\0\1\0\0"


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

    def adopt(self, kind: Channel | Schema) -> None:
        """Take over a channel or schema of another file; the first wins if two have one number."""
        if (type(kind), kind.id) not in self._adopted:
            self._adopted.add((type(kind), kind.id))
            if isinstance(kind, Channel):
                self.channels.append(kind)
            else:
                self.schemas.append(kind)

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


def packed_attachment(attachment: bytes) -> bytes | None:
    """Return the message to record for an attachment; None if it is no printable text, as ours are.

    Equal to `encode(Text(...))` in a tenth of its time: two of three messages need it.
    """
    try:
        printable = attachment.decode().isprintable()
    except UnicodeDecodeError:
        return None
    if not printable or _HEAD.size + len(attachment) >= MAX_PAYLOAD_BYTES:
        return None
    return _HEAD.pack(_CDR, len(attachment) + 1) + attachment + b"\0"


def unpacked_attachment(data: bytes) -> bytes:
    """Return the attachment in a recorded message, the inverse of `packed_attachment`; empty without one."""
    if len(data) > _HEAD.size and data[-1] == 0 and _HEAD.unpack_from(data) == (_CDR, len(data) - _HEAD.size):
        return data[_HEAD.size : -1]
    try:
        return decode(Text, data).text.encode()  # rewritten by another tool
    except BadMessage:
        return b""
