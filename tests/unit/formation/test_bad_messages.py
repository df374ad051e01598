from __future__ import annotations

import math
import random
import struct
import tracemalloc
from dataclasses import replace
from typing import Any

import pytest

from formation.ros2.messages import (
    MAX_PAYLOAD_BYTES,
    BadMessage,
    Diagnostics,
    Message,
    Number,
    Odometry,
    Pose,
    Status,
    Twist,
    decode,
    encode,
)
from tests.support.mutations import mutated
from tests.unit.formation.examples import CLASSES, EXAMPLES, NOW, ODOMETRY, same


def with_number(payload: bytes, index: int, number: float) -> bytes:
    """The payload with its last-but-`index` double replaced."""
    at = len(payload) - 8 * index
    return payload[:at] + struct.pack("<d", number) + payload[at + 8 :]


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, 1e7])
@pytest.mark.parametrize("index", range(1, 8))
def test_a_pose_with_a_number_that_cannot_be_is_refused(index: int, number: float) -> None:
    with pytest.raises(BadMessage, match="geometry_msgs/msg/PoseStamped"):
        decode(Pose, with_number(encode(Pose(NOW, 1 + 2j, 1j)), index, number))


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, 1.1e3])
@pytest.mark.parametrize("index", range(1, 7))
def test_a_twist_with_a_number_that_cannot_be_is_refused(index: int, number: float) -> None:
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
def test_an_orientation_that_is_no_heading_is_refused(quaternion: tuple[float, ...], reason: str) -> None:
    payload = encode(Pose(NOW, 0j, 1 + 0j))
    with pytest.raises(BadMessage, match=reason):
        decode(Pose, payload[:-32] + struct.pack("<4d", *quaternion))


@pytest.mark.parametrize(("seconds", "nanoseconds"), [(-1, 0), (5, 1_000_000_000), (5, 2**32 - 1)])
def test_a_stamp_that_is_no_time_is_refused(seconds: int, nanoseconds: int) -> None:
    payload = encode(ODOMETRY)
    with pytest.raises(BadMessage, match="stamp"):
        decode(Odometry, payload[:4] + struct.pack("<iI", seconds, nanoseconds) + payload[12:])


@pytest.mark.parametrize("cls", CLASSES)
@pytest.mark.parametrize("payload", [b"", b"\0\1\0\0", b"\0\1\0", b"\1\1\0\0" + bytes(800), b"{}", bytes(4)])
def test_an_empty_or_headless_payload_is_refused(cls: type[Any], payload: bytes) -> None:
    with pytest.raises(BadMessage, match="no CDR header"):
        decode(cls, payload)


def test_every_shorter_payload_is_refused() -> None:
    payload = encode(ODOMETRY)
    for length in range(len(payload)):
        with pytest.raises(BadMessage):
            decode(Odometry, payload[:length])


def test_trailing_bytes_are_refused_unless_they_are_padding() -> None:
    payload = encode(Twist(1.0, 2.0))
    assert decode(Twist, payload + bytes(3)) == Twist(1.0, 2.0)
    with pytest.raises(BadMessage, match="size mismatch"):
        decode(Twist, payload + bytes(4))


def test_one_type_is_not_taken_for_another() -> None:
    for example in EXAMPLES:
        for cls in CLASSES:
            if cls is not type(example):
                with pytest.raises(BadMessage):
                    decode(cls, encode(example))


@pytest.mark.parametrize("length", [0, 2**31, 2**32 - 1])
def test_a_lying_length_is_refused_before_anything_is_allocated(length: int) -> None:
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


def test_a_payload_beyond_all_reason_is_refused_unread() -> None:
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
def test_what_no_receiver_would_accept_is_not_sent(message: Message) -> None:
    with pytest.raises(BadMessage):
        encode(message)


def test_control_characters_reach_no_terminal() -> None:
    sent = Diagnostics(NOW, (Status("agent", 2, "line\nline \x1b[2J \ud800", values={"\0": "\r"}),))
    received = decode(Diagnostics, encode(sent)).statuses[0]
    assert received.message == "line line  [2J  "
    assert received.values == {" ": " "}
    forged = encode(Diagnostics(NOW, (Status("agent", 2, "AAAA"),))).replace(b"AAAA", b"\x1b[2J")
    with pytest.raises(BadMessage, match="control character"):
        decode(Diagnostics, forged)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: type(example).__name__)
def test_mutated_payloads_are_read_as_something_sendable_or_refused(example: Message) -> None:
    cls: type[Any] = type(example)
    corpus = [encode(other) for other in EXAMPLES] + [encode(example)] * len(EXAMPLES)
    rng = random.Random(f"fuzz {cls.__name__}")
    accepted = refused = 0
    for _ in range(4000):
        payload = mutated(rng, corpus)
        try:
            message = decode(cls, payload)
        except BadMessage:
            refused += 1
        else:
            accepted += 1
            assert same(decode(cls, encode(message)), message)
    assert accepted > 100
    assert refused > 2000
