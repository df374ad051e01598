"""What a recording holds, byte for byte: channels, attachments, chunks and the index."""

from __future__ import annotations

import errno
import io
import os
from collections import Counter
from collections.abc import Iterable
from itertools import accumulate
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, ChunkIndex, Message, MessageIndex, Schema
from mcap.records import Chunk as ChunkRecord
from mcap.summary import Summary
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from formation.mission.file import load, parse, read
from formation.mission.model import Mission
from formation.monitor.metrics.keys import OWN, watched
from formation.monitor.recording import disk, scan
from formation.monitor.recording import part as part_module
from formation.monitor.recording import recorder as recorder_module
from formation.monitor.recording.channels import SUFFIX, Channels, packed_attachment, unpacked_attachment
from formation.monitor.recording.part import (
    BLOCK_BYTES,
    CHUNK_HEAD_BYTES,
    Chunk,
    ChunkEntry,
    Index,
    Part,
    encoded,
)
from formation.monitor.recording.reader import read as read_back
from formation.monitor.recording.recorder import Recorder, RecordingError, stamp_of
from formation.monitor.recording.rotation import FREE_SPACE, ROTATION, FreeSpace, Rotation
from formation.monitor.recording.scan import MESSAGE, Contents, contents, records
from formation.ros2 import messages
from formation.ros2.definitions import type_hash
from formation.ros2.messages import Displacement, Number, Text, decode, encode
from formation.topics import ALIVE, CMD_VEL, ERROR, ODOM, POSITION, TABLE
from formation.wire import Sample
from tests.support.monitored import EPOCH, Fleet, command, odometry, sample_of, status
from tests.support.recordings import has_end

TEXT, SIX = read("six_robots")[0], load("six_robots")


def recorder(
    path: Path,
    mission: Mission = SIX,
    text: str = TEXT,
    rotation: Rotation = ROTATION,
    room: FreeSpace = FREE_SPACE,
) -> Recorder:
    return Recorder(path, mission.name, text, "paper", (*watched(mission), *OWN), rotation, room)


def record(path: Path, samples: Iterable[Sample], *, flush: bool = False, **how: Any) -> Recorder:
    """The recorder of these samples, which is closed; `flush` has it end a chunk each half second."""
    with recorder(path, **how) as recording:
        for sample in samples:
            recording.write(sample, sample.arrived + EPOCH)
            if flush:
                recording.flush(sample.arrived)
    return recording


def read_by_mcap(path: Path) -> list[tuple[Schema | None, Channel, Message]]:
    """All messages in the order of the file, read by the `mcap` package."""
    with path.open("rb") as stream:
        return list(make_reader(stream).iter_messages(log_time_order=False))


def summary_of(path: Path) -> Summary:
    with path.open("rb") as stream:
        found = make_reader(stream).get_summary()
    assert found is not None
    return found


def chunks_of(path: Path) -> list[Contents]:
    with path.open("rb") as file:
        found = [contents(each.body) for each in records(file) if each.opcode == Opcode.CHUNK]
    assert None not in found
    return [one for one in found if one is not None]


def a_bit_of_everything() -> list[Sample]:
    fleet = Fleet()
    samples = [
        *fleet.positions(10.0, 11.0),
        *[odometry("robot2", 10.0 + i / 20) for i in range(20)],
        *[command("robot2", 10.0 + i / 20, 0.1, 0.2) for i in range(20)],
        status("robot3", 10.5, "run", "in formation control"),
        fleet.truth("robot4", 10.5),
        sample_of(ERROR.key(), Number(0.25), 10.6),
    ]
    return sorted(samples, key=lambda sample: sample.arrived)


def sample_of_bytes(payload: bytes) -> Sample:
    return Sample(ODOM.key("robot2"), payload, None, 10.5)


def test_recording_contains_received_messages_exactly_in_order(tmp_path: Path) -> None:
    samples = a_bit_of_everything()
    recorded = record(tmp_path / "run.mcap", samples)
    found = [
        (channel.topic, message.data, message.log_time)
        for _, channel, message in read_by_mcap(tmp_path / "run.mcap")
        if not channel.topic.endswith(SUFFIX)
    ]
    assert found == [(f"/{s.key}", s.payload, round((s.arrived + EPOCH) * 1e9)) for s in samples]
    assert recorded.recorded == Counter(sample.key for sample in samples)


def test_index_stays_readable_without_rotation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk, "MAX_INDEX_BYTES", 12_000)
    monkeypatch.setattr(scan, "MAX_SUMMARY_BYTES", 24_000)
    samples = Fleet().positions(10.0, 40.0)
    paths = record(tmp_path / "run.mcap", samples, flush=True, rotation=Rotation(None, None)).paths
    assert len(paths) > 1
    found = read_back(paths[0])
    assert (found.condition().damaged, len(list(found.messages()))) == (0, len(samples))


def test_publish_time_is_the_stamp_if_present(tmp_path: Path) -> None:
    late = odometry("robot2", 10.0)._replace(arrived=10.25)
    unstamped = command("robot2", 10.5, 0.1, 0.2)
    record(tmp_path / "run.mcap", (late, unstamped))
    first, second = (message for _, _, message in read_by_mcap(tmp_path / "run.mcap"))
    assert (first.publish_time, first.log_time) == (1_010_000_000_000, 1_010_250_000_000)
    assert second.publish_time == second.log_time == 1_010_500_000_000


def test_every_topic_has_channel_with_ros_2_schema(tmp_path: Path) -> None:
    text = TEXT.replace("rate = 20 ", 'measurement = "local"\nlocalisation = "external"\nrate = 20 ')
    mapped = 'localisation = "odometry"\nodometry_frame = "map"'
    text = text.replace("[robots.robot3]\n", f"[robots.robot3]\n{mapped}\n") + "\n[standbys.spare]\n"
    record(tmp_path / "run.mcap", [], mission=parse(text), text=text)
    summary = summary_of(tmp_path / "run.mcap")
    kinds = {channel.topic.split("/", 2)[2].split("/")[0] for channel in summary.channels.values()}
    received = {topic.name for topic in TABLE if topic.type} - {ALIVE.name}  # which stays on the robot
    assert kinds == received
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg")
        # the schema text alone gives the type with the hash of ROS
        typestore = get_typestore(Stores.EMPTY)
        typestore.register(get_types_from_msg(schema.data.decode(), schema.name))
        assert typestore.hash_rihs01(schema.name) == type_hash(schema.name)
        assert channel.metadata["topic_type_hash"] == type_hash(schema.name)


@pytest.mark.parametrize(("kind", "name"), [("twist", "Twist"), ("twist_stamped", "TwistStamped")])
def test_commands_are_recorded_with_the_robots_message_type(tmp_path: Path, kind: str, name: str) -> None:
    text = TEXT.replace("rate = 20 ", f'cmd_vel = "{kind}"\nrate = 20 ')
    sample = command("robot2", 10.0, 0.1, 0.2, stamped=kind == "twist_stamped")
    record(tmp_path / "run.mcap", [sample], mission=parse(text), text=text)
    ((schema, channel, _),) = read_by_mcap(tmp_path / "run.mcap")
    assert channel.topic == f"/{CMD_VEL.key('robot2')}"
    assert schema is not None
    assert schema.name == f"geometry_msgs/msg/{name}"


def test_rosbags_decodes_the_recording(tmp_path: Path) -> None:
    fleet = Fleet()
    samples = fleet.positions(10.0, 10.2)
    record(tmp_path / "run.mcap", samples)
    with Reader(tmp_path / "run.mcap") as bag:
        typestore = get_typestore(Stores.EMPTY)
        for connection in bag.connections:
            typestore.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        qos = [connection.ext.offered_qos_profiles for connection in bag.connections]  # type: ignore[union-attr]
        decoded = [
            (connection.topic, typestore.deserialize_cdr(data, connection.msgtype))
            for connection, _, data in bag.messages()
            if not connection.topic.endswith(SUFFIX)
        ]
    assert len(decoded) == len(samples)
    topic, pose = decoded[0]
    expected = messages.decode(messages.Pose, samples[0].payload)
    assert topic == f"/{POSITION.key('robot1')}"
    assert complex(pose.pose.position.x, pose.pose.position.y) == expected.position  # type: ignore[attr-defined]
    assert {(profile.reliability.name, profile.durability.name) for (profile,) in qos} == {
        ("RELIABLE", "VOLATILE")
    }


def test_recording_contains_mission_and_versions(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", [])
    with (tmp_path / "run.mcap").open("rb") as stream:
        reader = make_reader(stream)
        (about,) = reader.iter_metadata()
        assert reader.get_header().profile == "ros2"
    assert (about.metadata["mission"], about.metadata["law"]) == ("six-robots", "paper")
    assert parse(about.metadata["mission_file"]) == SIX
    assert about.metadata["eclipse-zenoh"]


def test_malformed_messages_are_recorded_unchanged(tmp_path: Path) -> None:
    rubbish = [b"", b"\xff" * 50, b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 8]
    record(tmp_path / "run.mcap", [Sample(ODOM.key("robot2"), payload, None, 10.0) for payload in rubbish])
    assert [message.data for _, _, message in read_by_mcap(tmp_path / "run.mcap")] == rubbish


def test_valid_stamps_are_read_in_both_byte_orders() -> None:
    assert stamp_of(encode(Displacement(12.5, 1 + 1j))) == 12_500_000_000
    assert stamp_of(bytes.fromhex("00000000 00000003 00000005")) == 3_000_000_005
    assert stamp_of(bytes.fromhex("00010000 ffffffff 00000000")) is None
    assert stamp_of(bytes.fromhex("00010000 00000000 ffffffff")) is None
    assert stamp_of(b"\0\1\0\0") is None


def test_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_text("dear")
    with pytest.raises(RecordingError, match=r"run\.mcap: exists already"):
        recorder(path)
    assert path.read_text() == "dear"


def test_unwritable_path_raises_recording_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match=r"--record .*/file/run\.mcap: .*/file is no folder"):
        recorder(tmp_path / "file" / "run.mcap")


def test_clock_before_epoch_does_not_end_recording(tmp_path: Path) -> None:
    with recorder(tmp_path / "run.mcap") as recording:
        recording.write(odometry("robot2", 10.0), -0.02)
        recording.write(odometry("robot2", 10.0), 1.0)
    assert [one.wall for one in read_back(tmp_path / "run.mcap").messages()] == [0.0, 1.0]


@given(text=st.text().filter(str.isprintable))
def test_attachment_is_packed_as_ros_2_string(text: str) -> None:
    data = packed_attachment(text.encode())
    assert data == encode(Text(text))
    assert decode(Text, data) == Text(text)
    assert unpacked_attachment(data) == text.encode()


@given(data=st.binary(max_size=40))
def test_invalid_string_unpacks_to_empty_attachment(data: bytes) -> None:
    assert isinstance(unpacked_attachment(data), bytes)
    assert unpacked_attachment(b"\0\1\0\0\xff\0\0\0" + data) == b""


def test_strings_of_other_writers_are_unpacked() -> None:
    assert unpacked_attachment(bytes.fromhex("00000000 00000003") + b"hi\0") == b"hi"
    assert unpacked_attachment(bytes.fromhex("00010001 03000000") + b"hi\0\0") == b"hi"


def test_attachment_that_is_no_text_is_left_out() -> None:
    assert [packed_attachment(one) for one in (b"\xff", b"\0", b"two\nlines", b"x" * 70_000)] == [None] * 4


def test_attachments_are_read_back_with_their_messages(tmp_path: Path) -> None:
    commands = [
        command("robot2", 10.0 + i / 20, 0.1, 0.0)._replace(attachment=b"%d" % i if i % 3 else None)
        for i in range(20)
    ]
    samples = sorted([*Fleet().positions(10.0, 11.0), *commands], key=lambda one: one.arrived)
    record(tmp_path / "run.mcap", samples)
    back = [one.sample for one in read_back(tmp_path / "run.mcap").messages()]
    assert [one[:3] for one in back] == [one[:3] for one in samples]
    assert all(one.attachment for one in back if one.key == POSITION.key(SIX.leader))


def test_attachment_precedes_its_message_with_same_times_and_number(tmp_path: Path) -> None:
    bare, attachments = command("robot2", 10.0, 0.1, 0.2), command("robot2", 10.5, 0.1, 0.2)
    record(tmp_path / "run.mcap", [bare, attachments._replace(attachment=b'{"n": 1}')])
    (_, _, first), (schema, channel, beside), (_, _, second) = read_by_mcap(tmp_path / "run.mcap")
    assert (first.sequence, beside.sequence, second.sequence) == (1, 2, 2)
    assert channel.topic == f"/{CMD_VEL.key('robot2')}/attached"
    assert schema is not None
    assert schema.name == "std_msgs/msg/String"
    assert decode(Text, beside.data) == Text('{"n": 1}')
    assert (beside.log_time, beside.publish_time) == (second.log_time, second.publish_time)


def test_topic_without_attachments_has_no_attachment_channel(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", [command("robot2", 10.0, 0.1, 0.2)])
    channels = summary_of(tmp_path / "run.mcap").channels.values()
    assert not [one.topic for one in channels if one.topic.endswith("/attached")]


def test_every_index_entry_points_to_its_message(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    samples = a_bit_of_everything()
    record(path, samples, flush=True)
    raw, entries = b"", 0
    with path.open("rb") as file:
        for one in records(file):
            body = ReadDataStream(io.BytesIO(one.body))
            if one.opcode == Opcode.CHUNK:
                raw = lz4.frame.decompress(ChunkRecord.read(body).data)
            elif one.opcode == Opcode.MESSAGE_INDEX:
                index = MessageIndex.read(body)
                for logged, at in index.records:
                    opcode, _, channel, _, found, _ = MESSAGE.unpack_from(raw, at)
                    assert (opcode, channel, found) == (Opcode.MESSAGE, index.channel_id, logged)
                    entries += 1
    assert entries == len(samples) + sum(sample.attachment is not None for sample in samples)


def test_burst_is_divided_into_small_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "CHUNK_BYTES", 50_000)
    path = tmp_path / "run.mcap"
    with recorder(path) as recording:
        for number in range(500):  # before any flush
            recording.write(odometry("robot2", 10.0 + number / 1000), EPOCH + 10.0 + number / 1000)
    found = chunks_of(path)
    assert len(found) > 5
    assert max(one.unpacked for one in found) < 100_000


class Full(io.FileIO):
    """A file on a disk with `room` free bytes."""

    room = 0

    def write(self, data: Any) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        done = super().write(memoryview(data)[: self.room])
        self.room -= done
        return done


@pytest.mark.parametrize("payload", [bytes(1_000_000), bytes(8_000_000), os.urandom(8_000_000)])
def test_messages_beside_long_ones_are_read_back(tmp_path: Path, payload: bytes) -> None:
    good = a_bit_of_everything()
    written = [*good[:20], sample_of_bytes(payload), *good[20:]]
    recording = record(tmp_path / "run.mcap", written)
    assert recording.lost == 0
    assert [one.sample.payload for one in read_back(tmp_path / "run.mcap").messages()] == [
        one.payload for one in written
    ]
    assert read_back(tmp_path / "run.mcap").condition().words == ""
    assert len(read_by_mcap(tmp_path / "run.mcap")) >= len(written)


def test_message_too_long_for_readers_is_counted_as_lost(tmp_path: Path) -> None:
    good, long = a_bit_of_everything(), sample_of_bytes(bytes(recorder_module.MAX_MESSAGE_BYTES + 1))
    recording = record(tmp_path / "run.mcap", [long, *good, long])
    assert recording.lost == 2
    assert [one.sample.payload for one in read_back(tmp_path / "run.mcap").messages()] == [
        one.payload for one in good
    ]
    assert len([one for one in recording.notices() if "not recorded: robot2/odom" in one.text]) == 1


def test_recording_deleted_before_its_end_is_lost(tmp_path: Path) -> None:
    with recorder(tmp_path / "run.mcap") as recording:
        for sample in a_bit_of_everything():
            recording.write(sample, sample.arrived + EPOCH)
        for moment in (10.0, 11.0):
            recording.flush(moment)
        assert recording._disk.catch_up(10.0)
        (tmp_path / "run.mcap").unlink()
    assert recording.lost == sum(1 if one.attachment is None else 2 for one in a_bit_of_everything())
    assert recording.recorded.total() == 0


def test_messages_that_cannot_be_forced_are_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with recorder(tmp_path / "run.mcap") as recording:
        monkeypatch.setattr(part_module, "_sync", fail)
        for sample in a_bit_of_everything():
            recording.write(sample, sample.arrived + EPOCH)
    assert recording.failure == os.strerror(errno.EIO)
    assert recording.lost == sum(1 if one.attachment is None else 2 for one in a_bit_of_everything())
    assert recording.recorded.total() == 0


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
    assert has_end(path)
    assert [len(one.messages) for one in chunks_of(path)] == [100, 100]


TIMES = st.integers(0, 2**62)
ENTRIES = st.builds(
    ChunkEntry,
    start=TIMES,
    end=TIMES,
    offset=TIMES,
    length=st.integers(CHUNK_HEAD_BYTES + 100, 2**40),
    unpacked=TIMES,
    codec=st.sampled_from(["lz4", "zstd", ""]),
    lengths=st.dictionaries(st.integers(0, 2**16 - 1), st.integers(15, 2**32 - 1), max_size=20),
)


@given(st.lists(ENTRIES, max_size=10))
def test_index_records_equal_mcap_chunk_index(entries: list[ChunkEntry]) -> None:
    index, expected = Index(), b""
    for one in entries:
        index.add(one)
        begins = accumulate(one.lengths.values(), initial=one.offset + one.length)
        record = ChunkIndex(
            message_start_time=one.start,
            message_end_time=one.end,
            chunk_start_offset=one.offset,
            chunk_length=one.length,
            message_index_offsets=dict(zip(one.lengths, begins, strict=False)),
            message_index_length=sum(one.lengths.values()),
            compression=one.codec,
            compressed_size=one.length - CHUNK_HEAD_BYTES - len(one.codec),
            uncompressed_size=one.unpacked,
        )
        expected += encoded(record)
    assert index.records() == expected
    assert (index.count, index.size) == (len(entries), len(expected))


def test_index_memory_is_below_a_twentieth_of_its_records() -> None:
    index = Index()
    for number in range(5000):
        start = 10**18 + number * 500_000_000
        lengths = {channel: 15 + 16 * (5 + (number + channel) % 2) for channel in range(1, 80)}
        index.add(ChunkEntry(start, start + 499_000_000, number * 60_000, 30_000, 80_000, "lz4", lengths))
    assert index.size == len(index.records())
    assert sum(map(len, index._packed)) < index.size / 20
    assert len(index._newest) < BLOCK_BYTES
