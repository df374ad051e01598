from __future__ import annotations

from pathlib import Path

import pytest

from formation.monitor.recording.reader import Recording, read
from formation.monitor.recording.rotation import Rotation
from tests.support.monitored import Fleet
from tests.unit.monitor.recording.test_recorder import record


@pytest.fixture(params=["whole", "cut"])
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> Recording:
    """Nine seconds of a fleet from 10 s on, in parts and small chunks; the last part may be cut."""
    samples = Fleet().positions(10.0, 19.0)
    parts = record(tmp_path / "run.mcap", samples, flush=True, rotation=Rotation(time=4.0)).paths
    if request.param == "cut":
        parts[-1].write_bytes(parts[-1].read_bytes()[: parts[-1].stat().st_size // 2])
    return read(tmp_path / "run.mcap")
