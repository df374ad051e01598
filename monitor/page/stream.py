"""Everybody who looks: one server-sent stream each, which carries the newest and queues nothing.

A client that does not read holds up itself alone. What is not yet sent when the next frame comes is skipped,
and who takes nothing at all for a while is hung up on.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress

from monitor.page.guard import Message, Receive, Send
from monitor.page.source import Look, Source

MOST = 64
"""Streams at a time; every one has a socket and a task."""
PATIENCE = 10.0
"""A client that takes nothing for so long is gone, or asleep; it dials again when it wakes [s]."""
IDLE = 2.0
"""After so long without news a comment goes out, which finds out who has gone [s]."""
FRESH = 1.0
"""How long a frame may take that was asked for [s]."""
HEADERS = [
    (b"content-type", b"text/event-stream; charset=utf-8"),
    (b"cache-control", b"no-store"),
    (b"x-accel-buffering", b"no"),
]
HangUp = Callable[[Message], None]


class Streams:
    """All streams of a server. Every method is for its thread."""

    def __init__(self, source: Source, hang_up: HangUp) -> None:
        """`hang_up` ends the connection of a request on the spot."""
        self._source, self._hang_up = source, hang_up
        self._wakes: set[asyncio.Event] = set()
        self._places, self._askers = 0, 0
        self._closed = False

    def wake(self) -> None:
        """There is news."""
        for one in self._wakes:
            one.set()

    def close(self) -> None:
        """End them all."""
        self._closed = True
        self.wake()

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        """Serve one client until it goes."""
        if scope["method"] == "HEAD":
            await _answer(send, 200, HEADERS)
            return
        if self._places >= MOST:
            await _answer(send, 503, [(b"retry-after", b"5")], b"too many are looking already\n")
            return
        self._looking(streams=+1)
        gone = asyncio.create_task(_gone(receive))
        try:
            await self._serve(send, gone)
        except TimeoutError:
            self._hang_up(scope)
            await gone
        finally:
            self._looking(streams=-1)
            gone.cancel()
            with suppress(asyncio.CancelledError):
                await gone

    async def fresh(self) -> Look | None:
        """The next frame, though nobody may be looking; None if none comes."""
        before = self._source.look
        wake = asyncio.Event()
        self._wakes.add(wake)
        self._looking(askers=+1)
        try:
            async with asyncio.timeout(FRESH):
                while (look := self._source.look) is before:
                    wake.clear()
                    await wake.wait()
        except TimeoutError:
            return None
        finally:
            self._wakes.discard(wake)
            self._looking(askers=-1)
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
                    async with asyncio.timeout(IDLE):
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

    def _looking(self, *, streams: int = 0, askers: int = 0) -> None:
        self._places += streams
        self._askers += askers
        self._source.looking(self._places + self._askers)


async def _answer(send: Send, status: int, headers: list[tuple[bytes, bytes]], body: bytes = b"") -> None:
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


async def _send(send: Send, chunk: bytes) -> None:
    async with asyncio.timeout(PATIENCE):
        await send({"type": "http.response.body", "body": chunk, "more_body": True})


async def _gone(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
