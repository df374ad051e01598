"""The page's address on this machine, and its listening socket."""

from __future__ import annotations

import errno
import ipaddress
import socket
from typing import NamedTuple
from urllib.parse import urlsplit

HOST, PORT = "127.0.0.1", 8460
SEND_BUFFER_BYTES = 64 * 1024
"""Send buffer for one client [bytes]; a slow one has old frames in it."""
BACKLOG_CONNECTIONS = 64
EVERYWHERE = ("0.0.0.0", "::")  # noqa: S104 - only on request
ELSEWHERE = ("192.0.2.1", 9)
"""An address reserved for examples."""


class Bind(NamedTuple):
    """The address to listen on."""

    host: str = HOST
    port: int = PORT
    """0 for any free one."""

    @classmethod
    def of(cls, text: str) -> Bind:
        """Parse ``HOST:PORT``, ``[IPV6]:PORT`` or ``PORT``. Raises ValueError, which states what is legal."""
        try:
            parts = urlsplit(f"//{HOST}:{text}" if text.isdecimal() else f"//{text}")
            host, port = parts.hostname, parts.port
        except ValueError:
            host, port = None, None
        if not host or port is None or "@" in text or "/" in text:
            raise ValueError(f"{text!r}: must be HOST:PORT, such as {HOST}:{PORT}, or a PORT (0: any)")
        return cls(host, port)

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    @property
    def is_of_this_machine(self) -> bool:
        """Whether only this machine can reach it."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    def url(self, port: int) -> str:
        """Return the URL for a browser, also on other machines if they may connect."""
        host = _outward() if self.host in EVERYWHERE else self.host
        return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"


def listening(bind: Bind) -> socket.socket:
    """Return a listening socket. Raises OSError."""
    family, kind, protocol, _, address = socket.getaddrinfo(
        bind.host, bind.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
    )[0]
    one = socket.socket(family, kind, protocol)
    try:
        if bind.port:  # connections of the last run may linger; port 0 must give an unused port
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        one.setsockopt(
            socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES
        )  # accepted connections inherit it
        one.bind(address)
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # nor may ours block the next run
        one.listen(BACKLOG_CONNECTIONS)
        one.setblocking(False)
    except OSError:
        one.close()
        raise
    return one


def is_taken(error: OSError) -> bool:
    """Return whether the port is in use."""
    return error.errno == errno.EADDRINUSE


def _outward() -> str:
    """Return our address as seen by others, or the loopback address without a network. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(ELSEWHERE)
        except OSError:
            return HOST
        return str(probe.getsockname()[0])
