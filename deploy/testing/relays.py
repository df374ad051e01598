"""TCP relays on this machine, so that a test can cut the link between two processes."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine, Iterable
from contextlib import suppress
from typing import Any

HOST = "127.0.0.1"
CHUNK_BYTES = 65_536


class Relay:
    """Passes on what one process that dials it and the one at `port` send to each other.

    While it is cut, what they send waits, as in the buffers of a radio that is out of reach.
    """

    def __init__(self, port: int) -> None:
        self._target = port
        self._is_open = asyncio.Event()
        self._is_open.set()
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> int:
        """Listen; return the port."""
        self._server = await asyncio.start_server(self._connect, HOST, 0)
        port: int = self._server.sockets[0].getsockname()[1]
        return port

    def cut(self, *, is_cut: bool) -> None:
        """Cut the link, or mend it."""
        if is_cut:
            self._is_open.clear()
        else:
            self._is_open.set()

    def close(self) -> None:
        """Close every connection."""
        self._server.close()
        for task in self._tasks:
            task.cancel()

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None  # noqa: S101 - for the type checker
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        writers = [writer]
        try:
            await self._is_open.wait()
            there, back = await asyncio.open_connection(HOST, self._target)
            writers.append(back)
            passing = [asyncio.ensure_future(self._pass(*way)) for way in ((reader, back), (there, writer))]
            _, pending = await asyncio.wait(passing, return_when=asyncio.FIRST_COMPLETED)
            for way in pending:
                way.cancel()
        except (OSError, asyncio.CancelledError):  # nothing listens there yet, or the test ends
            pass
        finally:
            for one in writers:
                one.close()

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await reader.read(CHUNK_BYTES):
                await self._is_open.wait()
                writer.write(data)
                await writer.drain()


class Relays:
    """Relays of pairs of processes, in a thread."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._relays: dict[frozenset[str], Relay] = {}

    def add(self, one: str, other: str, port: int) -> int:
        """Relay between two processes, to the `port` of one of them; return the port to dial instead."""

        async def started() -> int:
            relay = self._relays[frozenset((one, other))] = Relay(port)
            return await relay.start()

        return int(self._wait(started()))

    def cut(self, pairs: Iterable[tuple[str, str]], *, is_cut: bool) -> None:
        """Cut the links of `pairs`, or mend them."""

        async def switch() -> None:
            for pair in pairs:
                if relay := self._relays.get(frozenset(pair)):
                    relay.cut(is_cut=is_cut)

        self._wait(switch())

    def close(self) -> None:
        """Close all of them."""

        async def end() -> None:
            for relay in self._relays.values():
                relay.close()
            await asyncio.sleep(0)  # so that cancelled tasks end

        self._wait(end())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _wait(self, what: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(what, self._loop).result()
