from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from formation.monitor.web.source import HISTORY_VALUES, MAX_EVENTS
from tests.support.looking import SEEN, source


def happened(number: int) -> dict[str, Any]:
    return {"n": number, "at": float(number), "level": 20, "robot": "", "kind": "order", "text": "run"}


def hello(chunk: bytes) -> Any:
    lines = dict(line.partition(": ")[::2] for line in chunk.decode().splitlines())
    assert lines["event"] == "hello"
    return json.loads(lines["data"])


def test_greeting_contains_mission_history_and_events() -> None:
    one = source()
    one.tell(recording="a.mcap")
    one.observe(1000.123, 0.123456)
    one.observe(1000.623, None)
    one.note(happened(1))
    reported = hello(one.greeting().chunk)
    assert reported["mission"] == "six-robots"
    assert reported["recording"] == "a.mcap"
    assert reported["history"] == [[1000.12, 0.1235], [1000.62, None]]
    assert reported["events"] == [happened(1)]
    assert reported["now"] == 1234.5


def test_only_newest_frame_is_kept_and_encoded() -> None:
    one = source()
    for number in range(3):
        one.show({"t": number}, SEEN)
    assert one.look == (3, b'id: 3\nevent: frame\ndata: {"t":2}\n\n', {"t": 2}, SEEN)


def test_history_and_events_are_bounded() -> None:
    one = source()
    for number in range(3 * HISTORY_VALUES):
        one.observe(float(number), 0.0)
        one.note(happened(number))
    reported = hello(one.greeting().chunk)
    assert [len(reported["history"]), len(reported["events"])] == [HISTORY_VALUES, MAX_EVENTS]
    assert reported["history"][-1] == [3 * HISTORY_VALUES - 1, 0.0]
    assert reported["events"][-1]["n"] == 3 * HISTORY_VALUES - 1


def test_events_continue_after_the_last_received() -> None:
    one = source()
    for number in range(1, 4):
        one.note(happened(number))
    number, news = one.events(1)
    assert (number, news.count(b"event: event")) == (3, 2)
    assert one.events(3) == (3, b"")
    assert one.greeting().events == 3


def test_restart_drops_earlier_history_and_events() -> None:
    one = source()
    one.observe(1.0, 1.0)
    one.note(happened(8))
    one.show({}, SEEN)
    epoch = one.greeting().epoch
    one.restart([(5.0, 0.5)], [happened(1)])
    reported = one.greeting()
    assert reported.epoch != epoch
    assert hello(reported.chunk)["history"] == [[5.0, 0.5]]
    assert hello(reported.chunk)["events"] == [happened(1)]
    assert one.look is None


@pytest.mark.parametrize("viewers", [0, 2])
def test_source_is_wanted_only_with_viewers(viewers: int) -> None:
    one = source()
    assert one.wanted is False
    one.set_clients(2)
    one.set_clients(viewers)
    assert one.wanted is (viewers > 0)


def test_frames_events_and_restarts_wake_server_until_detached() -> None:
    one, woken = source(), []
    one.show({}, SEEN)  # no server is attached yet
    one.set_wake(lambda: woken.append(1))
    one.show({}, SEEN)
    one.note(happened(1))
    one.restart()
    assert len(woken) == 3
    one.set_wake(None)
    one.show({}, SEEN)
    assert len(woken) == 3


def test_nan_and_infinity_are_refused() -> None:
    one = source()
    with pytest.raises(ValueError, match="JSON"):
        one.show({"t": float("nan")}, SEEN)
    with pytest.raises(ValueError, match="JSON"):
        one.note({**happened(1), "at": float("inf")})
    assert one.look is None
    assert one.events(0) == (0, b"")


def test_threads_may_write_and_read_concurrently() -> None:
    one = source()

    def put() -> None:
        for number in range(3000):
            one.observe(float(number), 0.1)
            one.note(happened(number))

    with ThreadPoolExecutor() as threads:
        putting = threads.submit(put)
        while not putting.done():
            hello(one.greeting().chunk)
            one.events(-1)
    putting.result()
