"""Malicious recordings: each is refused in a sentence, or only its invalid part is lost."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk, Footer, Header, Metadata, Statistics

from formation.mission.file import read as mission_text
from formation.monitor.recording import reader
from formation.monitor.recording.part import encoded
from formation.monitor.recording.reader import Extent, UnreadableError, condition_of, read
from formation.monitor.recording.recover import recover
from formation.monitor.recording.scan import MAGIC, MAX_CHUNK_BYTES, MAX_EXPANSION_RATIO, contents, records

HUGE = 60 * 10**9


def top(**about: str) -> bytes:
    text = mission_text("six_robots")[0]
    reported = {"mission": "six-robots", "mission_file": text, "law": "field", **about}
    header = encoded(Header(profile="ros2", library="another writer"))
    return MAGIC + header + encoded(Metadata(name="formation", metadata=reported))


def chunk(codec: str, data: bytes, size: int) -> bytes:
    return encoded(
        Chunk(
            compression=codec, data=data, message_start_time=1, message_end_time=2, uncompressed_crc=0,
            uncompressed_size=size,
        )
    )  # fmt: skip


def zstd(size: int) -> bytes:
    """A few kilobytes that announce, and unpack to, `size` zeros."""
    packer = zstandard.ZstdCompressor().compressobj(size=size)
    block = bytes(1 << 20)
    return b"".join([*(packer.compress(block) for _ in range(size >> 20)), packer.flush()])


@pytest.mark.parametrize(
    ("codec", "data", "size"),
    [
        ("lz4", lz4.frame.compress(bytes(1 << 20)), 1 << 20),
        ("lz4", lz4.frame.compress(bytes(MAX_CHUNK_BYTES)), 10),
        ("lz4", lz4.frame.compress(b"x")[:9], 10),
        ("lz4", b"nonsense", MAX_CHUNK_BYTES + 1),
        ("zstd", zstd(MAX_CHUNK_BYTES), 10),
        ("zstd", zstandard.compress(b"x"), 2**64 - 1),
        ("zstd", b"nonsense", 10),
        ("", b"", 2**63),
        ("gzip", b"x", 1),
    ],
)
def test_invalid_chunk_is_counted_as_damaged(tmp_path: Path, codec: str, data: bytes, size: int) -> None:
    file = tmp_path / "bomb.mcap"
    file.write_bytes(top() + chunk(codec, data, size))
    assert list(read(file).messages()) == []
    assert condition_of(file).damaged == 1
    with pytest.raises(UnreadableError, match=r"no message can be read: .*damaged in one place"):
        recover(file, tmp_path / "out.mcap")


@pytest.mark.parametrize("codec", ["lz4", "zstd"])
def test_chunk_above_max_expansion_ratio_is_refused(tmp_path: Path, codec: str) -> None:
    message = struct.pack("<BQHIQQ", Opcode.MESSAGE, 22, 1, 0, 1, 1)
    raw = message * 60_000
    data = {"lz4": lz4.frame.compress, "zstd": zstandard.compress}[codec](raw)
    assert len(raw) > MAX_EXPANSION_RATIO * len(data)
    file = tmp_path / "dense.mcap"
    file.write_bytes(top() + chunk(codec, data, len(raw)))
    with file.open("rb") as opened:
        assert [contents(one.body) for one in records(opened) if one.opcode == Opcode.CHUNK] == [None]
    assert condition_of(file).damaged == 1
    with pytest.raises(UnreadableError, match=r"no message can be read: .*damaged in one place"):
        recover(file, tmp_path / "out.mcap")


@pytest.mark.parametrize("place", [1, 2**31, 2**62, 2**63, 2**64 - 1])
def test_footer_pointing_outside_the_file_counts_as_cut(tmp_path: Path, place: int) -> None:
    file = tmp_path / "footer.mcap"
    file.write_bytes(top() + encoded(Footer(place, place, 0)) + MAGIC)
    recording = read(file)
    assert recording.condition().is_cut
    assert list(recording.messages(since=1.0)) == []
    assert recording.extent().start is None
    assert not recover(file, tmp_path / "out.mcap").is_whole


def test_statistics_with_end_before_start_are_ignored(tmp_path: Path) -> None:
    begin = top()
    stated = Statistics(
        message_count=1, schema_count=0, channel_count=0, attachment_count=0, metadata_count=1, chunk_count=0,
        message_start_time=2**64 - 1, message_end_time=0, channel_message_counts={},
    )  # fmt: skip
    file = tmp_path / "odd.mcap"
    file.write_bytes(begin + encoded(stated) + encoded(Footer(len(begin), 0, 0)) + MAGIC)
    assert read(file).extent() == Extent()


def test_pipe_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(UnreadableError, match="must be a file, is a pipe"):
        read(tmp_path / "pipe.mcap")


@pytest.mark.parametrize("opcode", [Opcode.ATTACHMENT, Opcode.CHUNK, Opcode.METADATA])
def test_reading_ends_at_record_longer_than_memory(tmp_path: Path, opcode: Opcode) -> None:
    file = tmp_path / "sparse.mcap"
    begin = top() + struct.pack("<BQ", opcode, HUGE)
    with file.open("wb") as sparse:
        sparse.write(begin)
        sparse.truncate(len(begin) + HUGE)
    assert list(read(file).messages()) == []
    assert recover(file, tmp_path / "out.mcap").unreadable > HUGE


def test_index_longer_than_any_is_not_read(tmp_path: Path) -> None:
    file, begin = tmp_path / "sparse.mcap", top()
    with file.open("wb") as sparse:
        sparse.write(begin)
        sparse.truncate(len(begin) + HUGE)
        sparse.seek(0, os.SEEK_END)
        sparse.write(encoded(Footer(len(begin), 0, 1)) + MAGIC)
    condition = read(file).condition()
    assert (condition.is_cut, condition.damaged) == (False, 1)
    assert list(read(file).messages()) == []


@pytest.mark.parametrize(
    ("about", "why"),
    [
        ({"mission_file": "a = " + "[" * 100_000}, "its mission"),
        ({"mission_file": "\0"}, "its mission: not valid TOML"),
        ({"law": "<img src=x>"}, "its law is '<img src=x>'; must be one of field, paper"),
    ],
)
def test_unusable_metadata_is_refused(tmp_path: Path, about: dict[str, str], why: str) -> None:
    file = tmp_path / "odd.mcap"
    file.write_bytes(top(**about))
    with pytest.raises(UnreadableError) as refusal:
        read(file)
    assert why in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_recording_of_an_unusable_law_can_be_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "UNUSABLE", {"mine": "mine.py cannot be used: SyntaxError"})
    file = tmp_path / "mine.mcap"
    file.write_bytes(top(law="mine"))
    assert read(file).mission.law.kind == "mine"


def test_part_with_huge_number_is_readable(tmp_path: Path) -> None:
    file = tmp_path / "odd.mcap"
    file.write_bytes(top(recording="a", part="9" * 5000))
    assert read(file).parts == (file,)
