"""Where the page is served: an address of this machine, and the socket that listens there."""

from __future__ import annotations

import errno
import ipaddress
import socket
from typing import NamedTuple
from urllib.parse import urlsplit

HOST, PORT = "127.0.0.1", 8460
SEND_BUFFER = 64 * 1024
"""What the system may hold back for one client [bytes]: old frames, if it is slow."""
BACKLOG = 64
EVERYWHERE = ("0.0.0.0", "::")  # noqa: S104 - what somebody may ask for
ELSEWHERE = ("192.0.2.1", 9)
"""Nobody: an address that is kept for examples."""


class Bind(NamedTuple):
    """What to listen on."""

    host: str = HOST
    port: int = PORT
    """0 for any that is free."""

    @classmethod
    def of(cls, text: str) -> Bind:
        """Read ``HOST:PORT``, ``[IPV6]:PORT`` or ``PORT``. Raises ValueError, which says what is legal."""
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
        """Whether nobody else can reach it."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    def url(self, port: int) -> str:
        """What a browser dials when `port` is listened on; where everybody may, one elsewhere too."""
        host = _outward() if self.host in EVERYWHERE else self.host
        return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"


def listening(bind: Bind) -> socket.socket:
    """A socket that listens. Raises OSError."""
    family, kind, protocol, _, address = socket.getaddrinfo(
        bind.host, bind.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
    )[0]
    one = socket.socket(family, kind, protocol)
    try:
        if bind.port:  # connections of the last run may linger; who asks for any port wants one of his own
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        one.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)  # clients inherit it
        one.bind(address)
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # nor shall ours be in the way of the next
        one.listen(BACKLOG)
        one.setblocking(False)
    except OSError:
        one.close()
        raise
    return one


def is_taken(error: OSError) -> bool:
    """Whether the port is somebody else's."""
    return error.errno == errno.EADDRINUSE


def _outward() -> str:
    """Our address as others see it, or of this machine alone if it is in no network. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(ELSEWHERE)
        except OSError:
            return HOST
        return str(probe.getsockname()[0])
