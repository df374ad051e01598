"""Viewers of a page in a test: server-sent events over real HTTP, and a server with nothing behind it."""

from __future__ import annotations

import json
import socket
import ssl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import httpx

from formation.mission.file import load
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.web import frames
from formation.monitor.web.address import Bind
from formation.monitor.web.routes import Control, Steer
from formation.monitor.web.server import PageServer
from formation.monitor.web.source import Source
from tests.support.child import PATIENCE
from tests.support.monitored import Fleet, now, received

MISSION = load("six_robots")
ANY = Bind(port=0)
PLAIN = ssl.create_default_context()
"""Nothing here is under TLS, but httpx would read all certificates of the machine for each client."""


class Received(NamedTuple):
    """One server-sent event."""

    id: str
    kind: str
    data: Any


def source(mono: Callable[[], float] = lambda: 0.0, **about: Any) -> Source:
    """A source for a page. By its clock of steps, `mono` [s], no time passes unless one is given."""
    hello = frames.hello(MISSION, live=True, control=False, version="0")
    return Source({**hello, **about}, lambda: 1234.5, mono)


def seen() -> Snapshot:
    """A fleet that has been received for a second."""
    metrics = received(Fleet(), *Fleet().positions(10.0, 11.0))
    metrics.observe(now(11.0))
    return metrics.snapshot(now(11.0))


SEEN = seen()


@contextmanager
def serving(
    one: Source | None = None, control: Control | None = None, steer: Steer | None = None
) -> Iterator[PageServer]:
    with PageServer(ANY, one or source(), control, steer) as server:
        yield server


@contextmanager
def looking(page: PageServer | str) -> Iterator[Iterator[Received]]:
    """A page that is open, of a server or at an address: its events as they come."""
    address = page if isinstance(page, str) else page.address
    with (
        httpx.Client(base_url=address, timeout=PATIENCE, verify=PLAIN) as client,
        client.stream("GET", "/stream") as response,
    ):
        assert response.status_code == 200
        assert response.headers["content-type"].startswith("text/event-stream")
        yield _events(response.iter_lines())


def dial(server: PageServer) -> socket.socket:
    """A connection, and nothing said yet."""
    host, _, port = server.address.removeprefix("http://").rstrip("/").rpartition(":")
    return socket.create_connection((host, int(port)), timeout=PATIENCE)


def _events(lines: Iterator[str]) -> Iterator[Received]:
    fields: dict[str, str] = {}
    for line in lines:
        name, _, value = line.partition(": ")
        if name in {"id", "event", "data"}:
            fields[name] = value
        elif not line and fields:
            yield Received(fields["id"], fields["event"], json.loads(fields["data"]))
            fields = {}
