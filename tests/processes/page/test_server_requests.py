"""Requests to the page's server: orders and replay control, with tokens, hosts and origins."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from formation.monitor.web.address import Bind
from formation.monitor.web.server import words
from formation.stability.intent import BadOrder
from tests.processes.page.asking import BEARER, JSON, TOKEN, OrderRecorder, Player, requested
from tests.support.child import until
from tests.support.looking import serving


def test_foreign_hosts_and_origins_are_refused() -> None:
    orders = OrderRecorder()
    with serving(control=orders) as server:
        assert requested(server, "stream", host="attacker.example").status_code == 421
        foreign = requested(server, "api/order", {"do": "stop"}, **BEARER, origin="http://attacker.example")
        assert foreign.status_code == 403
        own = requested(server, "api/order", {"do": "stop"}, **BEARER, origin=server.address.rstrip("/"))
        assert own.status_code == 200
    assert [one[0] for one in orders.given] == ["stop"]


def test_order_needs_token() -> None:
    orders = OrderRecorder()
    with serving(control=orders) as server:
        for wrong in (
            {},
            {"authorization": "Bearer"},
            {"authorization": TOKEN},
            {"authorization": "Bearer x"},
        ):
            answer = requested(server, "api/order", {"do": "stop"}, **JSON, **wrong)
            assert answer.status_code == 401
            assert answer.headers["www-authenticate"] == "Bearer"
            assert TOKEN not in answer.text
            assert requested(server, "api/order", **wrong).status_code == 401
        assert (
            requested(server, "api/order", **BEARER).status_code == 204
        )  # the token is accepted; no order is given
        assert orders.given == []
        assert requested(server, "api/order", {"do": "stop"}, **BEARER).json() == {
            "do": "stop",
            "missing": [],
        }
        body = {"do": "shape", "shape": "wedge", "click": "7", "seen": 12.5}
        assert requested(server, "api/order", body, **BEARER).status_code == 200
        body = {"do": "speed", "speed": 0.1, "degrees": -30, "shape": "wedge"}
        assert requested(server, "api/order", body, **BEARER).status_code == 200
    assert orders.given == [
        ("stop", {}, "", None),
        ("shape", {"shape": "wedge"}, "7", 12.5),
        ("speed", {"speed": 0.1, "degrees": -30}, "", None),
    ]


def test_invitation_carries_token_in_url_fragment() -> None:
    with serving(control=OrderRecorder()) as server:
        assert server.invitation == f"{server.address}#token={TOKEN}"
        reported = words(Bind(), server)
        assert reported == f"{server.address}; to give orders, the one in the ready line"
    with serving() as server:
        assert server.invitation == server.address


@pytest.mark.parametrize("path", ["api/order", "api/replay", "api/nothing"])
def test_api_returns_404_without_control_and_replay(path: str) -> None:
    with serving() as server:
        assert requested(server, path, {"do": "stop"}, **BEARER).status_code == 404
        assert requested(server, path).status_code == 404


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
def test_bad_body_is_refused_with_legal_values(body: Any, status: int, words: str) -> None:
    orders = OrderRecorder()
    with serving(control=orders) as server:
        answer = requested(server, "api/order", body, **BEARER)
    assert (answer.status_code, orders.given) == (status, [])
    assert words in answer.json()["error"]


def test_order_as_plain_text_is_refused() -> None:
    with serving(control=OrderRecorder()) as server:
        kind = {"content-type": "text/plain", "authorization": f"Bearer {TOKEN}"}
        assert requested(server, "api/order", {"do": "stop"}, **kind).status_code == 415


def test_refused_order_returns_reason_and_failed_one_is_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    orders = OrderRecorder(ValueError("run: a stop was given just now"))
    with serving(control=orders) as server:
        answer = requested(server, "api/order", {"do": "run"}, **BEARER)
        assert (answer.status_code, answer.json()) == (409, {"error": "run: a stop was given just now"})
        orders.error = BadOrder("route: legs = 1: must be a list")
        answer = requested(server, "api/order", {"do": "route", "legs": 1}, **BEARER)
        assert (answer.status_code, answer.json()) == (400, {"error": "route: legs = 1: must be a list"})
        assert caplog.records == []
        orders.error = OSError("the link is down")
        answer = requested(server, "api/order", {"do": "run"}, **BEARER)
        assert (answer.status_code, answer.json()) == (
            500,
            {"error": "the order was not given: the link is down"},
        )
    assert "the link is down" in caplog.text


def test_stop_is_accepted_over_limit_of_orders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.monitor.web.routes.MAX_ORDERS", 3)
    orders = OrderRecorder()
    orders.hold.clear()
    with serving(control=orders) as server:

        def ask(do: str) -> threading.Thread:
            one = threading.Thread(target=requested, args=(server, "api/order", {"do": do}), kwargs=BEARER)
            one.start()
            return one

        asking = [ask("run") for _ in range(3)]
        until(lambda: len(orders.given) == 3)
        assert requested(server, "api/order", {"do": "run"}, **BEARER).status_code == 429
        asking.append(ask("stop"))
        until(lambda: len(orders.given) == 4)
        orders.hold.set()
        for one in asking:
            one.join()
        # orders that have ended, also by failure, make room again
        orders.error = ValueError("not now")
        for _ in range(4):
            assert requested(server, "api/order", {"do": "run"}, **BEARER).status_code == 409
    assert [do for do, *_ in orders.given][:4] == ["run", "run", "run", "stop"]


def test_replay_control_needs_no_token() -> None:
    player = Player()
    with serving(steer=player.steer) as server:
        assert requested(server, "api/replay", {"do": "pause"}, **JSON).json() == {"paused": True}
        assert requested(server, "api/replay", {"do": "seek", "to": 12}, **JSON).status_code == 200
        assert requested(server, "api/replay", {"do": "speed", "to": 0.5}, **JSON).status_code == 200
        for body in (
            {"do": "seek"},
            {"do": "speed", "to": "fast"},
            {"do": "seek", "to": 1e300},
            {"do": "rewind"},
        ):
            assert requested(server, "api/replay", body, **JSON).status_code == 400
        answer = requested(server, "api/replay", {"do": "seek", "to": 13.0}, **JSON)
        assert answer.json() == {"error": "13: there is no such moment"}
        foreign = requested(server, "api/replay", {"do": "pause"}, **JSON, origin="http://attacker.example")
        assert foreign.status_code == 403
    assert player.wishes[:3] == [("pause", None), ("seek", 12.0), ("speed", 0.5)]
