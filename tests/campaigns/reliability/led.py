"""Who led when, by a recording: from the positions that were said as the leader's."""

from __future__ import annotations

from pathlib import Path

from formation.mission.model import Mission
from formation.monitor.recording.reader import read
from formation.protocol import order
from formation.protocol.order import PositionAttachment
from formation.ros2.messages import Pose, decode
from formation.topics import POSITION
from tests.campaigns.reliability.seen import Led


def recorded_leads(path: Path, mission: Mission) -> list[Led]:
    """Everything that was said as the leader, as the monitor heard it. Raises UnreadableError."""
    key, found = POSITION.key(mission.leader), []
    for recorded in read(path).messages():
        sample = recorded.sample
        if sample.key != key or sample.attachment is None:
            continue
        attachment, pose = order.decode(PositionAttachment, sample.attachment), decode(Pose, sample.payload)
        if attachment.order is not None:
            found.append(Led.of(recorded.wall, pose.position, attachment, attachment.order, mission))
    return found
