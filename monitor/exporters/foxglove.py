"""A live server for Foxglove: it sends what is recorded, as it arrives.

It only sends: no client publishes, calls or sets anything, so no robot can be moved through it. It runs in
threads of the SDK, which hold no lock of ours. A client that reads too slowly loses its oldest waiting
messages, and nothing waits for a client.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Self

import foxglove
from foxglove import Channel, Context, Schema

from formation.monitor.metrics.keys import Watched
from formation.monitor.recording.channels import SUFFIX, TYPE, packed_attachment
from formation.monitor.web.address import Bind
from formation.ros2.definitions import definition
from formation.wire import Sample

MAX_WAITING_MESSAGES = 8192
"""Messages that may wait for one client: more than a second of a hundred robots."""


class Foxglove:
    """The server, from its construction until `stop`."""

    def __init__(self, host: str, port: int, name: str, keys: Iterable[Watched]) -> None:
        """Serve `keys` on `host`:`port`; port 0 takes any free one. Raises OSError."""
        self._context = Context()
        self._channels = {one.key: self._channel(one.key, one.topic.type) for one in keys}
        self._attached: dict[str, Channel] = {}
        try:
            self._server = foxglove.start_server(
                name=name, host=host, port=port, capabilities=[], context=self._context,
                message_backlog_size=MAX_WAITING_MESSAGES,
            )  # fmt: skip
        except RuntimeError as error:
            self._close()
            why = str(error).rpartition(": ")[2].partition(" (os error")[0].lower()
            raise OSError(why) from None
        self.address = f"ws://{Bind(host, self._server.port)}"
        """The address to open in Foxglove."""

    def forward_sample(self, sample: Sample, wall: float) -> None:
        """Send one message, as received, that arrived at `wall` [s, our system clock]."""
        channel = self._channels.get(sample.key)
        if channel is None:
            return
        at = round(wall * 1e9)
        if sample.attachment is not None:
            self._tell_attached(sample.key, sample.attachment, at)
        if channel.has_sinks():
            channel.log(sample.payload, log_time=at)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Disconnect all clients. May be called twice."""
        self._server.stop()
        self._close()

    def _tell_attached(self, key: str, attachment: bytes, at: int) -> None:
        """Send an attachment on a topic of its own, as in the recording, made when first needed."""
        channel = self._attached.get(key)
        if channel is None:
            channel = self._attached[key] = self._channel(key + SUFFIX, TYPE)
        if channel.has_sinks() and (text := packed_attachment(attachment)) is not None:
            channel.log(text, log_time=at)

    def _channel(self, key: str, ros_type: str) -> Channel:
        schema = Schema(name=ros_type, encoding="ros2msg", data=definition(ros_type).encode())
        return Channel(f"/{key}", message_encoding="cdr", schema=schema, context=self._context)

    def _close(self) -> None:
        for channel in (*self._channels.values(), *self._attached.values()):
            channel.close()
