"""The page's server over real HTTP on loopback."""

from __future__ import annotations

import json
import logging
import threading
import time
from typing import Any

import httpx
import pytest

from monitor.page.address import Bind
from monitor.page.opening import opened, words
from monitor.page.server import PageServer
from tests.monitor.page.looking import ANY, PLAIN, SEEN, looking, serving, source, until
from tests.processes.child import PATIENCE

TOKEN = "a-token-for-a-test"  # noqa: S105 - it opens nothing
JSON = {"content-type": "application/json"}
BEARER = {**JSON, "authorization": f"Bearer {TOKEN}"}
FRAME = {"t": 1.0, "recording": None}
HAPPENED = {"n": 1, "at": 1.0, "level": 20, "robot": "", "kind": "order", "text": "run"}


class Orders:
    """Takes every order, and remembers it."""

    token = TOKEN

    def __init__(self, error: Exception | None = None) -> None:
        self.given: list[tuple[str, str | None, str, float | None]] = []
        self.error = error
        self.hold = threading.Event()
        self.hold.set()

    def order(
        self, do: str, shape: str | None = None, *, click: str = "", seen: float | None = None
    ) -> dict[str, Any]:
        self.given.append((do, shape, click, seen))
        assert self.hold.wait(PATIENCE)
        if self.error is not None:
            raise self.error
        return {"do": do, "robots": {"robot1": {"ok": True}}, "missing": []}


class Player:
    """Takes every wish."""

    def __init__(self) -> None:
        self.wishes: list[tuple[str, float | None]] = []

    def steer(self, do: str, to: float | None) -> dict[str, Any]:
        self.wishes.append((do, to))
        if to == 13.0:
            raise ValueError("13: there is no such moment")
        return {"paused": do == "pause"}


def asked(server: PageServer, path: str, body: Any = None, **headers: str) -> httpx.Response:
    content = body if isinstance(body, (bytes, type(None))) else json.dumps(body).encode()
    names = {name.replace("_", "-"): value for name, value in headers.items()}
    method = "GET" if body is None else "POST"
    url = server.address + path
    return httpx.request(method, url, content=content, headers=names, timeout=PATIENCE, verify=PLAIN)


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


def test_names_that_are_not_ours_and_pages_that_are_not_ours_are_refused() -> None:
    orders = Orders()
    with serving(control=orders) as server:
        assert asked(server, "stream", host="attacker.example").status_code == 421
        foreign = asked(server, "api/order", {"do": "stop"}, **BEARER, origin="http://attacker.example")
        assert foreign.status_code == 403
        own = asked(server, "api/order", {"do": "stop"}, **BEARER, origin=server.address.rstrip("/"))
        assert own.status_code == 200
    assert [one[0] for one in orders.given] == ["stop"]


def test_an_order_needs_the_token() -> None:
    orders = Orders()
    with serving(control=orders) as server:
        for wrong in (
            {},
            {"authorization": "Bearer"},
            {"authorization": TOKEN},
            {"authorization": "Bearer x"},
        ):
            answer = asked(server, "api/order", {"do": "stop"}, **JSON, **wrong)
            assert answer.status_code == 401
            assert answer.headers["www-authenticate"] == "Bearer"
            assert TOKEN not in answer.text
            assert asked(server, "api/order", **wrong).status_code == 401
        assert asked(server, "api/order", **BEARER).status_code == 204  # may order, and has not
        assert orders.given == []
        assert asked(server, "api/order", {"do": "stop"}, **BEARER).json() == {
            "do": "stop", "robots": {"robot1": {"ok": True}}, "missing": [],
        }  # fmt: skip
        body = {"do": "shape", "shape": "wedge", "click": "7", "seen": 12.5}
        assert asked(server, "api/order", body, **BEARER).status_code == 200
    assert orders.given == [("stop", None, "", None), ("shape", "wedge", "7", 12.5)]


def test_the_operator_is_invited_with_the_token_where_no_server_sees_it() -> None:
    with serving(control=Orders()) as server:
        assert server.invitation == f"{server.address}#token={TOKEN}"
        told = words(Bind(), server)
        assert told == f"{server.address}; to give orders, the one in the ready line"
    with serving() as server:
        assert server.invitation == server.address


@pytest.mark.parametrize("path", ["api/order", "api/replay", "api/nothing"])
def test_without_control_or_a_replay_there_is_nothing_to_ask(path: str) -> None:
    with serving() as server:
        assert asked(server, path, {"do": "stop"}, **BEARER).status_code == 404
        assert asked(server, path).status_code == 404


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        ({"do": "dance"}, 400, "do: must be one of hold, run, stop, release, shape"),
        ({}, 400, "do: must be one of"),
        ({"do": ["stop"]}, 400, "do: must be one of"),
        ({"do": "shape"}, 400, "shape: must be one of hexagon, wedge"),
        ({"do": "shape", "shape": "blob"}, 400, "shape: must be one of hexagon, wedge"),
        ({"do": "stop", "click": 65 * "x"}, 400, "click: must be text of at most 64 letters"),
        ({"do": "stop", "seen": "now"}, 400, "seen: must be a number"),
        ({"do": "stop", "seen": True}, 400, "seen: must be a number"),
        (b'{"do": "stop", "seen": NaN}', 400, "seen: must be a number"),
        (b'{"do": "stop", "seen": 1e999}', 400, "seen: must be a number"),
        ([], 400, "the body must be a JSON object"),
        (b"{", 400, "the body must be a JSON object"),
        (b"\xff\xfe", 400, "the body must be a JSON object"),
        (5000 * b"[", 413, "the body must be at most 4096 bytes"),
        (3000 * b"[", 400, "the body must be a JSON object"),
    ],
)
def test_a_body_that_makes_no_sense_is_told_what_is_legal(body: Any, status: int, words: str) -> None:
    orders = Orders()
    with serving(control=orders) as server:
        answer = asked(server, "api/order", body, **BEARER)
    assert (answer.status_code, orders.given) == (status, [])
    assert words in answer.json()["error"]


def test_a_form_of_a_foreign_page_is_no_order() -> None:
    with serving(control=Orders()) as server:
        kind = {"content-type": "text/plain", "authorization": f"Bearer {TOKEN}"}
        assert asked(server, "api/order", {"do": "stop"}, **kind).status_code == 415


def test_an_order_that_comes_at_the_wrong_moment_says_so_and_one_that_failed_is_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    orders = Orders(ValueError("run: a stop was given just now"))
    with serving(control=orders) as server:
        answer = asked(server, "api/order", {"do": "run"}, **BEARER)
        assert (answer.status_code, answer.json()) == (409, {"error": "run: a stop was given just now"})
        assert caplog.records == []
        orders.error = OSError("the link is down")
        answer = asked(server, "api/order", {"do": "run"}, **BEARER)
        assert (answer.status_code, answer.json()) == (
            500,
            {"error": "the order was not given: the link is down"},
        )
    assert "the link is down" in caplog.text


def test_a_stop_does_not_wait_behind_other_orders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("monitor.page.routes.AT_ONCE", 3)
    orders = Orders()
    orders.hold.clear()
    with serving(control=orders) as server:

        def ask(do: str) -> threading.Thread:
            one = threading.Thread(target=asked, args=(server, "api/order", {"do": do}), kwargs=BEARER)
            one.start()
            return one

        asking = [ask("run") for _ in range(3)]
        until(lambda: len(orders.given) == 3)
        assert asked(server, "api/order", {"do": "run"}, **BEARER).status_code == 429
        asking.append(ask("stop"))
        until(lambda: len(orders.given) == 4)
        orders.hold.set()
        for one in asking:
            one.join()
        # and when they are over, however they ended, there is room again
        orders.error = ValueError("not now")
        for _ in range(4):
            assert asked(server, "api/order", {"do": "run"}, **BEARER).status_code == 409
    assert [do for do, *_ in orders.given][:4] == ["run", "run", "run", "stop"]


def test_a_replay_is_steered_without_a_token_for_it_moves_no_robot() -> None:
    player = Player()
    with serving(replay=player) as server:
        assert asked(server, "api/replay", {"do": "pause"}, **JSON).json() == {"paused": True}
        assert asked(server, "api/replay", {"do": "seek", "to": 12}, **JSON).status_code == 200
        assert asked(server, "api/replay", {"do": "speed", "to": 0.5}, **JSON).status_code == 200
        for body in (
            {"do": "seek"},
            {"do": "speed", "to": "fast"},
            {"do": "seek", "to": 1e300},
            {"do": "rewind"},
        ):
            assert asked(server, "api/replay", body, **JSON).status_code == 400
        answer = asked(server, "api/replay", {"do": "seek", "to": 13.0}, **JSON)
        assert answer.json() == {"error": "13: there is no such moment"}
        foreign = asked(server, "api/replay", {"do": "pause"}, **JSON, origin="http://attacker.example")
        assert foreign.status_code == 403
    assert player.wishes[:3] == [("pause", None), ("seek", 12.0), ("speed", 0.5)]


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
