"""A recorder with a limit of file size (RLIMIT_FSIZE)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from formation.monitor.recording.reader import read as read_back

LIMITED = """
import resource, sys
from pathlib import Path
from formation.mission.file import load, read
from formation.wire import Sample
from formation.monitor.metrics.keys import OWN, watched
from formation.monitor.recording.recorder import Recorder, RecordingError
from tests.support.monitored import odometry

path, limit = Path(sys.argv[1]), int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))  # as on file systems for small disks
try:
    keys = (*watched(load("six_robots")), *OWN)
    recording = Recorder(path, "six-robots", read("six_robots")[0], "field", keys)
except RecordingError as error:
    print(error)
    sys.exit(2)
with recording:
    for i in range(2000):
        sample = odometry("robot2", 10.0 + i / 20)
        recording.write(sample, sample.arrived)
        recording.flush(sample.arrived)
print(recording.failure)
print(sum(recording.recorded.values()))
print(len(recording.paths))
"""


def limited(path: Path, limit: int) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", LIMITED, str(path), str(limit)],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parents[3],
        timeout=60,
    )


def test_file_size_limit_of_zero_leaves_no_file(tmp_path: Path) -> None:
    done = limited(tmp_path / "run.mcap", 0)
    assert done.returncode == 2, done.stderr
    assert "run.mcap: cannot be written: File too large" in done.stdout
    assert not (tmp_path / "run.mcap").exists()


def test_file_size_limit_splits_recording_without_loss(tmp_path: Path) -> None:
    done = limited(tmp_path / "run.mcap", 50_000)
    assert done.returncode == 0, done.stderr
    failure, recorded, parts = done.stdout.splitlines()
    assert (failure, recorded) == ("None", "2000")
    assert int(parts) == len(list(tmp_path.iterdir())) > 1
    stamps = [one.wall for one in read_back(tmp_path / "run.mcap").messages()]
    assert stamps == pytest.approx([10.0 + i / 20 for i in range(2000)])
