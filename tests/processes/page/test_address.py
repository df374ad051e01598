from __future__ import annotations

import errno
import socket

import pytest

from formation.monitor.web.address import Bind, listening
from tests.support.child import PATIENCE

EVERYWHERE = "0.0.0.0"  # noqa: S104 - the address under test


@pytest.mark.parametrize(
    ("text", "bind"),
    [
        ("127.0.0.1:8460", Bind("127.0.0.1", 8460)),
        (f"{EVERYWHERE}:80", Bind(EVERYWHERE, 80)),
        ("desk.local:0", Bind("desk.local", 0)),
        ("[::1]:8460", Bind("::1", 8460)),
        ("8460", Bind("127.0.0.1", 8460)),
    ],
)
def test_bind_parses_host_and_port_or_only_port(text: str, bind: Bind) -> None:
    assert Bind.of(text) == bind
    assert Bind.of(str(bind)) == bind


@pytest.mark.parametrize(
    "text", ["", "desk", "desk:", ":8460", "desk:http", "1:99999", "http://desk:1/", "a@b:1"]
)
def test_bad_address_is_refused_with_example(text: str) -> None:
    with pytest.raises(ValueError, match=r"must be HOST:PORT, such as 127\.0\.0\.1:8460") as refused:
        Bind.of(text)
    assert repr(text) in str(refused.value)


@pytest.mark.parametrize(
    ("bind", "url"),
    [
        (Bind("127.0.0.1", 0), "http://127.0.0.1:81/"),
        (Bind("::1", 0), "http://[::1]:81/"),
        (Bind("desk", 0), "http://desk:81/"),
    ],
)
def test_url_contains_host_and_given_port(bind: Bind, url: str) -> None:
    assert bind.url(81) == url


@pytest.mark.parametrize("everywhere", [EVERYWHERE, "::"])
def test_url_on_all_interfaces_is_reachable(everywhere: str) -> None:
    with listening(Bind(everywhere, 0)) as one:
        port = one.getsockname()[1]
        host, _, reported = Bind(everywhere, 0).url(port).removeprefix("http://").rstrip("/").rpartition(":")
        assert reported == str(port)
        socket.create_connection((host, port), timeout=PATIENCE).close()


def test_url_without_network_is_loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    # no route without permission to broadcast
    monkeypatch.setattr("formation.monitor.web.address.ELSEWHERE", ("255.255.255.255", 9))
    assert Bind(EVERYWHERE, 0).url(81) == "http://127.0.0.1:81/"


@pytest.mark.parametrize(
    ("host", "own"),
    [("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("localhost", True), ("desk", False),
     (EVERYWHERE, False), ("::", False), ("192.168.1.2", False)],
)  # fmt: skip
def test_only_loopback_hosts_are_of_this_machine(host: str, own: bool) -> None:
    assert Bind(host).is_of_this_machine is own


def test_taken_port_is_distinguished_from_foreign_address() -> None:
    with listening(Bind(port=0)) as one:
        with pytest.raises(OSError) as refused:  # noqa: PT011 - its errno is checked below
            listening(Bind(port=one.getsockname()[1]))
        assert refused.value.errno == errno.EADDRINUSE
    with pytest.raises(OSError) as refused:  # noqa: PT011 - likewise
        listening(Bind("192.0.2.1", 0))
    assert refused.value.errno != errno.EADDRINUSE
    with pytest.raises(socket.gaierror):
        listening(Bind("no-such-host.invalid", 0))
