from __future__ import annotations

import os
import signal
import time

import pytest

from formation.topics import CMD_VEL, ODOM, POSITION
from formation.transport.bus import CLOSE_TIMEOUT_SECONDS, Bus, BusConfig, BusError
from formation.transport.bus_config import THREADS
from tests.processes.formation.bus_peer import MESSAGES
from tests.support.bus_tools import COMMAND, ODOMETRY, PLACE, REQUESTED, answers, collect, serving
from tests.support.child import PATIENCE, free_endpoint, started, until
from tests.support.zenoh_admin import inspect

pytestmark = pytest.mark.processes
PEER = "tests.processes.formation.bus_peer"
ADMIN_SPACE = "@/*/peer"
"""Answered by Zenoh, once for each session."""


def test_each_dial_makes_one_link_and_no_peer_relays(endpoint: str) -> None:
    other = free_endpoint()
    with (
        Bus(BusConfig(listen=(endpoint,), name="left")) as left,
        Bus(BusConfig(connect=(endpoint,), listen=(other,), name="middle")) as middle,
        Bus(BusConfig(connect=(other,))) as right,
    ):
        left.advertise(ODOM, ODOMETRY)
        middle.advertise(CMD_VEL, COMMAND)
        middle.subscribe(ODOMETRY)
        right.subscribe(ODOMETRY)
        right.subscribe(COMMAND)
        until(lambda: left.watched(ODOMETRY) and middle.watched(COMMAND))
        left.publish(ODOMETRY, b"from the left")
        collect(middle, 1)
        middle.publish(COMMAND, b"from the middle")
        assert [sample.payload for sample in collect(right, 1)] == [b"from the middle"]
        seen = inspect(endpoint), inspect(other)
        assert [peer.name for peer in seen] == ["left", "middle"]
        assert [sorted(peer.links.values()) for peer in seen] == [[1], [1, 1]]
        assert seen[0].subscriptions == set()
        assert seen[1].subscriptions == {ODOMETRY}


def test_messages_published_just_before_closing_arrive(endpoint: str) -> None:
    with Bus(BusConfig(listen=(endpoint,))) as bus:
        bus.subscribe(ODOMETRY)
        with started(PEER, "burst", endpoint) as child:
            samples = collect(bus, MESSAGES)
            assert child.wait() == 0
        assert [int.from_bytes(sample.payload, "little") for sample in samples] == list(range(MESSAGES))


def test_process_with_failing_main_loop_ends(endpoint: str) -> None:
    with started(PEER, "failing", endpoint) as child, Bus(BusConfig(connect=(endpoint,))) as bus:
        child.event("ready")
        bus.advertise(ODOM, ODOMETRY)
        until(lambda: bus.watched(ODOMETRY))
        bus.publish(ODOMETRY, b"x")
        assert child.wait() == 1
        assert "RuntimeError: the main loop failed" in child.errors


def test_absent_peer_delays_no_start_and_reconnects(endpoint: str) -> None:
    start = time.monotonic()
    with Bus(BusConfig(connect=(endpoint,))) as bus:
        assert time.monotonic() - start < 0.4
        bus.advertise(ODOM, ODOMETRY)
        for _ in range(2):
            with started(PEER, "listener", endpoint) as child:
                child.event("ready")
                assert until(lambda: bus.watched(ODOMETRY)) < 3.0
                child.signal(signal.SIGKILL)
                assert until(lambda: not bus.watched(ODOMETRY)) < 1.0


def test_hanging_peer_blocks_neither_sending_nor_closing(
    endpoint: str, caplog: pytest.LogCaptureFixture
) -> None:
    slowest, other = 0.0, free_endpoint()
    with started(PEER, "listener", endpoint) as child, Bus(BusConfig(connect=(endpoint,))) as bus:
        child.event("ready")
        bus.advertise(ODOM, ODOMETRY)
        until(lambda: bus.watched(ODOMETRY))
        os.kill(child.process.pid, signal.SIGSTOP)
        stopped = time.monotonic()
        while bus.watched(ODOMETRY) and time.monotonic() < stopped + PATIENCE:
            start = time.perf_counter()
            bus.publish(ODOMETRY, bytes(724))
            slowest = max(slowest, time.perf_counter() - start)
        assert time.monotonic() - stopped < 5.0
        os.kill(child.process.pid, signal.SIGCONT)
        until(lambda: bus.watched(ODOMETRY))
    assert "did not close" not in caplog.text
    with started(PEER, "patient", other) as child:  # the link to it is not given up before it is closed
        child.event("ready")
        with Bus(BusConfig(connect=(other,))) as bus:
            bus.advertise(ODOM, ODOMETRY)
            until(lambda: bus.watched(ODOMETRY))
            os.kill(child.process.pid, signal.SIGSTOP)
            for _ in range(5000):
                bus.publish(ODOMETRY, bytes(724))
            start = time.perf_counter()
        assert time.perf_counter() - start < CLOSE_TIMEOUT_SECONDS + 1.0
    assert "did not close" in caplog.text
    assert slowest < 0.5


def test_teams_of_different_namespaces_receive_nothing_of_each_other(endpoint: str) -> None:
    with (
        Bus(BusConfig(listen=(endpoint,), namespace="red", name="here")) as here,
        Bus(BusConfig(connect=(endpoint,), namespace="red")) as mate,
        Bus(BusConfig(connect=(endpoint,), namespace="blue/one")) as stranger,
    ):
        here.subscribe(ODOMETRY)
        here.answer(REQUESTED, lambda request, _: request)
        mate.advertise(ODOM, ODOMETRY)
        stranger.advertise(ODOM, ODOMETRY)
        until(lambda: mate.watched(ODOMETRY) and len(inspect(endpoint).links) == 2)
        stranger.publish(ODOMETRY, b"blue")
        mate.publish(ODOMETRY, b"red")
        assert [sample[:2] for sample in collect(here, 1)] == [(ODOMETRY, b"red")]
        with serving(here):
            assert [reply.key for reply in answers(mate, REQUESTED, b"?", 1)] == [REQUESTED]
            assert stranger.ask(REQUESTED, b"?", 0.2) == []
        assert not stranger.watched(ODOMETRY)
        assert here.received == {ODOMETRY: 1}
        assert inspect(endpoint).subscriptions == {f"red/{ODOMETRY}"}


def test_oversized_message_is_dropped_and_link_survives(pair: tuple[Bus, Bus]) -> None:
    here, there = pair
    here.subscribe(PLACE)
    there.advertise(POSITION, PLACE, waits=True)  # else the sender may drop both, its queue being full
    until(lambda: there.watched(PLACE))
    there.publish(PLACE, bytes(4 << 20))
    there.publish(PLACE, b"after")
    assert [sample.payload for sample in collect(here, 1)] == [b"after"]


def test_burst_of_zenoh_queries_stops_no_process(endpoint: str) -> None:
    with started(PEER, "listener", endpoint) as child, Bus(BusConfig(connect=(endpoint,))) as bus:
        child.event("ready")
        until(lambda: len(bus.ask(ADMIN_SPACE, b"", 1.0)) == 2)
        questions = [bus.question(ADMIN_SPACE, b"", PATIENCE) for _ in range(100)]
        until(lambda: all(question.over for question in questions))
        assert {len(question.replies) for question in questions} == {2}


def test_session_starts_at_most_three_threads(endpoint: str) -> None:
    with Bus(BusConfig(listen=(endpoint,))) as bus, started(PEER, "neighbourly", endpoint) as child:
        bus.advertise(ODOM, ODOMETRY)
        until(lambda: bus.watched(ODOMETRY))
        bus.publish(ODOMETRY, b"x")
        assert 1 <= child.event("threads")["number"] <= 3
    assert os.environ["ZENOH_RUNTIME"] == THREADS


def test_endpoint_in_use_is_named_in_error(endpoint: str) -> None:
    with Bus(BusConfig(listen=(endpoint,))), pytest.raises(BusError, match=f"{endpoint}.*in use"):
        Bus(BusConfig(listen=(endpoint,)))
