"""SO_LINGER is reset, so that closing a socket does not block."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

import pytest

from formation.transport.linger import CHECK_PERIOD, Linger, take_back

TEN_SECONDS = struct.pack("ii", 1, 10)


@pytest.fixture
def link() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Open both ends of a TCP link, with SO_LINGER as Zenoh sets it."""
    with socket.create_server(("127.0.0.1", 0)) as door, socket.create_connection(door.getsockname()) as near:
        far, _ = door.accept()
        with far:
            for end in (near, far):
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, TEN_SECONDS)
            yield near, far


def lingers(end: socket.socket) -> bool:
    on, _ = struct.unpack("ii", end.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))
    return bool(on)


def test_linger_option_is_removed_and_links_survive(
    link: tuple[socket.socket, socket.socket],
) -> None:
    near, far = link
    assert take_back() == 2
    assert not lingers(near)
    assert not lingers(far)
    near.sendall(b"still there")
    assert far.recv(64) == b"still there"
    assert take_back() == 0


def test_data_sent_before_close_are_delivered(link: tuple[socket.socket, socket.socket]) -> None:
    near, far = link
    take_back()
    near.sendall(b"last words" * 1000)
    near.close()
    received = b""
    while data := far.recv(65536):
        received += data
    assert received == b"last words" * 1000


def test_linger_checks_sockets_once_per_check_period(
    link: tuple[socket.socket, socket.socket],
) -> None:
    near, _ = link
    linger = Linger()
    linger.tend(100.0)
    assert not lingers(near)
    near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, TEN_SECONDS)
    linger.tend(100.0 + CHECK_PERIOD / 2)
    assert lingers(near)
    linger.tend(100.0 + CHECK_PERIOD)
    assert not lingers(near)


def test_take_back_ignores_unix_and_datagram_sockets() -> None:
    one, other = socket.socketpair()
    with one, other, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams:
        for end in (one, datagrams):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, TEN_SECONDS)
        assert take_back() == 0
        assert lingers(one)
        assert lingers(datagrams)
