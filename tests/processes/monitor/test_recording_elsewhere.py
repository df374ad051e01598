"""Independent readers decode every message of every topic in recordings of real runs."""

from __future__ import annotations

import signal
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from formation.monitor.recording.channels import SUFFIX
from formation.monitor.recording.reader import extent_of, read
from formation.monitor.recording.recover import recover
from tests.processes.agent.actor import events, watching
from tests.processes.monitor.replayed import Run
from tests.support.recordings import has_end

pytestmark = pytest.mark.processes


@pytest.fixture(scope="module")
def topics(run_of_six: Run) -> Counter[str]:
    """Count the messages of a real run of six_robots by topic, as all readers do."""
    assert run_of_six.result["lost"] == 0
    return check([run_of_six.path])


def test_independent_readers_decode_six_robot_run(topics: Counter[str]) -> None:
    assert len(topics) > 30
    assert {topic for topic in topics if topic.startswith("/formation/")} == {
        "/formation/error",
        "/formation/diagnostics",
        "/formation/events",
    }
    assert topics["/robot1/position/attached"] == topics["/robot1/position"] > 50
    assert topics["/robot2/odom"] > 50


def test_independent_readers_decode_recovered_recording(
    run_of_six: Run, topics: Counter[str], tmp_path: Path
) -> None:
    run, cut, out = run_of_six.path, tmp_path / "cut.mcap", tmp_path / "out.mcap"
    cut.write_bytes(run.read_bytes()[: run.stat().st_size * 2 // 3])
    recover(cut, out)
    recovered = check([out])
    assert set(recovered) == set(topics)
    assert recovered.total() > 1000


def test_independent_readers_decode_recording_in_parts(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with watching("--record", str(path), "--rotate-size", "100kB", "--snapshots", "--no-page") as (
        child,
        actor,
    ):
        actor.play(2.5)
        actor.wait_until_recorded(path)
        child.signal(signal.SIGTERM)
        _, summary = events(child)
    parts = [Path(part) for part in summary["recording_parts"]]
    assert len(parts) > 1
    assert [part.stat().st_size <= 100_000 for part in parts] == [True] * len(parts)
    assert tuple(parts) == read(path).parts
    topics = check(parts)
    bare = {topic.removeprefix("/"): n for topic, n in topics.items() if not topic.endswith(SUFFIX)}
    assert bare == summary["recorded"] == read(path).extent().counts
    assert summary["recording_lost"] == 0
    for key, count in actor.published.items():
        assert summary["recorded"][key] == count


def check(parts: Iterable[Path]) -> Counter[str]:
    """Assert that three readers decode all of these files and agree; return message counts by topic."""
    found: Counter[str] = Counter()
    for path in parts:
        assert has_end(path)
        by_index, by_ros, by_bags = indexed(path), decoded_as_ros(path), decoded_as_bag(path)
        assert by_index == by_ros == by_bags
        found += by_index
        ours = {f"/{key}": count for key, count in extent_of(path).counts.items()}
        assert ours == {topic: count for topic, count in by_index.items() if not topic.endswith(SUFFIX)}
    return found


def indexed(path: Path) -> Counter[str]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        assert summary is not None
        assert summary.statistics is not None
        topics = [channel.topic for channel in summary.channels.values()]
        assert len(topics) == len(set(topics))
        assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        counted = Counter(channel.topic for _, channel, _ in reader.iter_messages())
        result = summary.statistics.channel_message_counts
        assert counted == Counter({summary.channels[number].topic: n for number, n in result.items()})
        return counted


def decoded_as_ros(path: Path) -> Counter[str]:
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return Counter(one.channel.topic for one in reader.iter_decoded_messages() if one.decoded_message)


def decoded_as_bag(path: Path) -> Counter[str]:
    with Reader(path) as bag:
        typestore = get_typestore(Stores.EMPTY)
        for connection in bag.connections:
            typestore.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        return Counter(
            connection.topic
            for connection, _, data in bag.messages()
            if typestore.deserialize_cdr(data, connection.msgtype)
        )
