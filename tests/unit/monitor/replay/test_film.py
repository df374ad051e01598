"""A recording as a film: from when to when, and from any moment on, in parts, cut or whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from formation.monitor.recording.reader import Recording, UnreadableError, read
from formation.monitor.replay import player
from formation.monitor.replay.player import MIN_RECORDING_TIME, Film
from tests.support.monitored import EPOCH, Fleet
from tests.unit.monitor.recording.test_recorder import record


@pytest.mark.parametrize("since", [0.0, 10.0, 13.37, 16.0, 18.0, 30.0])
def test_film_starts_at_any_moment(recording: Recording, since: float) -> None:
    film, every = Film(recording), list(recording.messages())
    assert (film.start, film.end) == pytest.approx((every[0].wall, every[-1].wall))
    assert list(film.messages(EPOCH + since)) == [one for one in every if one.wall >= EPOCH + since]


def test_short_recording_is_rebuilt_completely_and_long_partly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(tmp_path / "run.mcap", Fleet().positions(10.0, 50.0), flush=True)
    recording = read(tmp_path / "run.mcap")
    one = Film(recording)
    assert one.stretch == one.end - one.start
    monkeypatch.setattr(player, "MAX_REBUILT_MESSAGES", recording.extent().counts.total() * 3 // 4)
    assert Film(recording).stretch == pytest.approx(30.0, rel=0.01)
    monkeypatch.setattr(player, "MAX_REBUILT_MESSAGES", 1)
    assert Film(recording).stretch == MIN_RECORDING_TIME


def test_a_recording_of_nothing_is_refused(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", [])
    with pytest.raises(UnreadableError, match="has no messages"):
        Film(read(tmp_path / "run.mcap"))
