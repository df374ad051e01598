"""Limits of the page's server: slow, many and silent clients, and its stop with open connections."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from typing import Any

import httpx
import psutil
import pytest
from uvicorn.protocols.http.h11_impl import H11Protocol

from formation.monitor.web import server as server_module
from formation.monitor.web import source as module
from formation.monitor.web.connection import OPERATOR, Connection, Rank
from formation.monitor.web.server import PageServer
from tests.processes.page.asking import BEARER, TOKEN, OrderRecorder, Player, requested
from tests.support.child import PATIENCE, until
from tests.support.looking import ANY, PLAIN, SEEN, dial, looking, serving, source

REQUEST = b"GET /stream HTTP/1.1\r\nHost: localhost\r\n\r\n"
LARGE = {"t": 0.0, "recording": None, "filling": 100_000 * "x"}
"""A frame as large as that of 700 robots."""


def asleep(server: PageServer) -> socket.socket:
    """Open a stream and read nothing, as a page on a sleeping phone."""
    one = socket.socket()
    one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    host, _, port = server.address.removeprefix("http://").rstrip("/").rpartition(":")
    one.connect((host, int(port)))
    one.sendall(REQUEST)
    return one


def show(server: PageServer, number: int) -> None:
    server.source.show({**LARGE, "t": float(number)}, SEEN)


def closed(one: socket.socket) -> bool:
    """Wait at most 30 s until the server closes the connection; return whether it did."""
    one.settimeout(30.0)
    try:
        while one.recv(65536):
            pass
    except ConnectionError:
        pass
    except TimeoutError:
        return False
    return True


def test_sleeping_client_delays_no_other_and_queues_nothing() -> None:
    with serving() as server, looking(server) as events, asleep(server):
        next(events)
        until(lambda: server.source._clients == 2)
        before = psutil.Process().memory_info().rss
        for number in range(500):
            show(server, number)
            assert next(events).data["t"] == number  # a client that reads gets every frame
        grown = psutil.Process().memory_info().rss - before
    assert grown < 15_000_000  # 50 MB were not read


def test_waking_client_skips_to_newest_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    # never close the sleeping client
    monkeypatch.setattr("formation.monitor.web.stream.STALLED_TIMEOUT_SECONDS", 1e6)
    with serving() as server, asleep(server) as sleeper:
        until(lambda: server.source.wanted)
        for number in range(500):
            show(server, number)
            time.sleep(0.001)
        reader = sleeper.makefile("rb")
        times: list[float] = []
        while not times or times[-1] != 499.0:
            line = reader.readline()
            assert line, "connection closed"
            if line.startswith(b'data: {"t":'):
                times.append(float(line[11:].partition(b",")[0]))
        reader.close()
    assert times == sorted(times)
    assert len(times) < 30  # the buffered frames, then the newest


def test_stalled_client_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.monitor.web.stream.STALLED_TIMEOUT_SECONDS", 0.2)
    with serving() as server, asleep(server) as sleeper:
        until(lambda: server.source.wanted)
        number = 0
        while server.source.wanted:
            show(server, number := number + 1)
            time.sleep(0.01)
        assert closed(sleeper)


def test_stream_over_limit_is_refused_until_viewer_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.monitor.web.stream.MAX_STREAMS", 3)
    with serving() as server, ExitStack() as stack:
        people = [stack.enter_context(looking(server)) for _ in range(2)]
        with looking(server) as events:
            assert {next(one).kind for one in (events, *people)} == {"hello"}
            refused = httpx.get(server.address + "stream", timeout=PATIENCE, verify=PLAIN)
            assert (refused.status_code, refused.headers["retry-after"]) == (503, "5")
            assert httpx.get(server.address + "healthz", timeout=PATIENCE, verify=PLAIN).status_code == 200
        until(lambda: server.source._clients == 2)
        assert next(stack.enter_context(looking(server))).kind == "hello"


def test_all_viewers_get_newest_frame() -> None:
    with serving() as server, ExitStack() as stack:
        people = [stack.enter_context(looking(server)) for _ in range(64)]
        for events in people:
            assert next(events).kind == "hello"
        show(server, 7)
        assert [next(events).data["t"] for events in people] == 64 * [7.0]


def test_connection_over_limit_closes_oldest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.monitor.web.connection.MAX_CONNECTIONS", 4)
    # close no connection because it is silent
    monkeypatch.setattr("formation.monitor.web.connection.REQUEST_TIMEOUT_SECONDS", 1e6)
    with serving() as server, ExitStack() as stack:
        first = stack.enter_context(asleep(server))
        until(lambda: server.source._clients == 1)
        for _ in range(3):
            stack.enter_context(asleep(server))
        until(lambda: server.source._clients == 4)
        stack.enter_context(asleep(server))
        assert closed(first)
        until(lambda: server.source._clients == 4)
        assert len(server._server.server_state.connections) == 4


FLOODS = {
    "silent": b"",
    "half a head": b"GET / HT",
    "streams that are not read": REQUEST,
    "half a body": b"POST /api/replay HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    b"Content-Length: 100\r\n\r\n{",
    "idle after a request": b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
}
STOPS = 15


def flood(server: PageServer, words: bytes, many: int, addresses: int, stack: ExitStack) -> None:
    """Open `many` connections from `addresses` addresses of this machine; each sends `words`."""
    host, _, port = server.address.removeprefix("http://").rstrip("/").rpartition(":")
    for number in range(many):
        one = socket.create_connection(
            (host, int(port)), source_address=(f"127.0.0.{2 + number % addresses}", 0)
        )
        stack.enter_context(one)
        with suppress(OSError):  # the server may have closed it already
            one.sendall(words)


@pytest.mark.parametrize("addresses", [1, 200])
@pytest.mark.parametrize("words", FLOODS.values(), ids=FLOODS)
def test_stop_is_accepted_during_flood_of_connections(words: bytes, addresses: int) -> None:
    orders = OrderRecorder()
    with serving(control=orders, steer=Player().steer) as server, ExitStack() as stack:
        flood(server, words, 200, addresses, stack)
        for _ in range(STOPS):
            assert requested(server, "api/order", {"do": "stop"}, **BEARER).status_code == 200
            flood(server, words, 10, addresses, stack)
    assert len(orders.given) == STOPS


def test_connection_with_token_survives_flood_of_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.monitor.web.connection.MAX_CONNECTIONS", 4)
    # longer than the flood
    monkeypatch.setattr(server_module, "IDLE_TIMEOUT_SECONDS", round(PATIENCE))
    with serving(control=OrderRecorder()) as server, ExitStack() as stack:
        client = stack.enter_context(httpx.Client(base_url=server.address, timeout=PATIENCE, verify=PLAIN))
        assert client.get("/api/order", headers=BEARER).status_code == 204
        (own,) = server._server.server_state.connections
        flood(server, REQUEST, 50, 5, stack)
        assert client.post("/api/order", json={"do": "stop"}, headers=BEARER).status_code == 200
        assert own in server._server.server_state.connections


def test_operator_connection_keeps_standing_until_next_token_check(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(H11Protocol, "on_response_complete", lambda _: None)
    one: Any = Connection.__new__(Connection)
    one.scope = {OPERATOR: True}
    one.on_response_complete()
    one.scope = {}  # a second request has just begun
    assert one.rank is Rank.OPERATOR


def test_connections_of_one_address_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.monitor.web.connection.MAX_PER_ADDRESS", 5)
    with serving() as server, ExitStack() as stack, looking(server) as events:
        next(events)
        flood(server, REQUEST, 30, 1, stack)
        until(lambda: server.source._clients == 6)
        show(server, 1)
        assert next(events).data["t"] == 1.0


@pytest.mark.parametrize("words", [b"", b"GET / HT", b"POST /healthz HTTP/1.1\r\nHost: local"])
def test_connection_without_complete_request_is_closed(words: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.monitor.web.connection.REQUEST_TIMEOUT_SECONDS", 0.1)
    with serving() as server, dial(server) as one:
        one.sendall(words)
        assert closed(one)


def test_stream_outlasts_request_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.monitor.web.connection.REQUEST_TIMEOUT_SECONDS", 0.02)
    monkeypatch.setattr("formation.monitor.web.stream.COMMENT_PERIOD", 0.02)
    server = PageServer(ANY, source())
    with dial(server) as one:
        one.sendall(REQUEST)  # before the server starts: a busy machine may send it later than the timeout
        with server:
            received = b""
            while received.count(b"\n:\n") < 20:  # comments of the stream, far beyond the timeout
                more = one.recv(65536)
                assert more, "connection closed"
                received += more.replace(b"\r", b"")


def test_missing_body_is_answered_with_408(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.monitor.web.routes.READ_TIMEOUT_SECONDS", 0.1)
    head = (
        "POST /api/order HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        f"Authorization: Bearer {TOKEN}\r\nContent-Length: 100\r\n\r\n"
    )
    with serving(control=OrderRecorder()) as server, dial(server) as one:
        one.sendall(head.encode())
        assert one.recv(65536).startswith(b"HTTP/1.1 408 ")


def test_invalid_request_is_closed_without_log(caplog: pytest.LogCaptureFixture) -> None:
    with serving() as server:
        for words in (b"\x16\x03\x01\x02\x00\x01\x00\x01", b"\n\n\n\0\0\0" * 100, b"GET " + 100_000 * b"a"):
            with dial(server) as one:
                with suppress(OSError):  # the server may close before all is sent
                    one.sendall(words)
                    one.shutdown(socket.SHUT_WR)
                assert closed(one)
        assert httpx.get(server.address + "healthz", timeout=PATIENCE, verify=PLAIN).status_code == 200
    assert caplog.records == []


def test_stop_timeout_is_at_most_one_second() -> None:
    assert server_module.FORCED_CLOSE_SECONDS < server_module.STOP_TIMEOUT_SECONDS <= 1.0


def test_server_stops_with_open_connections(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_module, "STOP_TIMEOUT_SECONDS", PATIENCE)  # a busy machine may have more time
    with ExitStack() as stack:
        server = stack.enter_context(serving())
        people = [stack.enter_context(looking(server)) for _ in range(8)]
        for _ in range(8):
            stack.enter_context(asleep(server))
            stack.enter_context(dial(server))
        until(lambda: server.source._clients == 16)
        for number in range(50):
            show(server, number)
            assert [next(one).kind for one in people] == 8 * ["frame" if number else "hello"]
            time.sleep(0.01)
        server.stop()
        assert not server._thread.is_alive()
        with pytest.raises(ConnectionRefusedError):
            dial(server).close()
    assert caplog.records == []


def test_pending_order_does_not_delay_server_stop(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_module, "STOP_TIMEOUT_SECONDS", 0.5 * PATIENCE)  # the order takes longer
    orders = OrderRecorder()
    orders.hold.clear()
    with serving(control=orders) as server:

        def ask() -> None:
            with pytest.raises(httpx.HTTPError):
                requested(server, "api/order", {"do": "run"}, **BEARER)

        asking = threading.Thread(target=ask)
        asking.start()
        until(lambda: bool(orders.given))
        server.stop()
        assert not server._thread.is_alive()
        asking.join()
        orders.hold.set()
    assert caplog.records == []


def test_frame_is_encoded_once_for_all_clients(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    whole = module._json

    def making(value: Mapping[str, Any]) -> str:
        made.append(1)
        return whole(value)

    monkeypatch.setattr(module, "_json", making)
    with serving(source()) as server, ExitStack() as stack:
        people = [stack.enter_context(looking(server)) for _ in range(5)]
        for events in people:
            next(events)
        made.clear()
        show(server, 1)
        for events in people:
            next(events)
    assert made == [1]
