"""The page's server over real HTTP on loopback."""

from __future__ import annotations

import logging
import threading
import time

import pytest

from monitor.page.address import Bind
from monitor.page.opening import opened, words
from monitor.page.server import PageServer
from tests.monitor.page.asking import asked
from tests.monitor.page.looking import ANY, SEEN, looking, serving, source, until

FRAME = {"t": 1.0, "recording": None}
HAPPENED = {"n": 1, "at": 1.0, "level": 20, "robot": "", "kind": "order", "text": "run"}


def test_a_page_is_greeted_and_then_gets_frames_and_events_as_they_come() -> None:
    with serving() as server, looking(server) as events:
        hello = next(events)
        assert (hello.kind, hello.data["mission"]) == ("hello", "six-robots")
        until(lambda: server.source.wanted)
        server.source.show(FRAME, SEEN)
        assert next(events) == ("1", "frame", FRAME)
        server.source.note(HAPPENED)
        assert next(events) == ("event-1", "event", HAPPENED)
        server.source.show(FRAME, SEEN)
        assert next(events) == ("2", "frame", FRAME)  # and the first one has not come again meanwhile


def test_who_comes_later_gets_the_newest_frame_at_once_and_no_event_twice() -> None:
    with serving() as server:
        server.source.note(HAPPENED)
        server.source.show(FRAME, SEEN)
        with looking(server) as events:
            assert next(events).data["events"] == [HAPPENED]
            assert next(events).kind == "frame"
            server.source.note({**HAPPENED, "n": 2})
            assert next(events).data["n"] == 2


def test_after_a_jump_everybody_is_greeted_anew() -> None:
    with serving() as server, looking(server) as one, looking(server) as other:
        assert {next(one).kind, next(other).kind} == {"hello"}
        server.source.restart([(1.0, 0.5)])
        for events in (one, other):
            hello = next(events)
            assert (hello.kind, hello.data["history"]) == ("hello", [[1.0, 0.5]])


def test_nobody_is_counted_who_has_gone() -> None:
    with serving() as server:
        with looking(server) as events:
            next(events)
            assert server.source.wanted
        until(lambda: not server.source.wanted)


def test_figures_are_of_the_moment_when_they_are_asked_for() -> None:
    with serving() as server:
        server.source.show(FRAME, SEEN)  # an old one, which nobody is to get

        def monitor() -> None:
            until(lambda: server.source.wanted)
            server.source.show(FRAME, SEEN)

        for path in ("metrics", "api/snapshot"):
            watching = threading.Thread(target=monitor)
            watching.start()
            answer = asked(server, path)
            watching.join()
            assert answer.status_code == 200
            assert answer.headers["cache-control"] == "no-store"
            assert not server.source.wanted
        assert answer.json()["mode"] == "run"


def test_figures_of_a_monitor_that_has_stopped_looking_are_not_made_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("monitor.page.stream.FRESH", 0.05)
    with serving() as server:
        server.source.show(FRAME, SEEN)
        assert asked(server, "metrics").status_code == 503
        assert asked(server, "api/snapshot").json() == {"error": "there are no figures just now"}
        assert asked(server, "healthz").text == "ok\n"


def test_the_page_itself_is_served_and_a_browser_asks_each_time_whether_it_changed() -> None:
    with serving() as server:
        answer = asked(server, "")
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/html")
        assert answer.headers["cache-control"] == "no-cache"
        assert answer.headers["content-security-policy"].startswith("default-src 'self';")
        etag = answer.headers["etag"]
        assert asked(server, "", **{"if-none-match": etag}).status_code == 304
        for path in ("nothing.js", "../server.py", "%2e%2e/server.py", "..%2fserver.py"):
            assert asked(server, path).status_code == 404


def test_two_pages_side_by_side_have_ports_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    with serving() as first:
        port = int(first.address.rstrip("/").rpartition(":")[2])
        monkeypatch.setattr("monitor.page.opening.PORT", port)
        monkeypatch.setattr("monitor.page.opening.Bind", lambda port=port: Bind(port=port))
        assert words(None, first) == first.address
        with opened(None, source()) as second:
            assert asked(second, "healthz").status_code == 200
            assert words(None, second) == f"{second.address} (port {port} is taken)"
        assert second.address != first.address
        with pytest.raises(OSError, match="in use"):
            opened(Bind(port=port), source())
        assert asked(first, "healthz").status_code == 200


def test_it_serves_where_an_ipv6_address_says() -> None:
    with PageServer(Bind("::1", 0), source()) as server:
        assert server.address.startswith("http://[::1]:")
        assert asked(server, "healthz").status_code == 200


def test_a_server_that_was_never_started_or_is_stopped_twice_does_no_harm() -> None:
    server = PageServer(ANY, source())
    server.stop()
    with serving() as other:
        pass
    other.stop()
    other.source.show(FRAME, SEEN)  # the monitor does not know, and need not


def test_a_failure_of_the_server_is_logged_and_whoever_watches_goes_on(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: object) -> None:
        raise RuntimeError("no figures today")

    monkeypatch.setattr("monitor.page.routes.as_json", fails)
    with serving() as server:
        watching = threading.Event()

        def monitor() -> None:
            while not watching.is_set():
                server.source.show(FRAME, SEEN)
                time.sleep(0.01)

        thread = threading.Thread(target=monitor)
        thread.start()
        assert asked(server, "api/snapshot").status_code == 500
        assert asked(server, "healthz").status_code == 200
        watching.set()
        thread.join()
    assert "no figures today" in caplog.text


def test_nothing_is_logged_of_people_who_come_and_go(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG, logger="uvicorn"), serving() as server:
        asked(server, "healthz")
        asked(server, "nothing")
        with looking(server) as events:
            next(events)
    assert [record for record in caplog.records if record.name.startswith("uvicorn")] == []
