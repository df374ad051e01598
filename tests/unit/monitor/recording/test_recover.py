"""Recordings read back: whole, cut or damaged, from any moment on, and recovered."""

from __future__ import annotations

import errno
import os
import random
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import ChunkIndex

from formation.monitor.recording import scan
from formation.monitor.recording.part import Part
from formation.monitor.recording.reader import Condition, Recorded, Recording, UnreadableError, read
from formation.monitor.recording.recover import recover
from formation.wire import Sample
from tests.support.monitored import EPOCH, Fleet, odometry
from tests.support.recordings import has_end
from tests.unit.monitor.recording.test_recorder import record, summary_of

Bare = tuple[str, bytes, bytes | None, int]
"""Key, payload, attachment and time of a message [ns]."""


def chunked(path: Path, seconds: float = 3.0) -> list[Sample]:
    """A recording with a chunk for each half second."""
    odometries = [odometry("robot2", 10.0 + i / 20) for i in range(20)]
    samples = sorted([*Fleet().positions(10.0, 10.0 + seconds), *odometries], key=lambda one: one.arrived)
    record(path, samples, flush=True)
    return samples


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    chunked(path, 1.2)
    return path.read_bytes()


def bare(messages: Iterator[Recorded]) -> list[Bare]:
    return [(*one.sample[:3], round(one.wall * 1e9)) for one in messages]


def test_recover_leaves_whole_recording_unchanged(tmp_path: Path) -> None:
    samples = chunked(tmp_path / "run.mcap")
    before = (tmp_path / "run.mcap").read_bytes()
    found = recover(tmp_path / "run.mcap", tmp_path / "out.mcap")
    assert found.is_whole
    assert found.extent.counts.total() == len(samples)
    assert [one.name for one in tmp_path.iterdir()] == ["run.mcap"]
    assert (tmp_path / "run.mcap").read_bytes() == before


def test_recover_completes_a_cut_recording(tmp_path: Path, whole: bytes) -> None:
    cut, out = tmp_path / "run.mcap", tmp_path / "out.mcap"
    cut.write_bytes(whole[: len(whole) * 6 // 10])
    kept = bare(read(cut).messages())
    assert read(cut).condition().is_cut
    found = recover(cut, out)
    assert not found.is_whole
    assert cut.read_bytes() == whole[: len(whole) * 6 // 10]
    assert 0 < found.extent.counts.total() == len(kept)
    assert found.unreadable > 0
    assert not read(out).condition().is_cut
    assert recover(out, tmp_path / "again.mcap").is_whole
    assert not (tmp_path / "again.mcap").exists()
    assert bare(read(out).messages()) == kept
    assert read(out).extent() == read(cut).extent() == found.extent
    assert read(out).about["recovered_from"] == "run.mcap"
    with out.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        indexed = list(reader.iter_messages())
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(indexed) >= len(kept)


def test_failed_recover_leaves_no_file(tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Part) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "run.mcap").write_bytes(whole[: len(whole) // 2])
    monkeypatch.setattr(Part, "finish", refuse)
    with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
        recover(tmp_path / "run.mcap", tmp_path / "out.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


def test_recording_truncated_at_any_byte_is_recovered(tmp_path: Path, whole: bytes) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "out.mcap"
    counts = []
    for length in [*range(20), *range(20, len(whole), 601), *range(len(whole) - 40, len(whole) + 1)]:
        path.write_bytes(whole[:length])
        try:
            messages = bare(read(path).messages())
        except UnreadableError:
            with pytest.raises(UnreadableError, match="is no recording"):
                recover(path, out)
            assert not out.exists()
            continue
        counts.append(len(messages))
        found = recover(path, out)
        assert found.is_whole == (length == len(whole))
        if not found.is_whole:
            assert bare(read(out).messages()) == messages
            assert has_end(out)
            out.unlink()
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, len(messages))


@given(seed=st.integers(0, 2**32), flips=st.integers(1, 20))
def test_random_damage_does_not_crash_read_or_recover(
    tmp_path_factory: pytest.TempPathFactory, whole: bytes, seed: int, flips: int
) -> None:
    choice, data = random.Random(seed), bytearray(whole)
    for _ in range(flips):
        data[choice.randrange(len(data))] = choice.randrange(256)
    path = tmp_path_factory.mktemp("damaged") / "run.mcap"
    path.write_bytes(data)
    try:
        recording = read(path)
    except UnreadableError:
        return
    kept = bare(recording.messages())
    recording.extent()
    if recording.condition().damaged and not kept:
        with pytest.raises(UnreadableError, match="no message can be read"):
            recover(path, path.with_name("out.mcap"))
        return
    found = recover(path, path.with_name("out.mcap"))
    if not found.is_whole:
        assert bare(read(path.with_name("out.mcap")).messages()) == kept


def middle_lost(whole: bytes, chunk: ChunkIndex) -> bytes:
    """Zeros in the middle of a chunk."""
    return zeros_at(whole, chunk.chunk_start_offset + chunk.chunk_length // 2)


def head_lost(whole: bytes, chunk: ChunkIndex) -> bytes:
    """Zeros where a chunk's record begins."""
    return zeros_at(whole, chunk.chunk_start_offset)


def claiming_the_next(whole: bytes, chunk: ChunkIndex) -> bytes:
    """A length that reaches into the next chunk."""
    at = chunk.chunk_start_offset + 1
    claimed = chunk.chunk_length + chunk.message_index_length
    return whole[:at] + claimed.to_bytes(8, "little") + whole[at + 8 :]


def zeros_at(whole: bytes, at: int, length: int = 40) -> bytes:
    return whole[:at] + bytes(length) + whole[at + length :]


@pytest.mark.parametrize(
    ("number", "damaged"), [(0, middle_lost), (1, middle_lost), (1, head_lost), (1, claiming_the_next)]
)
def test_damaged_chunk_loses_only_its_own_messages(
    tmp_path: Path, whole: bytes, number: int, damaged: Callable[[bytes, ChunkIndex], bytes]
) -> None:
    """Others still know the channels that the first chunk declares."""
    path, out = tmp_path / "run.mcap", tmp_path / "out.mcap"
    path.write_bytes(whole)
    everything, chunk = bare(read(path).messages()), summary_of(path).chunk_indexes[number]
    path.write_bytes(damaged(whole, chunk))
    left = bare(read(path).messages())
    gone = [one for one in everything if one not in left]
    assert left == [one for one in everything if one not in gone]
    assert 0 < len(gone) < len(everything) / 2
    assert chunk.message_start_time <= min(one[3] for one in gone)
    assert max(one[3] for one in gone) <= chunk.message_end_time
    condition = Condition(is_cut=False, damaged=1)
    found = recover(path, out)
    assert (read(path).condition(), found.condition, found.unreadable) == (condition, condition, 0)
    assert bare(read(out).messages()) == left
    assert read(out).condition().words == ""
    with out.open("rb") as stream:
        assert len(list(make_reader(stream, validate_crcs=True).iter_messages())) >= len(left)


def test_damaged_index_is_reported_and_loses_no_message(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(whole)
    everything = bare(read(path).messages())
    data = bytearray(whole)
    data[-120] ^= 0xFF
    path.write_bytes(data)
    assert read(path).condition() == Condition(is_cut=False, damaged=1)
    assert bare(read(path).messages()) == everything
    assert read(path).extent().counts.total() == len(everything)


def test_recover_writes_nothing_if_no_message_can_be_read(
    tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run.mcap").write_bytes(whole)
    monkeypatch.setattr(scan, "MAX_CHUNK_BYTES", 100)
    with pytest.raises(UnreadableError, match="no message can be read: damaged in 3 places; keep it"):
        recover(tmp_path / "run.mcap", tmp_path / "out.mcap")
    assert [one.name for one in tmp_path.iterdir()] == ["run.mcap"]


def test_recover_does_not_overwrite_a_file(tmp_path: Path, whole: bytes) -> None:
    (tmp_path / "run.mcap").write_bytes(whole[:-100])
    (tmp_path / "out.mcap").write_text("dear")
    with pytest.raises(FileExistsError):
        recover(tmp_path / "run.mcap", tmp_path / "out.mcap")
    assert (tmp_path / "out.mcap").read_text() == "dear"


@pytest.mark.parametrize("since", [0.0, 9.9, 12.3, 14.1, 17.0, 25.0])
def test_recording_is_readable_from_any_moment(recording: Recording, since: float) -> None:
    everything = list(recording.messages())
    wanted = [one for one in everything if one.wall >= since + EPOCH]
    found = list(recording.messages(since + EPOCH))
    assert found == everything[len(everything) - len(found) :]
    assert len(wanted) <= len(found) <= len(wanted) + 70  # only whole chunks are skipped


def test_skipped_chunks_are_not_unpacked(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_extent_equals_that_of_the_messages(recording: Recording) -> None:
    messages = list(recording.messages())
    start, end = messages[0].wall, messages[-1].wall
    extent = recording.extent()
    assert (extent.start, extent.end, extent.duration) == pytest.approx((start, end, end - start))
    assert extent.counts == Counter(one.sample.key for one in messages)


def test_empty_recording_has_no_extent(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", [])
    extent = read(tmp_path / "run.mcap").extent()
    assert (extent.start, extent.end, extent.duration, extent.counts) == (None, None, 0.0, {})
