"""A recording as a film: from when to when, and from any moment on, in parts, cut or whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from formation.monitor.recording.reader import Recording, UnreadableError, read
from formation.monitor.recording.rotation import Rotation
from formation.monitor.replay import player
from formation.monitor.replay.player import MIN_RECORDING_TIME, Film
from tests.support.monitored import EPOCH, Fleet
from tests.unit.monitor.recording.test_recorder import recorder


def recorded(path: Path, seconds: float, part: float | None = None) -> Recording:
    """Six robots' positions, from 10 s on, in chunks of half a second and parts of so many."""
    with recorder(path, rotation=Rotation(time=part)) as recording:
        for sample in Fleet().positions(10.0, 10.0 + seconds):
            recording.write(sample, sample.arrived + EPOCH)
            recording.flush(sample.arrived)
    return read(path)


@pytest.mark.parametrize("part", [None, 2.0])
@pytest.mark.parametrize("since", [0.0, EPOCH + 10.0, EPOCH + 13.37, EPOCH + 18.0, EPOCH + 30.0])
def test_from_any_moment_on_come_the_messages_that_come_then(
    part: float | None, since: float, tmp_path: Path
) -> None:
    recording = recorded(tmp_path / "run.mcap", 8.0, part)
    assert (len(recording.parts) > 1) == (part is not None)
    every = list(recording.messages())
    assert list(Film(recording).messages(since)) == [one for one in every if one.wall >= since]


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_a_cut_recording_is_a_film_as_far_as_it_goes(share: float, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorded(path, 8.0)
    data = path.read_bytes()
    path.write_bytes(data[: round(share * len(data))])
    one = Film(read(path))
    every = list(read(path).messages())
    assert (one.start, one.end) == (every[0].wall, every[-1].wall)
    middle = (one.start + one.end) / 2
    assert list(one.messages(middle)) == [message for message in every if message.wall >= middle]


def test_what_is_before_is_passed_over_by_the_chunk(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "run.mcap", 8.0)
    passed = list(recording.messages(EPOCH + 17.0))
    assert EPOCH + 16.0 < passed[0].wall <= EPOCH + 17.0


def test_short_recording_is_rebuilt_completely_and_long_partly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = recorded(tmp_path / "run.mcap", 40.0)
    one = Film(recording)
    assert one.stretch == one.end - one.start
    messages = sum(1 for _ in recording.messages())
    monkeypatch.setattr(player, "MAX_REBUILT_MESSAGES", messages * 3 // 4)
    assert Film(recording).stretch == pytest.approx(30.0, rel=0.01)
    monkeypatch.setattr(player, "MAX_REBUILT_MESSAGES", 1)
    assert Film(recording).stretch == MIN_RECORDING_TIME


def test_a_recording_of_nothing_is_refused(tmp_path: Path) -> None:
    recorder(tmp_path / "run.mcap").close()
    with pytest.raises(UnreadableError, match="has no messages"):
        Film(read(tmp_path / "run.mcap"))
