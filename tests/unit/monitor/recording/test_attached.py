from __future__ import annotations

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from formation.mission.file import load
from formation.monitor.recording.channels import packed, unpacked
from formation.monitor.recording.reader import read
from formation.ros2.messages import Text, decode, encode
from formation.topics import CMD_VEL, POSITION
from formation.wire import Sample
from tests.support.monitored import EPOCH, Fleet, command
from tests.unit.monitor.recording.test_recorder import recorder


def record(path: Path, samples: list[Sample]) -> None:
    with recorder(path) as recording:
        for sample in samples:
            recording.write(sample, sample.arrived + EPOCH)


@given(text=st.text().filter(str.isprintable))
def test_an_attachment_becomes_a_string_of_ros_2(text: str) -> None:
    data = packed(text.encode())
    assert data == encode(Text(text))
    assert decode(Text, data) == Text(text)
    assert unpacked(data) == text.encode()


@given(data=st.binary(max_size=40))
def test_what_is_no_string_has_no_attachment(data: bytes) -> None:
    assert isinstance(unpacked(data), bytes)
    assert unpacked(b"\0\1\0\0\xff\0\0\0" + data) == b""


def test_a_string_that_others_wrote_has_one() -> None:
    assert unpacked(bytes.fromhex("00000000 00000003") + b"hi\0") == b"hi"
    assert unpacked(bytes.fromhex("00010001 03000000") + b"hi\0\0") == b"hi"


def test_what_is_no_text_is_left_out() -> None:
    assert [packed(one) for one in (b"\xff", b"\0", b"two\nlines", b"x" * 70_000)] == [None] * 4


def test_attachments_come_back_on_the_messages_they_rode_on(tmp_path: Path) -> None:
    samples = sorted(
        [
            *Fleet().positions(10.0, 11.0),
            *[
                command("robot2", 10.0 + i / 20, 0.1, 0.0)._replace(attachment=b"%d" % i if i % 3 else None)
                for i in range(20)
            ],
        ],
        key=lambda one: one.arrived,
    )
    record(tmp_path / "run.mcap", samples)
    back = [one.sample for one in read(tmp_path / "run.mcap").messages()]
    assert [one[:3] for one in back] == [one[:3] for one in samples]
    leader = POSITION.key(load("six_robots").leader)
    assert all(one.attachment for one in back if one.key == leader)


def test_each_stands_just_before_its_message_with_its_times_and_number(tmp_path: Path) -> None:
    bare, attachments = command("robot2", 10.0, 0.1, 0.2), command("robot2", 10.5, 0.1, 0.2)
    record(tmp_path / "run.mcap", [bare, attachments._replace(attachment=b'{"n": 1}')])
    with (tmp_path / "run.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        first, beside, second = reader.iter_decoded_messages(log_time_order=False)
    assert (first.message.sequence, beside.message.sequence, second.message.sequence) == (1, 2, 2)
    assert beside.channel.topic == f"/{CMD_VEL.key('robot2')}/attached"
    assert beside.schema is not None
    assert beside.schema.name == "std_msgs/msg/String"
    assert beside.decoded_message.data == '{"n": 1}'
    assert (beside.message.log_time, beside.message.publish_time) == (
        second.message.log_time,
        second.message.publish_time,
    )


def test_topics_on_which_nothing_rides_have_none_beside_them(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", [command("robot2", 10.0, 0.1, 0.2)])
    with (tmp_path / "run.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert not [one.topic for one in summary.channels.values() if one.topic.endswith("/attached")]
