from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from formation.monitor.recording import scan
from formation.monitor.recording.reader import Recording, read
from tests.support.monitored import EPOCH
from tests.unit.monitor.recording.test_recorder import record


@pytest.mark.parametrize("since", [0.0, 9.9, 12.3, 14.1, 17.0, 25.0])
def test_it_can_be_read_from_any_moment_on(recording: Recording, since: float) -> None:
    everything = list(recording.messages())
    wanted = [one for one in everything if one.wall >= since + EPOCH]
    found = list(recording.messages(since + EPOCH))
    assert found == everything[len(everything) - len(found) :]
    assert len(wanted) <= len(found) <= len(wanted) + 70  # whole chunks are passed over


def test_what_is_passed_over_is_not_unpacked(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    unpacked, real = list[int](), scan.contents

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
    start, end = messages[0].wall, messages[-1].wall
    extent = recording.extent()
    assert (extent.start, extent.end, extent.duration) == pytest.approx((start, end, end - start))
    assert extent.counts == Counter(one.sample.key for one in messages)


def test_an_empty_recording_has_no_extent(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", [])
    extent = read(tmp_path / "run.mcap").extent()
    assert (extent.start, extent.end, extent.duration, extent.counts) == (None, None, 0.0, {})
