from __future__ import annotations

import errno
import logging
import os
import shutil
import threading
from contextlib import suppress
from pathlib import Path

import pytest
from mcap.reader import make_reader

from formation.monitor.recording import recorder as recorder_module
from formation.monitor.recording.disk import NOTHING, Forcer
from formation.monitor.recording.part import Part
from formation.monitor.recording.reader import read
from formation.monitor.recording.recorder import Recorder, RecordingError
from formation.monitor.recording.rotation import FreeSpace
from tests.support.child import until
from tests.support.disks import feed, in_a_file, in_memory, run, settle
from tests.support.monitored import EPOCH, command
from tests.support.recordings import has_end
from tests.unit.monitor.recording.test_recorder import recorder

SMALL = FreeSpace(stop=400_000, resume=1_500_000)


def walls(path: Path) -> list[float]:
    return [round(one.wall - 1000.0, 1) for one in read(path).messages()]


def tenths(start: float, end: float) -> list[float]:
    return [tick / 10 for tick in range(round(start * 10), round(end * 10))]


def failure_of(recording: Recorder) -> str | None:
    return recording.failure


def levels(recording: Recorder) -> list[int]:
    """Return the levels of all notices except on a slow disk: samples are fed faster than in real time."""
    return [one.level for one in recording.notices() if not one.text.endswith("use a faster disk")]


@pytest.mark.mounts
def test_recording_continues_in_new_part_after_full_disk() -> None:
    with in_memory(4_000_000) as folder:
        filler = folder / "filler"
        with recorder(folder / "run.mcap", room=SMALL) as recording:
            feed(recording, 10.0, 20.0)
            assert failure_of(recording) is None
            filler.write_bytes(bytes(3_700_000))
            feed(recording, 20.0, 25.0)
            assert failure_of(recording) == "less than 0.4 MB are left on the disk"
            feed(recording, 25.0, 31.0)
            assert has_end(recording.paths[0])
            assert recording.lost > 0
            filler.write_bytes(bytes(3_000_000))  # between the limits: recording does not resume
            feed(recording, 31.0, 52.0)
            assert failure_of(recording) is not None
            assert len(recording.paths) == 1
            filler.unlink()
            feed(recording, 52.0, 75.0)
            assert failure_of(recording) is None
            assert levels(recording) == [logging.INFO, logging.ERROR, logging.INFO]
        kept = walls(folder / "run.mcap")
        assert [path.name for path in recording.paths] == ["run.mcap", "run-2.mcap"]
        assert all(map(has_end, recording.paths))
        assert kept[:95] == tenths(10.0, 19.5)
        assert kept[-110:] == tenths(64.0, 75.0)
        assert recording.lost == 2 * (650 - len(kept))  # each with its attachment


@pytest.mark.mounts
def test_disk_full_to_last_block_keeps_complete_messages(tmp_path: Path) -> None:
    with in_a_file(tmp_path / "disk", 20) as folder:
        with recorder(folder / "run.mcap", room=FreeSpace(stop=0, resume=10**9)) as recording:
            feed(recording, 10.0, 12.0)
            with (folder / "filler").open("wb", buffering=0) as file:
                for piece in (100_000, 512):
                    with suppress(OSError):
                        while file.write(bytes(piece)):
                            pass
            feed(recording, 12.0, 60.0)
            assert failure_of(recording) == os.strerror(errno.ENOSPC)
        kept = walls(folder / "run.mcap")
        assert kept == tenths(10.0, 60.0)[: len(kept)]
        assert len(kept) == sum(recording.recorded.values()) >= 15


@pytest.mark.mounts
def test_read_only_disk_ends_only_the_recording(tmp_path: Path) -> None:
    with in_a_file(tmp_path / "disk", 20) as folder:
        with recorder(folder / "run.mcap", room=FreeSpace(0, 0)) as recording:
            feed(recording, 10.0, 12.0)
            run("mount", "-o", "remount,abort", folder)  # as ext4 does on a disk error
            feed(recording, 12.0, 40.0)
            assert failure_of(recording) in {os.strerror(errno.EROFS), os.strerror(errno.EIO)}
        assert set(tenths(10.0, 11.5)) <= set(walls(folder / "run.mcap"))


@pytest.mark.mounts
def test_disk_without_room_at_start_raises_recording_error() -> None:
    with in_memory(300_000) as folder:
        with pytest.raises(
            RecordingError, match=r"cannot be written: less than 0\.4 MB are left on the disk"
        ):
            recorder(folder / "run.mcap", room=SMALL)
        assert not list(folder.iterdir())


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS])
def test_write_error_is_logged_once_and_recording_resumes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, number: int
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    caplog.set_level(logging.INFO)
    with recorder(tmp_path / "run.mcap") as recording:
        feed(recording, 10.0, 15.0)
        with monkeypatch.context() as broken:
            broken.setattr(Part, "append", refuse)
            feed(recording, 15.0, 50.0)
        assert failure_of(recording) == os.strerror(number)
        feed(recording, 50.0, 75.0)
        assert failure_of(recording) is None
    assert caplog.text.count("nothing is recorded any more") == 1
    assert caplog.text.count("continues in") == len(recording.paths) - 1
    kept = walls(tmp_path / "run.mcap")
    assert kept[:45] == tenths(10.0, 14.5)
    assert kept[-130:] == tenths(62.0, 75.0)


def test_recording_does_not_resume_while_quota_is_exceeded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT))

    with recorder(tmp_path / "run.mcap") as recording:
        feed(recording, 10.0, 15.0)
        with monkeypatch.context() as broken:
            broken.setattr(Part, "append", refuse)
            feed(recording, 15.0, 20.0)
        with monkeypatch.context() as broken:  # only posix_fallocate fails
            broken.setattr("formation.monitor.recording.part.os.posix_fallocate", refuse)
            feed(recording, 20.0, 50.0)
        assert failure_of(recording) == os.strerror(errno.EDQUOT)
        assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]
        feed(recording, 50.0, 75.0)
        assert failure_of(recording) is None


def test_deleted_part_is_lost_but_recording_continues(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    with recorder(folder / "run.mcap") as recording:
        feed(recording, 10.0, 15.0)
        shutil.rmtree(folder)
        feed(recording, 15.0, 20.0)
        assert failure_of(recording) is None
        assert levels(recording) == [logging.INFO, logging.ERROR, logging.INFO]
    assert [path.name for path in folder.iterdir()] == ["run-2.mcap"]
    kept = walls(folder / "run-2.mcap")
    assert kept[-50:] == tenths(15.0, 20.0)
    assert sum(recording.recorded.values()) == len(kept)


def test_moved_part_is_written_to_its_end(tmp_path: Path) -> None:
    with recorder(tmp_path / "run.mcap") as recording:
        feed(recording, 10.0, 15.0)
        (tmp_path / "run.mcap").rename(tmp_path / "moved.mcap")
        feed(recording, 15.0, 20.0)
    assert walls(tmp_path / "moved.mcap") == tenths(10.0, 20.0)


class Stuck:
    """A disk on which the method `what` of a part blocks until `let` is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, what: str) -> None:
        self.let = threading.Event()
        real = getattr(Part, what)

        def wait(part: Part, *rest: object) -> None:
            self.let.wait()
            real(part, *rest)

        monkeypatch.setattr(Part, what, wait)


@pytest.mark.parametrize("what", ["sync", "append"])
def test_hanging_disk_delays_nothing_and_catches_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, what: str
) -> None:
    stuck = Stuck(monkeypatch, what)
    with recorder(tmp_path / "run.mcap") as recording:
        for tick in range(100, 300):
            recording.flush(tick / 10)
            feed_one(recording, tick / 10)
        assert failure_of(recording) is None
        assert not recording.recorded  # only what the disk has confirmed counts as recorded
        assert caplog.text.count("the disk is 2.5 s behind, limit 2 s: a power cut would lose that") == 1
        stuck.let.set()
        until(lambda: recording._disk.safe.number == recording._handed)
        recording.flush(31.0)
        assert sum(recording.recorded.values()) > 150
    assert walls(tmp_path / "run.mcap") == tenths(10.0, 30.0)


def test_written_messages_are_readable_despite_hanging_sync(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stuck = Stuck(monkeypatch, "sync")
    with recorder(tmp_path / "run.mcap") as recording:
        feed(recording, 10.0, 20.0)
        assert walls(tmp_path / "run.mcap") == tenths(10.0, 19.6)
        stuck.let.set()


def test_hanging_disk_does_not_fill_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recorder_module, "MAX_WAITING_BYTES", 5_000)
    stuck = Stuck(monkeypatch, "append")
    with recorder(tmp_path / "run.mcap") as recording:
        for tick in range(100, 400):
            feed_one(recording, tick / 10)
            recording.flush(tick / 10)
        assert failure_of(recording) == "the disk is too slow"
        assert sum(recording._waiting) < 6_000
        with monkeypatch.context() as roomier:  # just below the limit, recording does not resume
            roomier.setattr(recorder_module, "MAX_WAITING_BYTES", 1.5 * sum(recording._waiting))
            recording.flush(40.0)
            assert failure_of(recording) == "the disk is too slow"
        stuck.let.set()
        settle(recording)
        feed(recording, 40.0, 45.0)
        assert failure_of(recording) is None
        assert levels(recording)[-1] == logging.WARNING
    kept = walls(tmp_path / "run.mcap")
    assert kept[-40:] == tenths(41.0, 45.0)
    assert recording.lost == 2 * (350 - len(kept))
    assert caplog.text.count("nothing is recorded any more") == 1


def test_failed_sync_starts_new_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Part) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with recorder(tmp_path / "run.mcap") as recording:
        with monkeypatch.context() as broken:
            broken.setattr(Part, "sync", refuse)
            feed(recording, 10.0, 15.0)
            until(lambda: recording._disk._forcer._error is not None or failure_of(recording) is not None)
        feed(recording, 15.0, 16.0)
        assert failure_of(recording) == os.strerror(errno.EIO)
        feed(recording, 30.0, 35.0)
        assert failure_of(recording) is None
        assert len(recording.paths) == 2
    assert walls(tmp_path / "run.mcap")[-40:] == tenths(31.0, 35.0)


def test_forcer_ignores_older_confirmation() -> None:
    forcer = Forcer()
    forcer.confirm(NOTHING._replace(number=5))
    forcer.confirm(NOTHING._replace(number=3))
    forcer.close()
    assert forcer.safe.number == 5


def test_close_returns_while_disk_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recorder_module, "STOP_TIMEOUT_SECONDS", 0.05)
    stuck = Stuck(monkeypatch, "append")
    recording = recorder(tmp_path / "run.mcap")
    feed_one(recording, 10.0)
    recording.close()
    assert "does not answer" in caplog.text
    stuck.let.set()
    until(lambda: not recording._disk.is_alive)
    assert walls(tmp_path / "run.mcap") == [10.0]


def test_part_started_after_failure_is_complete(tmp_path: Path) -> None:
    with recorder(tmp_path / "run.mcap") as recording:
        feed(recording, 10.0, 12.0)
        (tmp_path / "run.mcap").unlink()
        feed(recording, 12.0, 14.0)
    with (tmp_path / "run-2.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert len(list(reader.iter_messages())) >= 20 * 2


def feed_one(recording: Recorder, at: float) -> None:
    recording.write(command("robot2", at, 0.1, 0.2)._replace(attachment=b"{}"), at + EPOCH)


def test_chunk_that_cannot_be_compressed_loses_only_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_data: bytes) -> bytes:
        raise MemoryError("no room to pack it in")

    with recorder(tmp_path / "run.mcap") as recording:
        feed(recording, 10.0, 15.0)
        with monkeypatch.context() as broken:
            broken.setattr("formation.monitor.recording.part.lz4.frame.compress", fails)
            feed(recording, 15.0, 17.0)
            assert failure_of(recording) == "no room to pack it in"
        feed(recording, 17.0, 40.0)
        assert failure_of(recording) is None
        assert recording.lost > 0
    found = walls(tmp_path / "run.mcap")
    assert found[:45] == tenths(10.0, 14.5)
    assert found[-1] == 39.9
