from __future__ import annotations

import socket

import pytest

from monitor.page.address import Bind, is_taken, listening

EVERYWHERE = "0.0.0.0"  # noqa: S104 - it is read here, and nothing listens on it


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
def test_an_address_is_a_host_and_a_port_or_a_port_of_this_machine(text: str, bind: Bind) -> None:
    assert Bind.of(text) == bind
    assert Bind.of(str(bind)) == bind


@pytest.mark.parametrize(
    "text", ["", "desk", "desk:", ":8460", "desk:http", "1:99999", "http://desk:1/", "a@b:1"]
)
def test_what_is_none_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(ValueError, match=r"must be HOST:PORT, such as 127\.0\.0\.1:8460") as refused:
        Bind.of(text)
    assert repr(text) in str(refused.value)


@pytest.mark.parametrize(
    ("bind", "url"),
    [
        (Bind("127.0.0.1", 0), "http://127.0.0.1:81/"),
        (Bind(EVERYWHERE, 0), "http://127.0.0.1:81/"),
        (Bind("::", 0), "http://[::1]:81/"),
        (Bind("desk", 0), "http://desk:81/"),
    ],
)
def test_a_browser_of_this_machine_gets_an_address_that_it_can_dial(bind: Bind, url: str) -> None:
    assert bind.url(81) == url


def test_a_port_that_is_taken_is_told_from_an_address_that_is_not_ours() -> None:
    with listening(Bind(port=0)) as one:
        with pytest.raises(OSError) as refused:  # noqa: PT011 - which one is asked below
            listening(Bind(port=one.getsockname()[1]))
        assert is_taken(refused.value)
    with pytest.raises(OSError) as refused:  # noqa: PT011 - likewise
        listening(Bind("192.0.2.1", 0))
    assert not is_taken(refused.value)
    with pytest.raises(socket.gaierror):
        listening(Bind("no-such-host.invalid", 0))
