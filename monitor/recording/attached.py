"""Where a recording keeps what rode on a message, for which MCAP has no place: on a topic beside it.

`<key>/attached` is a std_msgs/String with the attachment's text. It stands just before the message that it
rode on, with the same times and the same sequence number.
"""

from __future__ import annotations

import struct

from formation.ros2.messages import MAX_BYTES, Text, decode
from formation.wire import BadMessage

SUFFIX = "/attached"
TYPE = Text.ROS_TYPE
_HEAD = struct.Struct("<4sI")
_CDR = b"\0\1\0\0"


def packed(attachment: bytes) -> bytes | None:
    """The message to record for an attachment; None for one that is no printable text, as ours are.

    What `encode(Text(...))` gives, at a tenth of its time: it is needed for two messages of three.
    """
    try:
        printable = attachment.decode().isprintable()
    except UnicodeDecodeError:
        return None
    if not printable or _HEAD.size + len(attachment) >= MAX_BYTES:
        return None
    return _HEAD.pack(_CDR, len(attachment) + 1) + attachment + b"\0"


def unpacked(data: bytes) -> bytes:
    """The attachment in a recorded message; empty if there is none in it. The inverse of `packed`."""
    if len(data) > _HEAD.size and data[-1] == 0 and _HEAD.unpack_from(data) == (_CDR, len(data) - _HEAD.size):
        return data[_HEAD.size : -1]
    try:
        return decode(Text, data).text.encode()  # somebody else wrote it anew
    except BadMessage:
        return b""
