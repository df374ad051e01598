from __future__ import annotations

import cmath
import math
import struct
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.ros2 import ros
from formation.ros2.messages import (
    Diagnostics,
    Displacement,
    LaserScan,
    LogEntry,
    Message,
    Number,
    Odometry,
    Pose,
    Status,
    Text,
    Twist,
    TwistStamped,
    decode,
    definition,
    encode,
    type_hash,
)
from formation.topics import TABLE
from tests.unit.formation import by_rosbags
from tests.unit.formation.examples import CLASSES, NOW, ODOMETRY, read, same

stamps = st.floats(1e7, 2**31 - 2)  # where a double resolves no less than a nanosecond
metres = st.floats(-1e6, 1e6)
positions = st.builds(complex, metres, metres)
rates = st.floats(-1e3, 1e3)
headings = st.floats(-math.pi, math.pi).map(lambda angle: cmath.rect(1.0, angle))
texts = st.text(st.characters(exclude_categories=("C", "Z")), max_size=20)
statuses = st.builds(
    Status, texts, st.integers(0, 3), texts, texts, st.dictionaries(texts, texts, max_size=5)
)
beams = st.floats(0.0, 100.0, width=32) | st.sampled_from((math.inf, -math.inf))
times = st.floats(0.0, 1.0, width=32)
scans = st.builds(
    LaserScan,
    stamps,
    st.floats(-4.0, 4.0, width=32),
    st.sampled_from((-0.125, 0.0625, 2.0**-7)),
    st.floats(0.0, 0.25, width=32),
    st.floats(0.5, 100.0, width=32),
    st.lists(beams, min_size=1, max_size=50).map(tuple),
    times,
    times,
    texts,
)
messages: st.SearchStrategy[Message] = st.one_of(
    st.builds(Odometry, stamps, positions, headings, rates, rates, texts, texts),
    st.builds(Twist, rates, rates),
    st.builds(TwistStamped, stamps, rates, rates, texts),
    st.builds(Pose, stamps, positions, headings, texts),
    st.builds(Displacement, stamps, positions, texts),
    st.builds(Number, st.floats(allow_nan=False, allow_infinity=False)),
    st.builds(LogEntry, stamps, st.sampled_from((10, 20, 30, 40, 50)), texts, texts, texts),
    st.builds(Text, texts),
    scans,
    st.builds(Diagnostics, stamps, st.lists(statuses, max_size=3).map(tuple)),
)


@given(messages)
def test_every_message_comes_back_as_it_was_sent(message: Message) -> None:
    payload = encode(message)
    assert payload[:4] == bytes((0, 1, 0, 0))
    assert same(read(message, payload), message)


@given(messages)
def test_every_message_survives_the_other_byte_order(message: Message) -> None:
    payload = by_rosbags.written(message, little_endian=False)
    assert same(read(message, payload), message)


@pytest.mark.parametrize(
    ("message", "size"),
    [
        (replace(ODOMETRY, frame="odom"), 724),
        (Twist(0.1, 0.2), 52),
        (Number(0.5), 12),
    ],
)
def test_payloads_have_the_sizes_that_a_ros_2_bridge_sends(message: Message, size: int) -> None:
    assert len(encode(message)) == size


def test_a_twist_has_the_bytes_that_cdr_says() -> None:
    assert encode(Twist(0.25, -1.5)) == bytes((0, 1, 0, 0)) + struct.pack("<6d", 0.25, 0, 0, 0, 0, -1.5)


def test_a_pose_has_the_bytes_that_cdr_says() -> None:
    header = struct.pack("<iII4s", 7, 500_000_000, 4, b"map\0")
    assert encode(Pose(7.5, 3 + 4j, -1 + 0j)) == bytes((0, 1, 0, 0)) + header + struct.pack(
        "<7d", 3, 4, 0, 0, 0, 1, 0
    )


@given(st.floats(-math.pi, math.pi))
def test_a_heading_is_the_turn_about_z(angle: float) -> None:
    half = math.sin(angle / 2), math.cos(angle / 2)
    assert ros.half_turn(cmath.rect(1.0, angle)) == pytest.approx(half, abs=1e-15)


@given(st.floats(-math.pi, math.pi), st.floats(-0.13, 0.13), st.floats(-0.13, 0.13))
def test_the_heading_of_a_slightly_tilted_robot_is_its_yaw(yaw: float, pitch: float, roll: float) -> None:
    turns = [(yaw, "z"), (pitch, "y"), (roll, "x")]
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    for angle, axis in turns:
        c, s = math.cos(angle / 2), math.sin(angle / 2)
        if axis == "z":
            w, x, y, z = w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s
        elif axis == "y":
            w, x, y, z = w * c - y * s, x * c - z * s, y * c + w * s, z * c + x * s
        else:
            w, x, y, z = w * c - x * s, x * c + w * s, y * c + z * s, z * c - y * s
    assert abs(ros.heading_of(x, y, z, w) - cmath.rect(1.0, yaw)) < 1e-12


def test_a_stamp_keeps_its_nanoseconds() -> None:
    assert decode(TwistStamped, encode(TwistStamped(12.345678901, 0, 0))).stamp == pytest.approx(
        12.345678901, abs=1e-9
    )
    assert decode(TwistStamped, encode(TwistStamped(0.9999999999, 0, 0))).stamp == 1.0


def test_drifted_heading_is_sent_with_unit_length() -> None:
    assert decode(Pose, encode(Pose(NOW, 0j, 1.005j))).heading == pytest.approx(1j, abs=1e-15)


def test_the_hashes_are_those_of_ros_2_jazzy() -> None:
    known = {
        "nav_msgs/msg/Odometry": "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
        "geometry_msgs/msg/Twist": "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
        "geometry_msgs/msg/TwistStamped": "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
        "geometry_msgs/msg/PoseStamped": "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
        "sensor_msgs/msg/LaserScan": "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    }
    assert {name: type_hash(name) for name in known} == {name: f"RIHS01_{h}" for name, h in known.items()}


def test_every_topic_type_has_message_and_definition() -> None:
    readable = {cls.ROS_TYPE for cls in CLASSES}
    named = {name for topic in TABLE for name in topic.types}
    assert named <= readable
    assert all(definition(name) for name in named)


@pytest.mark.parametrize("describe", [definition, type_hash])
def test_an_unknown_type_is_named(describe: Any) -> None:
    with pytest.raises(KeyError, match="nav_msgs/Odometry"):
        describe("nav_msgs/Odometry")
