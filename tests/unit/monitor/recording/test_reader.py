from __future__ import annotations

from pathlib import Path

import pytest

from formation.monitor.recording import scan
from formation.monitor.recording.reader import Recording, read
from formation.monitor.recording.rotation import Rotation
from tests.support.monitored import EPOCH, Fleet
from tests.unit.monitor.recording.test_recorder import recorder


@pytest.fixture(params=["whole", "cut"])
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> Recording:
    """Nine seconds of a fleet, in parts; the last one may be cut."""
    with recorder(tmp_path / "run.mcap", rotation=Rotation(time=4.0)) as one:
        for sample in Fleet().positions(10.0, 19.0):
            one.write(sample, sample.arrived + EPOCH)
            one.flush(sample.arrived)
    if request.param == "cut":
        last = one.paths[-1]
        last.write_bytes(last.read_bytes()[: last.stat().st_size // 2])
    return read(tmp_path / "run.mcap")


@pytest.mark.parametrize("since", [0.0, 9.9, 12.3, 14.1, 17.0, 25.0])
def test_it_can_be_read_from_any_moment_on(recording: Recording, since: float) -> None:
    everything = list(recording.messages())
    wanted = [one for one in everything if one.wall >= since + EPOCH]
    found = list(recording.messages(since + EPOCH))
    assert found == everything[len(everything) - len(found) :]
    assert len(wanted) <= len(found) <= len(wanted) + 70  # whole chunks are passed over


def test_what_is_passed_over_is_not_unpacked(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    unpacked = []
    real = scan.contents

    def counted(body: bytes) -> scan.Contents | None:
        unpacked.append(len(body))
        return real(body)

    monkeypatch.setattr("formation.monitor.recording.reader.contents", counted)
    list(recording.messages())
    all_of_them = len(unpacked)
    unpacked.clear()
    assert next(recording.messages(14.5 + EPOCH)).wall > 13.9 + EPOCH
    assert 0 < len(unpacked) <= 2 < all_of_them


def test_its_extent_is_that_of_its_messages(recording: Recording) -> None:
    messages = list(recording.messages())
    extent = recording.extent()
    assert (extent.start, extent.end) == pytest.approx((messages[0].wall, messages[-1].wall))
    assert extent.duration == pytest.approx(messages[-1].wall - messages[0].wall)
    assert extent.counts.total() == len(messages)
    assert extent.counts["robot2/position"] == sum(one.sample.key == "robot2/position" for one in messages)


def test_an_empty_recording_has_no_extent(tmp_path: Path) -> None:
    with recorder(tmp_path / "run.mcap"):
        pass
    extent = read(tmp_path / "run.mcap").extent()
    assert (extent.start, extent.end, extent.duration, extent.counts) == (None, None, 0.0, {})
