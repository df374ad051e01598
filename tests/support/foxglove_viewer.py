"""What Foxglove is, as far as a server can tell: a client that speaks its protocol, written for tests."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

PROTOCOL = "foxglove.sdk.v1"
_MESSAGE = struct.Struct("<BIQ")  # what it is, subscription, time


class Message(NamedTuple):
    """One message."""

    topic: str
    at: int
    """[ns]"""
    payload: bytes


class Viewer:
    """One connection."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection
        self.info = self._published("serverInfo")
        self.channels: dict[str, dict[str, Any]] = {}
        """Advertised ones, by topic."""
        self.statuses: list[dict[str, Any]] = []
        self._topics: dict[int, str] = {}

    def advertised(self, number: int) -> None:
        """Wait until so many channels are."""
        while len(self.channels) < number:
            self._learn(json.loads(self.connection.recv(timeout=30.0)))

    def warned(self, number: int) -> None:
        """Wait until the server has had so many things to say about what this client sent."""
        while len(self.statuses) < number:
            self._learn(json.loads(self.connection.recv(timeout=30.0)))

    def subscribe(self, *topics: str) -> None:
        wanted = [self.channels[topic]["id"] for topic in topics]
        self._topics.update(zip(wanted, topics, strict=True))
        self.say(op="subscribe", subscriptions=[{"id": one, "channelId": one} for one in wanted])

    def say(self, **message: Any) -> None:
        self.connection.send(json.dumps(message))

    def receive(self) -> Message:
        while True:
            data = self.connection.recv(timeout=30.0)
            if isinstance(data, str):
                self._learn(json.loads(data))
                continue
            kind, subscription, at = _MESSAGE.unpack_from(data)
            if kind == 1:
                return Message(self._topics[subscription], at, data[_MESSAGE.size :])

    def _learn(self, message: dict[str, Any]) -> None:
        if message["op"] == "advertise":
            self.channels |= {channel["topic"]: channel for channel in message["channels"]}
        elif message["op"] == "status":
            self.statuses.append(message)

    def _published(self, op: str) -> dict[str, Any]:
        message: dict[str, Any] = json.loads(self.connection.recv(timeout=30.0))
        assert message["op"] == op
        return message


@contextmanager
def viewing(address: str, **options: Any) -> Iterator[Viewer]:
    """A client of the server at `address`."""
    with connect(
        address, subprotocols=[Subprotocol(PROTOCOL)], open_timeout=30.0, max_size=None, **options
    ) as connection:
        assert connection.subprotocol == PROTOCOL
        yield Viewer(connection)
