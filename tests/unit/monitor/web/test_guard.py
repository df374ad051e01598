from __future__ import annotations

import asyncio
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.types import Message, Receive, Scope, Send

from formation.monitor.web.guard import Guard, host_is_ours, names_of, origin_is_ours

NAMES = names_of("Desk.example.org", "127.0.0.1")


@pytest.mark.parametrize(
    "host",
    [
        "localhost", "localhost:8460", "127.0.0.1:8460", "[::1]:8460", "192.168.1.20:8460", "desk:8460",
        "DESK", "desk.local:1", "desk.example.org", "desk.example.org.:8460",
    ],
)  # fmt: skip
def test_host_addresses_and_names_of_machine_are_accepted(host: str) -> None:
    assert host_is_ours(host, NAMES)


@pytest.mark.parametrize(
    "host",
    [
        "", ":8460", "attacker.example", "attacker.example:8460", "localhost.attacker.example",
        "127.0.0.1.attacker.example", "desk.attacker.example", "127.0.0.1@attacker.example", "desk:http",
        "127.0.0.1:8460/attacker.example", "[::1", "1.2.3", "0x7f000001.attacker", "desk example",
    ],
)  # fmt: skip
def test_foreign_host_is_refused(host: str) -> None:
    assert not host_is_ours(host, NAMES)


@given(st.text())
def test_random_host_is_checked_without_error(host: str) -> None:
    assert not host_is_ours(f"{host}.attacker", NAMES)
    host_is_ours(host, NAMES)


def test_name_that_page_is_bound_to_is_accepted() -> None:
    assert host_is_ours("fleet.example:80", names_of("desk", "Fleet.example"))


@pytest.mark.parametrize("origin", [None, "http://desk:8460", "http://DESK:8460"])
def test_origin_of_own_page_is_accepted(origin: str | None) -> None:
    assert origin_is_ours(origin, "desk:8460")


@pytest.mark.parametrize(
    "origin", ["http://desk:8461", "https://desk:8460", "http://attacker.example", "null", ""]
)
def test_origin_of_another_page_is_refused(origin: str) -> None:
    assert not origin_is_ours(origin, "desk:8460")


def answered(method: str = "GET", path: str = "/", **headers: str) -> tuple[int, dict[str, str]]:
    """Status and headers of the reply to a request; 299 if the guard passed the request on."""
    sent: list[Message] = []

    async def app(_scope: Scope, _receive: Receive, send: Send) -> None:
        await send({"type": "http.response.start", "status": 299, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    async def send(message: Message) -> None:
        sent.append(message)

    async def receive() -> Message:
        raise AssertionError("the guard must not read the body")

    where, _, query = path.partition("?")
    scope: dict[str, Any] = {
        "type": "http",
        "method": method,
        "raw_path": where.encode(),
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode("latin-1")) for name, value in headers.items()],
    }
    asyncio.run(Guard(app, NAMES)(scope, receive, send))
    assert sent[-1]["type"] == "http.response.body"
    return sent[0]["status"], {name.decode(): value.decode() for name, value in sent[0]["headers"]}


def test_foreign_hosts_origins_and_long_paths_are_refused() -> None:
    assert answered(host="desk:8460")[0] == 299
    assert answered(host="attacker.example")[0] == 421
    assert answered()[0] == 421
    assert answered("POST", host="desk", origin="http://desk")[0] == 299
    for method, code in (
        ("POST", 403),
        ("DELETE", 403),
        ("GET", 299),
    ):  # browsers keep replies to GET from the page
        assert answered(method, host="desk", origin="http://attacker.example")[0] == code
    for path in ("/" + 2000 * "a", "/?" + 2000 * "a"):
        assert answered(path=path, host="desk")[0] == 414


@pytest.mark.parametrize("host", ["desk", "attacker.example"])
def test_every_reply_has_security_headers(host: str) -> None:
    headers = answered(host=host)[1]
    policy = headers["content-security-policy"]
    assert policy.startswith("default-src 'self';")
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert "access-control-allow-origin" not in headers
    assert headers.items() >= {
        "x-content-type-options": "nosniff", "x-frame-options": "DENY", "referrer-policy": "no-referrer",
        "cross-origin-opener-policy": "same-origin", "cross-origin-resource-policy": "same-origin",
    }.items()  # fmt: skip
