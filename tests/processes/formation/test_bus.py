from __future__ import annotations

import threading
import time

import pytest

from formation.topics import CMD_VEL, ODOM, ORDER, POSITION
from formation.transport import mailbox
from formation.transport.bus import Bus, BusConfig, BusError
from tests.support.bus_tools import (
    COMMAND,
    ODOMETRY,
    PLACE,
    REQUESTED,
    acquaint,
    answers,
    collect,
    serving,
)
from tests.support.child import PATIENCE, free_endpoint, until

pytestmark = pytest.mark.processes


@pytest.mark.smoke
def test_sample_arrives_with_key_payload_attachment_and_time(pair: tuple[Bus, Bus]) -> None:
    here, there = pair
    before = time.monotonic()
    there.publish(ODOMETRY, b"payload", b"attachment")
    there.publish(ODOMETRY, b"")
    first, second = collect(here, 2)
    assert first[:3] == (ODOMETRY, b"payload", b"attachment")
    assert second[:3] == (ODOMETRY, b"", None)
    assert before <= first.arrived <= second.arrived <= time.monotonic()
    assert there.published == here.received == {ODOMETRY: 2}


def test_samples_arrive_in_order_of_sending(pair: tuple[Bus, Bus]) -> None:
    here, there = pair
    sent = [number.to_bytes(4, "little") for number in range(500)]
    for payload in sent:
        there.publish(ODOMETRY, payload)
    assert [sample.payload for sample in collect(here, 500)] == sent


def test_wildcard_subscription_gives_the_sample_key(pair: tuple[Bus, Bus]) -> None:
    here, there = pair
    here.subscribe(POSITION.pattern.format(robot="*"))
    there.advertise(POSITION, PLACE)
    until(lambda: there.watched(PLACE))
    there.publish(PLACE, b"there")
    assert collect(here, 1)[0].key == PLACE


def test_undrained_mailbox_does_not_stall_its_link(pair: tuple[Bus, Bus]) -> None:
    here, there = pair
    there.answer(REQUESTED, lambda request, _: b"answered " + request)
    slowest = 0.0
    for number in range(3000):
        start = time.perf_counter()
        there.publish(ODOMETRY, number.to_bytes(724, "little"))
        slowest = max(slowest, time.perf_counter() - start)
    until(lambda: here.received[ODOMETRY] > 1024)
    with serving(there):
        assert [reply.payload for reply in answers(here, REQUESTED, b"now", 1)] == [b"answered now"]
    assert len(here.drain()) == 1024
    assert slowest < 0.5


@pytest.mark.smoke
def test_each_process_answers_on_its_main_thread(endpoint: str) -> None:
    other = free_endpoint()
    threads = []

    def answer(request: bytes, _: float) -> bytes:
        threads.append(threading.current_thread())
        return request.upper()

    with (
        Bus(BusConfig(listen=(endpoint,))) as one,
        Bus(BusConfig(listen=(other,))) as two,
        Bus(BusConfig(connect=(endpoint, other))) as operator,
    ):
        one.answer(ORDER.key("robot1"), answer)
        two.answer(ORDER.key("robot2"), answer)
        with serving(one), serving(two):
            replies = answers(operator, ORDER.pattern.format(robot="*"), b"stop", 2)
            assert [reply.payload for reply in answers(operator, ORDER.key("robot2"), b"run", 1)] == [b"RUN"]
    assert sorted(reply.key for reply in replies) == [ORDER.key("robot1"), ORDER.key("robot2")]
    assert {reply.payload for reply in replies} == {b"STOP"}
    assert all(0.0 < reply.ms < PATIENCE * 1e3 for reply in replies)
    assert len(set(threads)) == 2
    assert {thread.name for thread in threads} == {"another process"}


def test_excess_queries_are_refused_at_once(pair: tuple[Bus, Bus], monkeypatch: pytest.MonkeyPatch) -> None:
    here, there = pair
    monkeypatch.setattr(mailbox, "MAX_QUERIES", 1)
    here.answer(REQUESTED, lambda request, _: request)
    acquaint(here, there)
    replies = []
    asking = threading.Thread(target=lambda: replies.extend(there.ask(REQUESTED, b"first", PATIENCE)))
    asking.start()
    assert here.wait(PATIENCE)
    start = time.monotonic()
    assert there.ask(REQUESTED, b"second", PATIENCE) == []
    assert time.monotonic() - start < PATIENCE / 2
    assert here.mailbox.serve() == 1
    asking.join()
    assert [reply.payload for reply in replies] == [b"first"]


def test_query_without_queryables_returns_at_once(pair: tuple[Bus, Bus]) -> None:
    start = time.monotonic()
    assert pair[1].ask(ORDER.key("nobody"), b"stop", PATIENCE) == []
    assert time.monotonic() - start < PATIENCE / 2


def test_late_answers_count_as_missing(pair: tuple[Bus, Bus]) -> None:
    here, there = pair
    here.answer(REQUESTED, lambda request, _: request)
    acquaint(here, there)
    start = time.monotonic()
    assert there.ask(REQUESTED, b"stop", 0.2) == []
    assert 0.15 < time.monotonic() - start < 5.0


def test_watched_follows_the_listeners(endpoint: str) -> None:
    with Bus(BusConfig(listen=(endpoint,))) as bus:
        bus.advertise(ODOM, ODOMETRY)
        assert not bus.watched(ODOMETRY)
        with Bus(BusConfig(connect=(endpoint,))) as other:
            other.subscribe(ODOMETRY)
            until(lambda: bus.watched(ODOMETRY))
        until(lambda: not bus.watched(ODOMETRY))


def test_closed_bus_raises_bus_error(endpoint: str) -> None:
    with Bus(BusConfig(listen=(endpoint,))) as bus:
        bus.advertise(ODOM, ODOMETRY)
    bus.close()
    for use in (
        lambda: bus.publish(ODOMETRY, b""),
        lambda: bus.watched(ODOMETRY),
        lambda: bus.subscribe(ODOMETRY),
        lambda: bus.advertise(CMD_VEL, COMMAND),
        lambda: bus.answer(REQUESTED, lambda request, _: request),
        lambda: bus.ask(REQUESTED, b"", 0.1),
    ):
        with pytest.raises(BusError, match="the bus is closed"):
            use()


def test_unadvertised_repeated_and_invalid_keys_raise_bus_error() -> None:
    with Bus(BusConfig()) as bus:
        with pytest.raises(BusError, match=f"'{ODOMETRY}' is not advertised: none"):
            bus.publish(ODOMETRY, b"")
        bus.advertise(ODOM, ODOMETRY)
        with pytest.raises(BusError, match="advertised already"):
            bus.advertise(ODOM, ODOMETRY)
        with pytest.raises(BusError, match="'order' is a queryable"):
            bus.advertise(ORDER, REQUESTED)
        with pytest.raises(BusError, match="robot1//odom"):
            bus.subscribe("robot1//odom")
