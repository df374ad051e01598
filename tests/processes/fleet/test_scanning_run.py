"""Range scans of a real run among posts are recorded as ROS 2 messages and reproduce every command."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader

from formation.mission.file import load
from formation.topics import SCAN
from tests.processes.monitor.test_recording_elsewhere import check
from tests.support.launched import assert_commands_reproduced, result_of, started

pytestmark = pytest.mark.processes


def test_range_scans_are_recorded_and_reproduce_every_command(tmp_path: Path) -> None:
    with started("posts", "--duration", "16", "--record", "run.mcap", folder=tmp_path) as process:
        assert result_of(process)["lost"] == 0
    recording = tmp_path / "run.mcap"
    counts = check([recording])
    with recording.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    schemas = {one.topic: summary.schemas[one.schema_id] for one in summary.channels.values()}
    for name in load("posts").followers:
        topic = f"/{SCAN.key(name)}"
        assert counts[topic] > 50
        assert schemas[topic].name == "sensor_msgs/msg/LaserScan"
        assert b"float32[] ranges" in schemas[topic].data
    assert_commands_reproduced(recording)
