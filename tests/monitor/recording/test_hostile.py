"""Files that somebody made to hurt who reads them: each is refused in a sentence, or costs itself alone."""

from __future__ import annotations

import struct
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk, Header, Metadata

from formation.mission_file import read as mission_text
from monitor.recording.part import packed
from monitor.recording.reader import UnreadableError, read
from monitor.recording.recover import recover
from monitor.recording.scan import LONGEST, MAGIC

HUGE = 60 * 10**9


def top(**about: str) -> bytes:
    told = {"mission": "six-robots", "mission_file": mission_text("six_robots")[0], "law": "field", **about}
    header = packed(Header(profile="ros2", library="somebody else's"))
    return MAGIC + header + packed(Metadata(name="formation", metadata=told))


def chunk(codec: str, data: bytes, size: int) -> bytes:
    return packed(
        Chunk(
            compression=codec, data=data, message_start_time=1, message_end_time=2, uncompressed_crc=0,
            uncompressed_size=size,
        )
    )  # fmt: skip


def zstd(size: int) -> bytes:
    """A few kilobytes that say, and are, as many zeros."""
    packer = zstandard.ZstdCompressor().compressobj(size=size)
    block = bytes(1 << 20)
    return b"".join([*(packer.compress(block) for _ in range(size >> 20)), packer.flush()])


@pytest.mark.parametrize(
    ("codec", "data", "size"),
    [
        ("lz4", lz4.frame.compress(bytes(1 << 20)), 1 << 20),
        ("lz4", lz4.frame.compress(bytes(LONGEST)), 10),
        ("lz4", lz4.frame.compress(b"x")[:9], 10),
        ("lz4", b"nonsense", LONGEST + 1),
        ("zstd", zstd(LONGEST), 10),
        ("zstd", zstandard.compress(b"x"), 2**64 - 1),
        ("zstd", b"nonsense", 10),
        ("", b"", 2**63),
        ("gzip", b"x", 1),
    ],
)
def test_a_chunk_that_is_longer_than_it_says_or_nonsense_costs_itself_alone(
    tmp_path: Path, codec: str, data: bytes, size: int
) -> None:
    file = tmp_path / "bomb.mcap"
    file.write_bytes(top() + chunk(codec, data, size))
    assert list(read(file).messages()) == []
    assert recover(file, tmp_path / "out.mcap").damaged == 1


@pytest.mark.parametrize("opcode", [Opcode.ATTACHMENT, Opcode.CHUNK, Opcode.METADATA])
def test_a_record_longer_than_memory_is_where_a_file_ends(tmp_path: Path, opcode: Opcode) -> None:
    file = tmp_path / "sparse.mcap"
    begin = top() + struct.pack("<BQ", opcode, HUGE)
    with file.open("wb") as sparse:
        sparse.write(begin)
        sparse.truncate(len(begin) + HUGE)
    assert list(read(file).messages()) == []
    assert recover(file, tmp_path / "out.mcap").unreadable > HUGE


@pytest.mark.parametrize(
    ("about", "why"),
    [
        ({"mission_file": "a = " + "[" * 100_000}, "its mission"),
        ({"mission_file": "\0"}, "its mission: not valid TOML"),
        ({"law": "<img src=x>"}, "its law is '<img src=x>'; must be one of field, paper"),
    ],
)
def test_metadata_that_nobody_can_follow_is_refused(tmp_path: Path, about: dict[str, str], why: str) -> None:
    file = tmp_path / "odd.mcap"
    file.write_bytes(top(**about))
    with pytest.raises(UnreadableError) as refusal:
        read(file)
    assert why in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_part_with_an_absurd_number_is_still_a_part(tmp_path: Path) -> None:
    file = tmp_path / "odd.mcap"
    file.write_bytes(top(recording="a", part="9" * 5000))
    assert read(file).parts == (file,)
