"""Where a recording keeps what rode on a message, for which MCAP has no place: on a topic beside it.

`<key>/attached` is a std_msgs/String with the attachment's text. It stands just before the message that it
rode on, with the same times and the same sequence number.
"""

from __future__ import annotations

from formation.ros2.messages import Text, encode
from formation.wire import BadMessage

SUFFIX = "/attached"
TYPE = Text.ROS_TYPE


def packed(attachment: bytes) -> bytes | None:
    """The message to record for an attachment; None for one that is no printable text, as ours are."""
    try:
        text = attachment.decode()
        return encode(Text(text)) if text.isprintable() else None
    except (UnicodeDecodeError, BadMessage):
        return None
