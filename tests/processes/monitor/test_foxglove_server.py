from __future__ import annotations

import socket
import time
from collections.abc import Iterator

import pytest
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from formation.mission.file import load
from formation.monitor.exporters.foxglove import MAX_WAITING_MESSAGES, Foxglove
from formation.monitor.metrics.keys import OWN, watched
from formation.ros2.messages import LogEntry, Number, Pose, decode, encode
from formation.topics import ERROR, EVENTS, ODOM, POSITION
from formation.wire import Sample
from tests.support.foxglove_viewer import Message, Viewer, viewing
from tests.support.monitored import EPOCH, Fleet, command, odometry, sample_of, status

KEYS = (*watched(load("six_robots")), *OWN)


@pytest.fixture
def server() -> Iterator[Foxglove]:
    with Foxglove("127.0.0.1", 0, "formation: six-robots", KEYS) as one:
        yield one


def subscribed(server: Foxglove, viewer: Viewer, *topics: str) -> None:
    """Subscribe `viewer` to topics, and wait until the server has the subscriptions."""
    viewer.advertised(len(KEYS))
    viewer.subscribe(*topics)
    deadline = time.monotonic() + 30.0
    while not all(server._channels[topic[1:]].has_sinks() for topic in topics):
        assert time.monotonic() < deadline
        time.sleep(0.001)


def samples_of_all_kinds() -> list[Sample]:
    fleet = Fleet()
    return [
        *fleet.positions(10.0, 10.2),
        odometry("robot2", 10.0),
        command("robot2", 10.0, 0.1, 0.2),
        status("robot3", 10.1, "run", "in formation control"),
        fleet.truth("robot4", 10.1),
        sample_of(ERROR.key(), Number(0.25), 10.2),
        sample_of(EVENTS.key(), LogEntry(1010.2, 30, "robot3", "silent for 1.1 s", "lost"), 10.2),
    ]


def test_recorded_topics_are_advertised_read_only_with_schema(
    server: Foxglove,
) -> None:
    with viewing(server.address) as viewer:
        viewer.advertised(len(KEYS))
        assert viewer.info["name"] == "formation: six-robots"
        assert viewer.info["capabilities"] == []
        assert not viewer.info.get("supportedEncodings")
        assert set(viewer.channels) == {f"/{one.key}" for one in KEYS}
        for one in KEYS:
            channel = viewer.channels[f"/{one.key}"]
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
            assert channel["schemaName"] == one.topic.type
            get_typestore(Stores.EMPTY).register(get_types_from_msg(channel["schema"], one.topic.type))


def test_messages_arrive_unchanged_and_independent_reader_decodes_them(server: Foxglove) -> None:
    samples = samples_of_all_kinds()
    topics = sorted({f"/{sample.key}" for sample in samples})
    with viewing(server.address) as viewer:
        subscribed(server, viewer, *topics)
        for sample in samples:
            server.forward_sample(sample, sample.arrived + EPOCH)
        received = [viewer.receive() for _ in samples]
        assert received == [
            Message(f"/{s.key}", round((s.arrived + EPOCH) * 1e9), s.payload) for s in samples
        ]
        for reported in received:
            channel = viewer.channels[reported.topic]
            schema = Schema(1, channel["schema"].encode(), "ros2msg", channel["schemaName"])
            decoder = DecoderFactory().decoder_for("cdr", schema)
            assert decoder is not None
            message = decoder(reported.payload)
            if reported.topic == f"/{POSITION.key('robot1')}":
                place = decode(Pose, reported.payload).position
                assert complex(message.pose.position.x, message.pose.position.y) == place
            elif reported.topic == f"/{EVENTS.key()}":
                assert (message.msg, message.function, message.level) == ("silent for 1.1 s", "lost", 30)


def test_attachment_is_sent_on_its_own_topic(server: Foxglove) -> None:
    fleet = Fleet()
    beside = f"/{POSITION.key('robot1')}/attached"
    with viewing(server.address) as viewer:
        server.forward_sample(fleet.position("robot1", 10.0), 1010.0)
        viewer.advertised(len(KEYS) + 1)
        viewer.subscribe(beside)
        while not server._attached[POSITION.key("robot1")].has_sinks():
            time.sleep(0.001)
        sample = fleet.position("robot1", 10.05)
        server.forward_sample(sample, 1010.05)
        assert sample.attachment is not None
        assert sample.attachment in viewer.receive().payload


def test_requests_of_client_are_refused_and_server_continues(server: Foxglove) -> None:
    with viewing(server.address) as viewer:
        subscribed(server, viewer, f"/{ERROR.key()}")
        channel = {
            "id": 1,
            "topic": "/robot2/cmd_vel",
            "encoding": "cdr",
            "schemaName": "geometry_msgs/msg/Twist",
        }
        viewer.say(op="advertise", channels=[channel])
        viewer.connection.send(b"\x01\x01\x00\x00\x00" + command("robot2", 10.0, 0.3, 0.0).payload)
        viewer.say(op="setParameters", parameters=[{"name": "speed", "value": 1.0}])
        viewer.connection.send("no JSON")
        viewer.warned(4)  # a refusal for each
        assert {status["level"] for status in viewer.statuses} == {2}
        server.forward_sample(sample_of(ERROR.key(), Number(0.5), 10.0), 1010.0)
        assert viewer.receive().topic == f"/{ERROR.key()}"


def test_slow_client_delays_neither_server_nor_other_client(server: Foxglove) -> None:
    sample = odometry("robot2", 10.0)._replace(payload=bytes(4_000))
    last = sample_of(ERROR.key(), Number(0.5), 10.0)
    with viewing(server.address, max_queue=1) as slow, viewing(server.address) as viewer:
        subscribed(server, slow, f"/{ODOM.key('robot2')}")
        subscribed(server, viewer, f"/{ERROR.key()}")
        start = time.monotonic()
        for _ in range(2 * MAX_WAITING_MESSAGES):
            server.forward_sample(sample, 1010.0)
        spent = time.monotonic() - start
        server.forward_sample(last, 1010.0)
        assert viewer.receive().payload == last.payload
        assert spent < 10.0  # more than is kept, so most of it was dropped
        slow.connection.socket.shutdown(socket.SHUT_RDWR)


def test_forwarding_ignores_unknown_key_and_disconnected_client(server: Foxglove) -> None:
    with viewing(server.address) as viewer:
        subscribed(server, viewer, f"/{ERROR.key()}")
    server.forward_sample(Sample("elsewhere", b"", None, 10.0), 1010.0)
    for _ in range(100):
        server.forward_sample(sample_of(ERROR.key(), Number(0.5), 10.0), 1010.0)


def test_stop_closes_port_and_can_be_repeated(server: Foxglove) -> None:
    with viewing(server.address) as viewer:
        viewer.advertised(len(KEYS))
        start = time.monotonic()
        server.stop()
        server.stop()
        assert time.monotonic() - start < 5.0
        server.forward_sample(sample_of(ERROR.key(), Number(0.5), 10.0), 1010.0)
    with pytest.raises(OSError, match="refused"):
        connect_again(int(server.address.rpartition(":")[2]))


def connect_again(port: int) -> None:
    """Connect until refused, for at most 30 s: the server's own thread closes the socket."""
    deadline = time.monotonic() + 30.0
    while time.monotonic() < deadline:
        socket.create_connection(("127.0.0.1", port), timeout=30.0).close()


@pytest.mark.parametrize(
    ("host", "why"),
    [("127.0.0.1", "address already in use"), ("192.0.2.1", "cannot assign requested address")],
)
def test_unusable_address_is_an_error_with_reason(host: str, why: str) -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        with pytest.raises(OSError, match=why):
            Foxglove(host, holder.getsockname()[1], "taken", KEYS)


def test_malformed_payload_is_forwarded_unchanged(server: Foxglove) -> None:
    with viewing(server.address) as viewer:
        subscribed(server, viewer, f"/{ERROR.key()}")
        server.forward_sample(Sample(ERROR.key(), b"\xff" * 3, None, 10.0), 1010.0)
        server.forward_sample(Sample(ERROR.key(), encode(Number(1.0)), None, 10.0), 1010.0)
        assert [viewer.receive().payload, viewer.receive().payload] == [b"\xff" * 3, encode(Number(1.0))]
