"""What is read without a detour is what the full reader reads, and what is refused is refused by that one."""

from __future__ import annotations

import random
import struct
from typing import Any

import pytest

from formation.ros2.messages import (
    _QUICK,
    BadMessage,
    Odometry,
    Pose,
    TwistStamped,
    _decode_any,
    decode,
    encode,
)
from tests.formation.examples import EXAMPLES, NOW
from tests.formation.mutations import mutated

CORPUS = {type(one): encode(one) for one in EXAMPLES}
READERS = list(_QUICK)


def outcome(read: Any, cls: type[Any], payload: bytes) -> Any:
    """A message, or why it is bad."""
    try:
        return read(cls, payload)
    except BadMessage as bad:
        return str(bad)


@pytest.mark.parametrize("cls", READERS)
def test_a_message_as_everybody_spells_it_is_read_quickly(cls: type[Any]) -> None:
    fields = _QUICK[cls](CORPUS[cls])
    assert fields is not None
    assert cls(*fields) == _decode_any(cls, CORPUS[cls])


@pytest.mark.parametrize("cls", READERS)
@pytest.mark.parametrize("seed", range(4))
def test_whatever_the_bytes_the_full_reader_would_say_the_same(cls: type[Any], seed: int) -> None:
    rng, quickly = random.Random(seed), 0
    corpus = [CORPUS[cls], *CORPUS.values(), CORPUS[cls], CORPUS[cls]]
    for _ in range(4000):
        payload = mutated(rng, corpus)
        assert repr(outcome(decode, cls, payload)) == repr(outcome(_decode_any, cls, payload))
        quickly += _QUICK[cls](payload) is not None
    assert quickly > 100  # or this has shown little


@pytest.mark.parametrize("length", range(40))
def test_names_of_frames_of_any_length_are_read_where_they_end(length: int) -> None:
    frame, child = "f" * length, "child" * length
    messages = (
        Odometry(NOW, 1 - 2j, 1j, 0.2, -0.5, frame, child),
        Pose(NOW, 3 - 4j, 1 + 0j, frame),
        TwistStamped(NOW, 0.1, -0.2, frame),
    )
    for message in messages:
        cls: type[Any] = type(message)
        fields = _QUICK[cls](encode(message))
        assert fields is not None
        assert cls(*fields) == _decode_any(cls, encode(message))


def test_any_heading_and_any_place_comes_out_the_same_to_the_last_bit() -> None:
    rng = random.Random(5)
    for _ in range(2000):
        numbers = [
            rng.uniform(-1e6, 1e6),
            rng.uniform(-1e6, 1e6),
            0.0,
            *(rng.gauss(0.0, 0.01) for _ in range(2)),
        ]
        z = rng.uniform(-1.0, 1.0)
        numbers += [z, (1.0 - z * z) ** 0.5]
        payload = CORPUS[Pose][:-56] + struct.pack("<7d", *numbers)
        assert repr(outcome(decode, Pose, payload)) == repr(outcome(_decode_any, Pose, payload))


def test_big_endian_messages_take_the_long_way_and_arrive() -> None:
    little = CORPUS[Pose]
    head = struct.unpack("<iII4s", little[4:20])
    big = b"\0\0\0\0" + struct.pack(">iII4s", *head) + struct.pack(">7d", *struct.unpack("<7d", little[20:]))
    assert _QUICK[Pose](big) is None
    assert decode(Pose, big) == decode(Pose, little)
