"""The clients: one server-sent stream each, which carries the newest frame and queues nothing.

A client that does not read delays only itself. A frame not yet sent when the next one comes is skipped, and a
client that takes nothing for a while is disconnected.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress

from starlette.types import Receive, Scope, Send

from formation.monitor.web.source import Look, Source

MAX_STREAMS = 64
"""Most streams at a time; each has a socket and a task."""
STALLED_TIMEOUT_SECONDS = 10.0
"""Time without reading after which a client is disconnected [s]; it reconnects when it wakes."""
COMMENT_PERIOD = 2.0
"""Time without news after which a comment is sent, to detect clients that are gone [s]."""
MAX_FRAME_WAIT = 1.0
"""Longest wait for a requested frame [s]."""
HEADERS = [
    (b"content-type", b"text/event-stream; charset=utf-8"),
    (b"cache-control", b"no-store"),
    (b"x-accel-buffering", b"no"),
]


class Streams:
    """All streams of a server. Call the methods only in its thread."""

    def __init__(self, source: Source, hang_up: Callable[[Scope], None]) -> None:
        """`hang_up` ends the connection of a request at once."""
        self._source, self._hang_up = source, hang_up
        self._wakes: set[asyncio.Event] = set()
        self._stream_count, self._requesters = 0, 0
        self._closed = False

    def wake(self) -> None:
        """Wake all streams, as there is news."""
        for one in self._wakes:
            one.set()

    def close(self) -> None:
        """End all streams."""
        self._closed = True
        self.wake()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one client until it goes."""
        if scope["method"] == "HEAD":
            await _answer(send, 200, HEADERS)
            return
        if self._stream_count >= MAX_STREAMS:
            await _answer(
                send,
                503,
                [(b"retry-after", b"5")],
                b"%d pages are open, and more are not served: close one\n" % MAX_STREAMS,
            )
            return
        self._count_clients(streams=+1)
        gone = asyncio.create_task(_gone(receive))
        try:
            await self._serve(send, gone)
        except TimeoutError:
            self._hang_up(scope)
            await gone
        finally:
            self._count_clients(streams=-1)
            gone.cancel()
            with suppress(asyncio.CancelledError):
                await gone

    async def next_frame(self) -> Look | None:
        """Return the next frame, also without streams; None if none comes."""
        before = self._source.look
        wake = asyncio.Event()
        self._wakes.add(wake)
        self._count_clients(requesters=+1)
        try:
            async with asyncio.timeout(MAX_FRAME_WAIT):
                while (look := self._source.look) is before:
                    wake.clear()
                    await wake.wait()
        except TimeoutError:
            return None
        finally:
            self._wakes.discard(wake)
            self._count_clients(requesters=-1)
        return look

    async def _serve(self, send: Send, gone: asyncio.Task[None]) -> None:
        wake = asyncio.Event()
        wake.set()
        gone.add_done_callback(lambda _: wake.set())
        self._wakes.add(wake)
        epoch, event, number = -1, -1, -1
        try:
            await send({"type": "http.response.start", "status": 200, "headers": HEADERS})
            while True:
                with suppress(TimeoutError):
                    async with asyncio.timeout(COMMENT_PERIOD):
                        await wake.wait()
                wake.clear()
                if gone.done() or self._closed:
                    break
                chunks = []
                if epoch != self._source.epoch:
                    greeting, epoch, event = self._source.greeting()
                    chunks.append(greeting)
                event, news = self._source.events(event)
                chunks.append(news)
                if (look := self._source.look) is not None and look.number != number:
                    number = look.number
                    chunks.append(look.chunk)
                await _send(send, b"".join(chunks) or b":\n\n")
            if not gone.done():
                await send({"type": "http.response.body", "body": b"", "more_body": False})
        finally:
            self._wakes.discard(wake)

    def _count_clients(self, *, streams: int = 0, requesters: int = 0) -> None:
        self._stream_count += streams
        self._requesters += requesters
        self._source.set_clients(self._stream_count + self._requesters)


async def _answer(send: Send, status: int, headers: list[tuple[bytes, bytes]], body: bytes = b"") -> None:
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


async def _send(send: Send, chunk: bytes) -> None:
    async with asyncio.timeout(STALLED_TIMEOUT_SECONDS):
        await send({"type": "http.response.body", "body": chunk, "more_body": True})


async def _gone(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
