"""The page's address on this machine, its listening socket, and the flags for them."""

from __future__ import annotations

import argparse
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
NOT_HERE = "this machine does not have it; 0.0.0.0 stands for all addresses that it has"
IN_USE = "another program listens there; choose another port, or end it (ss -ltnp shows it)"
ADVICE = {errno.EADDRNOTAVAIL: NOT_HERE, errno.EADDRINUSE: IN_USE}
"""By the number of the operating system's error."""
ELSEWHERE = ("192.0.2.1", 9)
"""An address reserved for examples."""
PAGE_HELP = """\
For this machine alone, unless --page names another address. --page 0.0.0.0:8460 shows it to every
machine that can reach this one: they see all robots, over plain HTTP that can be read on the way.
"""
ORDERS = """\
With --control they need the token to give orders, but plain HTTP carries the token, too. Do
that only in a network where every member may stop and drive the robots.
"""
CONTROL = """\
buttons for stop, hold, run, release and shape, a pad to drive, a route; shown if the page is opened by its
whole address: the token in it is new at every start\
"""


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
        return f"http://{Bind(_outward() if self.host in EVERYWHERE else self.host, port)}/"


def listening(bind: Bind) -> socket.socket:
    """Return a listening socket. Raises OSError."""
    family, kind, protocol, _, address = socket.getaddrinfo(
        bind.host, bind.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
    )[0]
    one = socket.socket(family, kind, protocol)
    try:
        if bind.port:  # connections of the last run may linger; port 0 must give an unused port
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # accepted connections inherit it
        one.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        one.bind(address)
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # nor may ours block the next run
        one.listen(BACKLOG_CONNECTIONS)
        one.setblocking(False)
    except OSError as error:
        one.close()
        if (advice := ADVICE.get(error.errno or 0)) is not None:
            raise OSError(error.errno, f"{error.strerror}: {advice}") from None
        raise
    return one


def _outward() -> str:
    """Return our address as seen by others, or the loopback address without a network. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(ELSEWHERE)
        except OSError:
            return HOST
        return str(probe.getsockname()[0])


def add_page_flags(flags: argparse.ArgumentParser, *, control: bool = True) -> argparse._ArgumentGroup:
    """Add ``--page``, ``--no-page`` and, for a page that gives orders, ``--control``; return their group."""
    page = flags.add_argument_group("the live page", PAGE_HELP + (ORDERS if control else ""))
    where = page.add_mutually_exclusive_group()
    where.add_argument(
        "--page", metavar="HOST:PORT", type=bind_flag,
        help=f"where to serve it (default: {HOST}:{PORT}, or any other port if that is taken)",
    )  # fmt: skip
    where.add_argument("--no-page", action="store_true", help="serve none, and no metrics for Prometheus")
    if control:
        page.add_argument("--control", action="store_true", help=CONTROL)
    return page


def bind_flag(text: str, port: int = PORT) -> Bind:
    """Return the address that a flag names; `port` is that of the example if it is no address."""
    try:
        return Bind.of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error).replace(f":{PORT}", f":{port}")) from None
