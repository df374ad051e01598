"""Who led when, by a recording: from the positions that were said as the leader's."""

from __future__ import annotations

from pathlib import Path

from formation import order
from formation.mission import Mission
from formation.order import Told
from formation.ros2.messages import Pose, decode
from formation.topics import POSITION
from monitor.recording.reader import read
from tests.reliability.seen import Led


def recorded_leads(path: Path, mission: Mission) -> list[Led]:
    """Everything that was said as the leader, as the monitor heard it. Raises UnreadableError."""
    key, found = POSITION.key(mission.leader), []
    for recorded in read(path).messages():
        sample = recorded.sample
        if sample.key != key or sample.attachment is None:
            continue
        told, pose = order.decode(Told, sample.attachment), decode(Pose, sample.payload)
        if told.order is not None:
            found.append(Led.of(recorded.wall, pose.position, told, told.order, mission))
    return found
