from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from formation.mission.file import load, parse, read
from formation.mission.model import Mission
from formation.monitor.metrics.keys import OWN, watched
from formation.monitor.recording.channels import SUFFIX
from formation.monitor.recording.reader import read as read_back
from formation.monitor.recording.recorder import Recorder, RecordingError, stamp_of
from formation.monitor.recording.rotation import ROOM, ROTATION, Room, Rotation
from formation.ros2 import messages
from formation.ros2.messages import Displacement, Number, encode, type_hash
from formation.topics import ALIVE, CMD_VEL, ERROR, ODOM, POSITION, TABLE
from formation.wire import Sample
from tests.support.monitored import EPOCH, Fleet, command, odometry, sample_of, status

TEXT, _ = read("six_robots")
STORE = get_typestore(Stores.EMPTY)


def recorder(
    path: Path,
    mission: Mission | None = None,
    text: str = TEXT,
    rotation: Rotation = ROTATION,
    room: Room = ROOM,
) -> Recorder:
    mission = mission or load("six_robots")
    return Recorder(path, mission.name, text, "paper", (*watched(mission), *OWN), rotation, room)


def a_bit_of_everything() -> list[Sample]:
    fleet = Fleet()
    return [
        *fleet.positions(10.0, 11.0),
        *[odometry("robot2", 10.0 + i / 20) for i in range(20)],
        *[command("robot2", 10.0 + i / 20, 0.1, 0.2) for i in range(20)],
        status("robot3", 10.5, "run", "in formation control"),
        fleet.truth("robot4", 10.5),
        sample_of(ERROR.key(), Number(0.25), 10.6),
    ]


def test_recording_contains_received_messages_exactly_in_order(tmp_path: Path) -> None:
    samples = sorted(a_bit_of_everything(), key=lambda sample: sample.arrived)
    with recorder(tmp_path / "run.mcap") as recording:
        for sample in samples:
            recording.write(sample, sample.arrived + EPOCH)
    with (tmp_path / "run.mcap").open("rb") as stream:
        read_back = [
            (channel.topic, message)
            for _, channel, message in make_reader(stream).iter_messages()
            if not channel.topic.endswith(SUFFIX)
        ]
    assert [(topic, message.data) for topic, message in read_back] == [
        (f"/{s.key}", s.payload) for s in samples
    ]
    assert [message.log_time for _, message in read_back] == [
        round((s.arrived + EPOCH) * 1e9) for s in samples
    ]
    assert sum(recording.recorded.values()) == len(samples)
    assert recording.recorded[ODOM.key("robot2")] == 20


def test_publish_time_is_the_messages_stamp_where_it_has_one(tmp_path: Path) -> None:
    late = odometry("robot2", 10.0)._replace(arrived=10.25)
    unstamped = command("robot2", 10.5, 0.1, 0.2)
    with recorder(tmp_path / "run.mcap") as recording:
        for sample in (late, unstamped):
            recording.write(sample, sample.arrived + EPOCH)
    with (tmp_path / "run.mcap").open("rb") as stream:
        first, second = (message for _, _, message in make_reader(stream).iter_messages())
    assert (first.publish_time, first.log_time) == (1_010_000_000_000, 1_010_250_000_000)
    assert second.publish_time == second.log_time == 1_010_500_000_000


def test_every_topic_has_channel_with_ros_2_schema(tmp_path: Path) -> None:
    text = TEXT.replace("rate = 20 ", 'measurement = "local"\nlocalisation = "external"\nrate = 20 ')
    text += "\n[standbys.spare]\n"
    with recorder(tmp_path / "run.mcap", parse(text), text):
        pass
    with (tmp_path / "run.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert make_reader(stream).get_header().profile == "ros2"
    assert summary is not None
    kinds = {channel.topic.split("/", 2)[2].split("/")[0] for channel in summary.channels.values()}
    received = {topic.name for topic in TABLE if topic.type} - {ALIVE.name}  # which stays on the robot
    assert kinds == received
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg")
        # the text alone, without what this program knows of ROS, makes the type with ROS's own hash
        typestore = get_typestore(Stores.EMPTY)
        typestore.register(get_types_from_msg(schema.data.decode(), schema.name))
        assert typestore.hash_rihs01(schema.name) == type_hash(schema.name)
        assert channel.metadata["topic_type_hash"] == type_hash(schema.name)


@pytest.mark.parametrize("kind", ["twist", "twist_stamped"])
def test_commands_have_the_type_that_the_robot_takes(tmp_path: Path, kind: str) -> None:
    text = TEXT.replace("rate = 20 ", f'cmd_vel = "{kind}"\nrate = 20 ')
    with recorder(tmp_path / "run.mcap", parse(text), text) as recording:
        sample = command("robot2", 10.0, 0.1, 0.2, stamped=kind == "twist_stamped")
        recording.write(sample, sample.arrived)
    with (tmp_path / "run.mcap").open("rb") as stream:
        ((schema, channel, _),) = make_reader(stream).iter_messages()
    assert channel.topic == f"/{CMD_VEL.key('robot2')}"
    assert schema is not None
    assert (
        schema.name
        == {"twist": "geometry_msgs/msg/Twist", "twist_stamped": "geometry_msgs/msg/TwistStamped"}[kind]
    )


def test_another_reader_of_ros_2_bags_decodes_the_recording(tmp_path: Path) -> None:
    fleet = Fleet()
    samples = fleet.positions(10.0, 10.2)
    with recorder(tmp_path / "run.mcap") as recording:
        for sample in samples:
            recording.write(sample, sample.arrived + EPOCH)
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


def test_the_mission_and_the_versions_are_in_the_recording(tmp_path: Path) -> None:
    with recorder(tmp_path / "run.mcap"):
        pass
    with (tmp_path / "run.mcap").open("rb") as stream:
        (about,) = make_reader(stream).iter_metadata()
    assert about.metadata["mission"] == "six-robots"
    assert parse(about.metadata["mission_file"]) == load("six_robots")
    assert about.metadata["law"] == "paper"
    assert about.metadata["eclipse-zenoh"]


def test_malformed_messages_are_recorded_as_they_came(tmp_path: Path) -> None:
    rubbish = [b"", b"\xff" * 50, b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 8]
    with recorder(tmp_path / "run.mcap") as recording:
        for payload in rubbish:
            recording.write(Sample(ODOM.key("robot2"), payload, None, 10.0), 10.0)
    with (tmp_path / "run.mcap").open("rb") as stream:
        assert [message.data for _, _, message in make_reader(stream).iter_messages()] == rubbish


def test_valid_stamps_are_read_in_both_byte_orders() -> None:
    assert stamp_of(encode(Displacement(12.5, 1 + 1j))) == 12_500_000_000
    assert stamp_of(bytes.fromhex("00000000 00000003 00000005")) == 3_000_000_005
    assert stamp_of(bytes.fromhex("00010000 ffffffff 00000000")) is None
    assert stamp_of(bytes.fromhex("00010000 00000000 ffffffff")) is None
    assert stamp_of(b"\0\1\0\0") is None


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_text("dear")
    with pytest.raises(RecordingError, match=r"run\.mcap: exists already"):
        recorder(path)
    assert path.read_text() == "dear"


def test_a_path_that_cannot_be_written_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match=r"--record .*/file/run\.mcap: .*/file is no folder"):
        recorder(tmp_path / "file" / "run.mcap")


def test_clock_before_epoch_does_not_end_recording(tmp_path: Path) -> None:
    with recorder(tmp_path / "run.mcap") as recording:
        recording.write(odometry("robot2", 10.0), -0.02)
        recording.write(odometry("robot2", 10.0), 1.0)
    assert [one.ns for one in read_back(tmp_path / "run.mcap").messages()] == [0, 10**9]
