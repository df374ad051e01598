"""What the page's server lets be asked of it, by whom: orders, and the steering of a replay."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from monitor.page.address import Bind
from monitor.page.opening import words
from tests.monitor.page.asking import BEARER, JSON, TOKEN, Orders, Player, asked
from tests.monitor.page.looking import serving, until


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
        assert asked(server, "api/order", {"do": "stop"}, **BEARER).json() == {"do": "stop", "missing": []}
        body = {"do": "shape", "shape": "wedge", "click": "7", "seen": 12.5}
        assert asked(server, "api/order", body, **BEARER).status_code == 200
        body = {"do": "speed", "speed": 0.1, "degrees": -30, "shape": "wedge"}
        assert asked(server, "api/order", body, **BEARER).status_code == 200
    assert orders.given == [
        ("stop", {}, "", None),
        ("shape", {"shape": "wedge"}, "7", 12.5),
        ("speed", {"speed": 0.1, "degrees": -30}, "", None),
    ]


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
