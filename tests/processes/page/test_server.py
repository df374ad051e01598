"""The page's server over real HTTP on loopback."""

from __future__ import annotations

import logging
import threading
import time

import pytest

from formation.monitor.web.address import Bind
from formation.monitor.web.server import PageServer, page_server, words
from tests.processes.page.asking import requested
from tests.support.child import PATIENCE, until
from tests.support.looking import ANY, SEEN, looking, serving, source

FRAME = {"t": 1.0, "recording": None}
HAPPENED = {"n": 1, "at": 1.0, "level": 20, "robot": "", "kind": "order", "text": "run"}


def test_page_gets_greeting_then_frames_and_events() -> None:
    with serving() as server, looking(server) as events:
        hello = next(events)
        assert (hello.kind, hello.data["mission"]) == ("hello", "six-robots")
        until(lambda: server.source.wanted)
        server.source.show(FRAME, SEEN)
        assert next(events) == ("1", "frame", FRAME)
        server.source.note(HAPPENED)
        assert next(events) == ("event-1", "event", HAPPENED)
        server.source.show(FRAME, SEEN)
        assert next(events) == ("2", "frame", FRAME)  # the first frame has not come again


def test_late_page_gets_newest_frame_without_repeated_events() -> None:
    with serving() as server:
        server.source.note(HAPPENED)
        server.source.show(FRAME, SEEN)
        with looking(server) as events:
            assert next(events).data["events"] == [HAPPENED]
            assert next(events).kind == "frame"
            server.source.note({**HAPPENED, "n": 2})
            assert next(events).data["n"] == 2


def test_restarted_source_greets_all_clients_again() -> None:
    with serving() as server, looking(server) as one, looking(server) as other:
        assert {next(one).kind, next(other).kind} == {"hello"}
        server.source.restart([(1.0, 0.5)])
        for events in (one, other):
            hello = next(events)
            assert (hello.kind, hello.data["history"]) == ("hello", [[1.0, 0.5]])


def test_source_counts_no_departed_clients() -> None:
    with serving() as server:
        with looking(server) as events:
            next(events)
            assert server.source.wanted
        until(lambda: not server.source.wanted)


def test_metrics_and_snapshot_wait_for_new_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.monitor.web.stream.MAX_FRAME_WAIT", PATIENCE)
    with serving() as server:
        server.source.show(FRAME, SEEN)  # an old frame, which must not be sent

        def monitor() -> None:
            until(lambda: server.source.wanted)
            server.source.show(FRAME, SEEN)

        for path in ("metrics", "api/snapshot"):
            watching = threading.Thread(target=monitor)
            watching.start()
            answer = requested(server, path)
            watching.join()
            assert answer.status_code == 200
            assert answer.headers["cache-control"] == "no-store"
            assert not server.source.wanted
        assert answer.json()["mode"] == "run"


def test_metrics_are_unavailable_without_new_frame(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("formation.monitor.web.stream.MAX_FRAME_WAIT", 0.05)
    with serving() as server:
        server.source.show(FRAME, SEEN)
        assert requested(server, "metrics").status_code == 503
        assert requested(server, "api/snapshot").json() == {"error": "there are no metrics at the moment"}
        assert requested(server, "healthz").text == "ok\n"


def test_server_revalidates_page_and_refuses_other_paths() -> None:
    with serving() as server:
        answer = requested(server, "")
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/html")
        assert answer.headers["cache-control"] == "no-cache"
        assert answer.headers["content-security-policy"].startswith("default-src 'self';")
        etag = answer.headers["etag"]
        assert requested(server, "", **{"if-none-match": etag}).status_code == 304
        for path in ("nothing.js", "../server.py", "%2e%2e/server.py", "..%2fserver.py"):
            assert requested(server, path).status_code == 404


def test_second_page_server_uses_another_port(monkeypatch: pytest.MonkeyPatch) -> None:
    with serving() as first:
        port = int(first.address.rstrip("/").rpartition(":")[2])
        monkeypatch.setattr("formation.monitor.web.server.PORT", port)
        monkeypatch.setattr("formation.monitor.web.server.Bind", lambda port=port: Bind(port=port))
        assert words(None, first) == first.address
        with page_server(None, source()) as second:
            assert requested(second, "healthz").status_code == 200
            assert words(None, second) == f"{second.address} (port {port} is taken)"
        assert second.address != first.address
        with pytest.raises(OSError, match="in use"):
            page_server(Bind(port=port), source())
        assert requested(first, "healthz").status_code == 200


def test_server_listens_on_ipv6_address() -> None:
    with PageServer(Bind("::1", 0), source()) as server:
        assert server.address.startswith("http://[::1]:")
        assert requested(server, "healthz").status_code == 200


def test_stop_of_unstarted_or_stopped_server_does_nothing() -> None:
    server = PageServer(ANY, source())
    server.stop()
    with serving() as other:
        pass
    other.stop()
    other.source.show(FRAME, SEEN)  # as a monitor does after the stop


def test_failed_request_is_logged_and_server_continues(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: object) -> None:
        raise RuntimeError("no metrics at the moment")

    monkeypatch.setattr("formation.monitor.web.routes.as_json", fails)
    monkeypatch.setattr("formation.monitor.web.stream.MAX_FRAME_WAIT", PATIENCE)
    with serving() as server:
        watching = threading.Event()

        def monitor() -> None:
            while not watching.is_set():
                server.source.show(FRAME, SEEN)
                time.sleep(0.01)

        thread = threading.Thread(target=monitor)
        thread.start()
        assert requested(server, "api/snapshot").status_code == 500
        assert requested(server, "healthz").status_code == 200
        watching.set()
        thread.join()
    assert "no metrics at the moment" in caplog.text


def test_connecting_and_leaving_logs_nothing(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG, logger="uvicorn"), serving() as server:
        requested(server, "healthz")
        requested(server, "nothing")
        with looking(server) as events:
            next(events)
    assert [record for record in caplog.records if record.name.startswith("uvicorn")] == []
