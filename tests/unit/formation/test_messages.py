"""ROS 2 messages: the same bytes as from rosbags; impossible messages are refused."""

from __future__ import annotations

import cmath
import math
import random
import struct
import tracemalloc
from dataclasses import fields, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.ros2 import ros
from formation.ros2.definitions import definition, type_hash
from formation.ros2.goal_status import GoalStatus
from formation.ros2.messages import (
    MAX_PAYLOAD_BYTES,
    BadMessage,
    Diagnostics,
    Displacement,
    GoalStatuses,
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
    encode,
)
from formation.ros2.ros import BY_TYPE
from formation.topics import TABLE
from tests.support.examples import slow
from tests.support.mutations import mutated
from tests.unit.formation import by_rosbags
from tests.unit.formation.examples import CLASSES, EXAMPLES, NOW, ODOMETRY, read, same

stamps = st.floats(1e7, 2**31 - 2)  # where doubles are over a nanosecond apart
metres = st.floats(-1e6, 1e6)
positions = st.builds(complex, metres, metres)
rates = st.floats(-1e3, 1e3)
headings = st.floats(-math.pi, math.pi).map(lambda angle: cmath.rect(1.0, angle))
texts = st.text(st.characters(exclude_categories=("C", "Z")), max_size=20)
statuses = st.builds(
    Status, texts, st.integers(0, 3), texts, texts, st.dictionaries(texts, texts, max_size=5)
)
goals = st.tuples(st.binary(min_size=16, max_size=16), st.sampled_from(GoalStatus))
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
    st.builds(GoalStatuses, st.lists(goals, max_size=3).map(tuple)),
    scans,
    st.builds(Diagnostics, stamps, st.lists(statuses, max_size=3).map(tuple)),
)


@given(messages)
def test_decode_inverts_encode_for_every_message(message: Message) -> None:
    payload = encode(message)
    assert payload[:4] == bytes((0, 1, 0, 0))
    assert same(read(message, payload), message)


@given(messages)
def test_big_endian_message_is_decoded(message: Message) -> None:
    payload = by_rosbags.written(message, little_endian=False)
    assert same(read(message, payload), message)


@given(st.floats(-math.pi, math.pi))
def test_half_turn_of_heading_is_rotation_about_z(angle: float) -> None:
    half = math.sin(angle / 2), math.cos(angle / 2)
    assert ros.half_turn(cmath.rect(1.0, angle)) == pytest.approx(half, abs=1e-15)


@given(st.floats(-math.pi, math.pi), st.floats(-0.13, 0.13), st.floats(-0.13, 0.13))
def test_heading_of_slightly_tilted_robot_is_its_yaw(yaw: float, pitch: float, roll: float) -> None:
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


def test_stamp_keeps_nanoseconds() -> None:
    assert decode(TwistStamped, encode(TwistStamped(12.345678901, 0, 0))).stamp == pytest.approx(
        12.345678901, abs=1e-9
    )
    assert decode(TwistStamped, encode(TwistStamped(0.9999999999, 0, 0))).stamp == 1.0


def test_drifted_heading_is_encoded_with_unit_length() -> None:
    assert decode(Pose, encode(Pose(NOW, 0j, 1.005j))).heading == pytest.approx(1j, abs=1e-15)


@pytest.mark.parametrize("describe", [definition, type_hash])
def test_error_names_unknown_type(describe: Any) -> None:
    with pytest.raises(KeyError, match="nav_msgs/Odometry"):
        describe("nav_msgs/Odometry")


CORPUS = {type(one): encode(one) for one in EXAMPLES}


def outcome(cls: type[Any], payload: bytes) -> tuple[Any, ...] | None:
    """The fields of the decoded message; None if it is refused."""
    try:
        message = decode(cls, payload)
    except BadMessage:
        return None
    assert same(decode(cls, encode(message)), message), "a decoded message can be encoded"
    return tuple(getattr(message, field.name) for field in fields(message))


@given(messages)
def test_encode_gives_same_bytes_as_rosbags(message: Message) -> None:
    assert encode(message) == by_rosbags.written(message)


@pytest.mark.parametrize("length", range(40))
def test_messages_with_texts_of_any_length_match_rosbags(length: int) -> None:
    name, other = "f" * length, "child" * length
    statuses = (Status(name, 1, other, name, {name: other, other: ""}), Status(other, 0, ""))
    longer: tuple[Message, ...] = (
        Odometry(NOW, 1 - 2j, 1j, 0.2, -0.5, name, other),
        Pose(NOW, 3 - 4j, 1 + 0j, name),
        TwistStamped(NOW, 0.1, -0.2, name),
        Diagnostics(NOW, statuses),
        LogEntry(NOW, 20, name, other, name),
    )
    for message in longer:
        payload = encode(message)
        assert payload == by_rosbags.written(message)
        assert same(read(message, payload), message)


@pytest.mark.parametrize("cls", CLASSES)
@pytest.mark.parametrize("seed", [0, *slow(1, 2, 3)])
def test_decode_agrees_with_rosbags_on_mutated_payloads(cls: type[Any], seed: int) -> None:
    rng, accepted = random.Random(seed), 0
    corpus = [CORPUS[cls], *CORPUS.values(), CORPUS[cls], CORPUS[cls]]
    corpus += [by_rosbags.written(one, little_endian=False) for one in EXAMPLES if type(one) is cls]
    for _ in range(3000):
        payload = mutated(rng, corpus)
        found = outcome(cls, payload)
        assert repr(found) == repr(by_rosbags.read(cls, payload))
        accepted += found is not None
    assert 100 < accepted < 2000  # both outcomes occur often


def test_decoded_long_texts_are_not_kept_in_memory() -> None:
    tracemalloc.start()
    try:
        for number in range(300):
            decode(Pose, encode(Pose(NOW, 0j, 1 + 0j, f"{number:05d}" * 10_000)))
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 1_000_000


def test_type_hashes_match_rosbags() -> None:
    read_by_follow = {"nav_msgs/msg/Path", "action_msgs/msg/GoalStatusArray"}
    assert BY_TYPE.keys() == {name for topic in TABLE for name in topic.types} | read_by_follow
    assert all(type_hash(name) == by_rosbags.STORE.hash_rihs01(name) for name in BY_TYPE)


def test_type_definitions_match_rosbags() -> None:
    for name in BY_TYPE:
        assert definition(name) == by_rosbags.STORE.generate_msgdef(name, ros_version=2)[0]


def with_number(payload: bytes, index: int, number: float) -> bytes:
    """The payload with its `index`-th double from the end replaced."""
    at = len(payload) - 8 * index
    return payload[:at] + struct.pack("<d", number) + payload[at + 8 :]


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, 1e7])
@pytest.mark.parametrize("index", range(1, 8))
def test_pose_with_impossible_number_is_refused(index: int, number: float) -> None:
    with pytest.raises(BadMessage, match="geometry_msgs/msg/PoseStamped"):
        decode(Pose, with_number(encode(Pose(NOW, 1 + 2j, 1j)), index, number))


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, 1.1e3])
@pytest.mark.parametrize("index", range(1, 7))
def test_twist_with_impossible_number_is_refused(index: int, number: float) -> None:
    with pytest.raises(BadMessage, match=r"(speed|turn rate) is"):
        decode(Twist, with_number(encode(Twist(0.1, 0.2)), index, number))


@pytest.mark.parametrize(
    ("quaternion", "reason"),
    [
        ((0, 0, 0, 0), "length 0"),
        ((0, 0, 0, 1.1), "length 1.1"),
        ((1, 0, 0, 0), "tilted by 3.14"),
        ((0.2, 0, 0, math.sqrt(0.96)), "tilted by 0.40"),
    ],
)
def test_tilted_or_unnormalised_orientation_is_refused(quaternion: tuple[float, ...], reason: str) -> None:
    payload = encode(Pose(NOW, 0j, 1 + 0j))
    with pytest.raises(BadMessage, match=reason):
        decode(Pose, payload[:-32] + struct.pack("<4d", *quaternion))


@pytest.mark.parametrize(("seconds", "nanoseconds"), [(-1, 0), (5, 1_000_000_000), (5, 2**32 - 1)])
def test_impossible_stamp_is_refused(seconds: int, nanoseconds: int) -> None:
    payload = encode(ODOMETRY)
    with pytest.raises(BadMessage, match="stamp"):
        decode(Odometry, payload[:4] + struct.pack("<iI", seconds, nanoseconds) + payload[12:])


@pytest.mark.parametrize("cls", CLASSES)
@pytest.mark.parametrize("payload", [b"", b"\0\1\0\0", b"\0\1\0", b"\1\1\0\0" + bytes(800), b"{}", bytes(4)])
def test_payload_without_cdr_header_is_refused(cls: type[Any], payload: bytes) -> None:
    with pytest.raises(BadMessage, match="no CDR header"):
        decode(cls, payload)


@pytest.mark.parametrize("length", [0, 2**31, 2**32 - 1])
def test_wrong_length_field_allocates_little_memory(length: int) -> None:
    payload = bytearray(encode(Diagnostics(NOW, (Status("agent", 0, "running", values={"a": "b"}),))))
    for at in range(12, len(payload) - 4, 4):
        lying = payload[:at] + struct.pack("<I", length) + payload[at + 4 :]
        tracemalloc.start()
        try:
            decode(Diagnostics, bytes(lying))
        except BadMessage:
            pass
        finally:
            _, peak = tracemalloc.get_traced_memory()
            tracemalloc.stop()
        assert peak < 100_000


def test_payload_above_max_payload_bytes_is_refused() -> None:
    with pytest.raises(BadMessage, match=f"at most {MAX_PAYLOAD_BYTES}"):
        decode(Diagnostics, b"\0\1\0\0" + bytes(MAX_PAYLOAD_BYTES))
    with pytest.raises(BadMessage, match=f"at most {MAX_PAYLOAD_BYTES}"):
        encode(Diagnostics(NOW, (Status("agent", 0, "x" * MAX_PAYLOAD_BYTES),)))


@pytest.mark.parametrize(
    "message",
    [
        Twist(math.nan, 0.0),
        Twist(0.0, math.inf),
        Twist(1.1e3, 0.0),
        replace(ODOMETRY, position=complex(math.nan, 0)),
        replace(ODOMETRY, position=2e6 + 0j),
        replace(ODOMETRY, heading=0j),
        replace(ODOMETRY, heading=complex(math.nan, math.nan)),
        replace(ODOMETRY, heading=1.2 + 0j),
        replace(ODOMETRY, stamp=-1.0),
        replace(ODOMETRY, stamp=math.nan),
        replace(ODOMETRY, stamp=2.0**31),
        Number(math.inf),
        Diagnostics(NOW, (Status("agent", 4, ""),)),
    ],
)
def test_encode_refuses_message_with_impossible_value(message: Message) -> None:
    with pytest.raises(BadMessage):
        encode(message)


def test_encode_replaces_and_decode_refuses_control_characters() -> None:
    sent = Diagnostics(NOW, (Status("agent", 2, "line\nline \x1b[2J \ud800", values={"\0": "\r"}),))
    received = decode(Diagnostics, encode(sent)).statuses[0]
    assert received.message == "line line  [2J  "
    assert received.values == {" ": " "}
    forged = encode(Diagnostics(NOW, (Status("agent", 2, "AAAA"),))).replace(b"AAAA", b"\x1b[2J")
    with pytest.raises(BadMessage, match="control character"):
        decode(Diagnostics, forged)
