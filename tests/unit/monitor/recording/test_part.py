"""One file of a recording, byte for byte: where its index points to, and what a write leaves that fails."""

from __future__ import annotations

import errno
import io
import os
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import pytest
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk as ChunkRecord
from mcap.records import MessageIndex

from formation.monitor.recording import recorder as recorder_module
from formation.monitor.recording.channels import Channels
from formation.monitor.recording.part import Chunk, Part
from formation.monitor.recording.reader import is_whole
from formation.monitor.recording.scan import MESSAGE, contents, records
from formation.ros2.messages import Number
from tests.support.monitored import EPOCH, odometry
from tests.unit.monitor.recording.test_recorder import a_bit_of_everything, recorder


def test_every_index_entry_points_to_its_message(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with recorder(path) as recording:
        for sample in sorted(a_bit_of_everything(), key=lambda sample: sample.arrived):
            recording.write(sample, sample.arrived + EPOCH)
            recording.flush(sample.arrived)
    raw, entries = b"", 0
    with path.open("rb") as file:
        for record in records(file):
            body = ReadDataStream(io.BytesIO(record.body))
            if record.opcode == Opcode.CHUNK:
                raw = lz4.frame.decompress(ChunkRecord.read(body).data)
            elif record.opcode == Opcode.MESSAGE_INDEX:
                index = MessageIndex.read(body)
                for logged, at in index.records:
                    opcode, _, channel, _, found, _ = MESSAGE.unpack_from(raw, at)
                    assert (opcode, channel, found) == (Opcode.MESSAGE, index.channel_id, logged)
                    entries += 1
    assert entries == 2 * len(a_bit_of_everything()) - sum(
        sample.attachment is None for sample in a_bit_of_everything()
    )


def test_burst_is_divided_into_small_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "CHUNK_BYTES", 50_000)
    path = tmp_path / "run.mcap"
    with recorder(path) as recording:
        for number in range(500):  # before anybody flushes
            recording.write(odometry("robot2", 10.0 + number / 1000), EPOCH + 10.0 + number / 1000)
    with path.open("rb") as file:
        found = [contents(record.body) for record in records(file) if record.opcode == Opcode.CHUNK]
    assert len(found) > 5
    assert max(one.unpacked for one in found if one) < 100_000


class Full(io.FileIO):
    """A file on a disk that has room for so many bytes more."""

    room = 0

    def write(self, data: Any) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        done = super().write(memoryview(data)[: self.room])
        self.room -= done
        return done


def test_failed_write_leaves_file_unchanged_and_usable(tmp_path: Path) -> None:
    path, channels = tmp_path / "run.mcap", Channels()
    part = Part(path, {}, channels)
    number = channels.register("formation/error", Number.ROS_TYPE)
    chunk = Chunk()
    for second in range(100):
        chunk.add(number, second, second * 10**9, second * 10**9, os.urandom(100))
    chunk.channels = 1
    part.append(chunk)
    before = path.read_bytes()
    whole = part._file
    with Full(path, "rb+") as full:
        full.seek(0, io.SEEK_END)
        full.room = 5_000
        part._file = full
        with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)):
            part.append(chunk)
        assert path.read_bytes() == before
        full.room = 10**9
        part.append(chunk)
        part.finish()
    whole.close()
    assert is_whole(path)
    with path.open("rb") as file:
        found = [contents(record.body) for record in records(file) if record.opcode == Opcode.CHUNK]
    assert [len(one.messages) for one in found if one] == [100, 100]
