"""What is written and read here is, byte for byte and bit for bit, what rosbags writes and reads."""

from __future__ import annotations

import random
import struct
import tracemalloc
from dataclasses import fields
from typing import Any

import pytest
from hypothesis import given

from formation.ros2.messages import (
    BadMessage,
    Diagnostics,
    LogEntry,
    Message,
    Odometry,
    Pose,
    Status,
    TwistStamped,
    decode,
    definition,
    encode,
    type_hash,
)
from formation.ros2.ros import BY_TYPE
from formation.topics import TABLE
from tests.support.mutations import mutated
from tests.unit.formation import by_rosbags
from tests.unit.formation.examples import CLASSES, EXAMPLES, NOW, read, same
from tests.unit.formation.test_messages import messages

CORPUS = {type(one): encode(one) for one in EXAMPLES}


def outcome(cls: type[Any], payload: bytes) -> tuple[Any, ...] | None:
    """A message's fields; None if it is bad."""
    try:
        message = decode(cls, payload)
    except BadMessage:
        return None
    return tuple(getattr(message, field.name) for field in fields(message))


@given(messages)
def test_a_message_has_the_bytes_that_rosbags_gives_it(message: Message) -> None:
    assert encode(message) == by_rosbags.written(message)


@pytest.mark.parametrize("length", range(40))
def test_so_it_has_with_names_of_any_length(length: int) -> None:
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
@pytest.mark.parametrize("seed", range(4))
def test_whatever_the_bytes_rosbags_would_read_the_same(cls: type[Any], seed: int) -> None:
    rng, accepted = random.Random(seed), 0
    corpus = [CORPUS[cls], *CORPUS.values(), CORPUS[cls], CORPUS[cls]]
    corpus += [by_rosbags.written(one, little_endian=False) for one in EXAMPLES if type(one) is cls]
    for _ in range(3000):
        payload = mutated(rng, corpus)
        found = outcome(cls, payload)
        assert repr(found) == repr(by_rosbags.read(cls, payload))
        accepted += found is not None
    assert accepted > 100  # or this has shown little


def test_any_pose_is_decoded_exactly() -> None:
    rng = random.Random(5)
    for _ in range(2000):
        numbers = [rng.uniform(-1e6, 1e6), rng.uniform(-1e6, 1e6), 0.0, rng.gauss(0.0, 0.01), 0.01]
        z = rng.uniform(-1.0, 1.0)
        numbers += [z, (1.0 - z * z) ** 0.5]
        payload = CORPUS[Pose][:-56] + struct.pack("<7d", *numbers)
        assert repr(outcome(Pose, payload)) == repr(by_rosbags.read(Pose, payload))


def test_long_texts_of_strangers_are_not_kept() -> None:
    tracemalloc.start()
    try:
        for number in range(300):
            decode(Pose, encode(Pose(NOW, 0j, 1 + 0j, f"{number:05d}" * 10_000)))
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 1_000_000


def test_the_hashes_of_all_types_are_those_that_rosbags_finds() -> None:
    assert BY_TYPE.keys() == {name for topic in TABLE for name in topic.types}
    assert all(type_hash(name) == by_rosbags.STORE.hash_rihs01(name) for name in BY_TYPE)


def test_the_definitions_of_all_types_are_those_that_rosbags_has() -> None:
    for name in {name for topic in TABLE for name in topic.types}:
        assert definition(name) == by_rosbags.STORE.generate_msgdef(name, ros_version=2)[0]
