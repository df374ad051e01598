"""The mailbox of all buses of a process: bounded, counted, and woken from any thread."""

from __future__ import annotations

import signal
import threading
import time
from collections import Counter

from formation.transport.mailbox import MAX_QUERIES, Mailbox
from formation.transport.runtime.clock import monotonic
from formation.wire import Sample

PATIENCE = 30.0


class Query:
    """A fake query that records its answers and drops."""

    def __init__(self, request: bytes) -> None:
        self.request, self.answers, self.dropped = request, list[bytes](), 0

    def answer(self, reply: bytes) -> None:
        self.answers.append(reply)

    def drop(self) -> None:
        self.dropped += 1


def echo(request: bytes, _: float) -> bytes:
    return request


def sample(key: str, number: int) -> Sample:
    return Sample(key, bytes([number]), None, float(number))


def test_drain_returns_samples_of_all_buses_in_arrival_order() -> None:
    box = Mailbox()
    fleet, robot = Counter[str](), Counter[str]()
    for number, (key, counts) in enumerate([("a", fleet), ("b", robot), ("a", fleet)]):
        box.put(sample(key, number), counts)
    assert [one.payload for one in box.drain()] == [b"\0", b"\1", b"\2"]
    assert box.drain() == []
    assert box.received == {"a": 2, "b": 1}
    assert (fleet, robot) == ({"a": 2}, {"b": 1})


def test_full_mailbox_drops_and_counts_oldest_samples() -> None:
    box = Mailbox(capacity=3)
    for number in range(5):
        box.put(sample("a", number))
    assert [one.payload for one in box.drain()] == [b"\2", b"\3", b"\4"]
    assert (box.overflowed, box.received["a"]) == (2, 5)


def test_puts_of_many_threads_are_counted_exactly() -> None:
    box = Mailbox(capacity=100)
    own = Counter[str]()

    def fill() -> None:
        for _ in range(2000):
            box.put(sample("a", 1), own)

    threads = [threading.Thread(target=fill) for _ in range(4)]
    for thread in threads:
        thread.start()
    got = 0
    while any(thread.is_alive() for thread in threads):
        got += len(box.drain())
    for thread in threads:
        thread.join()
    got += len(box.drain())
    assert own["a"] == box.received["a"] == 8000
    assert got + box.overflowed == 8000


def test_wait_wakes_for_sample_query_and_wake() -> None:
    box = Mailbox()
    start = time.monotonic()
    assert not box.wait(0.05)
    assert 0.05 <= time.monotonic() - start < 5.0
    box.put(sample("a", 1))
    assert box.wait(PATIENCE)
    box.drain()
    box.accept(Query(b"?"), echo)
    assert box.wait(PATIENCE)
    box.serve()
    box.wake()
    assert box.wait(PATIENCE)
    assert not box.wait(0.0)
    assert time.monotonic() - start < 5.0


def test_sample_that_does_not_wake_waits_for_one_that_does() -> None:
    box = Mailbox()
    box.put(sample("a", 1), wakes=False)
    start = time.monotonic()
    assert not box.wait(0.05)
    assert time.monotonic() - start >= 0.05
    box.put(sample("b", 2))
    box.put(sample("a", 3), wakes=False)
    assert box.wait(PATIENCE)
    assert [one.payload for one in box.drain()] == [b"\1", b"\2", b"\3"]
    assert not box.wait(0.0)


def test_ring_without_sample_does_not_end_wait() -> None:
    box = Mailbox()
    box.ring()
    box.ring()
    start = time.monotonic()
    assert not box.wait(0.05)
    assert time.monotonic() - start >= 0.05


def test_put_by_another_thread_ends_wait() -> None:
    box = Mailbox()
    timer = threading.Timer(0.05, box.put, [sample("a", 1)])
    timer.start()
    start = time.monotonic()
    assert box.wait(PATIENCE)
    assert time.monotonic() - start < 5.0
    timer.join()


def test_wake_in_signal_handler_during_puts_loses_no_sample() -> None:
    box = Mailbox()
    rings, put = 0, 0

    def ring(*_: object) -> None:
        nonlocal rings
        rings += 1
        box.wake()

    def fill() -> None:
        nonlocal put
        end = time.monotonic() + PATIENCE
        while put < 500 or (rings <= 100 and time.monotonic() < end):
            box.put(sample("a", put % 256))
            put += 1
            time.sleep(0.0005)

    before = signal.signal(signal.SIGALRM, ring)
    filling = threading.Thread(target=fill)
    got = 0
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.0002, 0.0002)
        filling.start()
        while filling.is_alive():
            box.wait(0.01)
            got += len(box.drain())
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        filling.join()
    assert got + len(box.drain()) == put >= 500
    assert rings > 100


def test_queries_are_answered_in_order_and_excess_ones_dropped() -> None:
    box = Mailbox()
    requested = [Query(bytes([number])) for number in range(MAX_QUERIES + 2)]
    for query in requested:
        box.accept(query, lambda request, _: request + b"!")
    assert [query.dropped for query in requested] == [0] * MAX_QUERIES + [1, 1]
    assert box.serve() == MAX_QUERIES
    assert [query.answers for query in requested[:2]] == [[b"\0!"], [b"\1!"]]
    assert box.serve() == 0


def test_handler_receives_arrival_time_of_query() -> None:
    box, times = Mailbox(), list[float]()

    def answer(request: bytes, received: float) -> bytes:
        times.append(received)
        return request

    before = monotonic()
    box.accept(Query(b"?"), answer)
    after = monotonic()
    time.sleep(0.01)
    box.serve()
    assert before <= times[0] <= after


def test_turn_away_drops_waiting_queries() -> None:
    box = Mailbox()
    query = Query(b"?")
    box.accept(query, echo)
    box.turn_away()
    assert (query.dropped, query.answers, box.serve()) == (1, [], 0)
