"""The page's server: a thread of its own, so that whoever looks cannot hold up who watches.

Nothing that happens here reaches the monitor: the server reads from a `Source` what the watching thread has
put there, and an exception of its own ends in the log.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Self

import uvicorn

from monitor.page.address import Bind, listening
from monitor.page.connection import Connection
from monitor.page.guard import App, Guard, Message, Receive, Send, names_of
from monitor.page.routes import application
from monitor.page.seams import Control, Replay
from monitor.page.source import Source
from monitor.page.stream import Streams

STARTING = 5.0
"""How long the thread has to come up [s]."""
STOPPING, FORCED = 1.0, 0.4
"""How long `stop` waits for the thread, and after how long connections are cut that have not ended [s]."""
IDLE = 5
"""A connection that asks nothing for so long is closed [s]."""
LONGEST_HEAD = 16 * 1024
"""Of a request [bytes]."""
_log = logging.getLogger(__name__)


class PageServer:
    """Serves the page, its stream and the figures. Start it, best as a context manager."""

    def __init__(
        self, bind: Bind, source: Source, control: Control | None = None, replay: Replay | None = None
    ) -> None:
        """Take the port. Raises OSError if it cannot be had."""
        self.source = source
        """Where it takes from what it serves."""
        self._socket = listening(bind)
        self.address = bind.url(self._socket.getsockname()[1])
        """Where the page is: ``http://HOST:PORT/``, with a host that a browser of this machine can dial."""
        self.invitation = self.address + (f"#token={control.token}" if control else "")
        """The same for the operator, with the token. A browser keeps what follows # to itself."""
        self._streams = Streams(source, self._hang_up)
        app = application(source, self._streams, control, replay)
        config = uvicorn.Config(
            _cut_off_quietly(Guard(app, names_of(socket.gethostname(), bind.host))),
            log_config=None, log_level="error", access_log=False, lifespan="off", ws="none",
            http=Connection, loop="asyncio", server_header=False, proxy_headers=False,
            timeout_keep_alive=IDLE, h11_max_incomplete_event_size=LONGEST_HEAD,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._up = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()
        self._up.wait(STARTING)

    def stop(self) -> None:
        """End every connection and the thread, within `STOPPING`. Doing so twice does no harm."""
        self.source.wakes(None)
        self._call(self._end)
        if self._thread.is_alive():
            self._thread.join(STOPPING)
        self._socket.close()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except (Exception, SystemExit):  # noqa: BLE001 - the monitor goes on without a page
            _log.exception("the page is no longer served")
        finally:
            self._loop = None
            self.source.wakes(None)
            self.source.looking(0)
            self._up.set()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.source.wakes(lambda: self._call(self._streams.wake))
        self._up.set()
        await self._server.serve(sockets=[self._socket])

    def _end(self) -> None:
        self._server.should_exit = True
        self._streams.close()
        asyncio.get_running_loop().call_later(FORCED, self._cut)

    def _cut(self) -> None:
        self._server.force_exit = True
        for one in list(self._server.server_state.connections):
            one.transport.abort()

    def _hang_up(self, request: Message) -> None:
        for one in list(self._server.server_state.connections):
            if isinstance(one, Connection) and one.client == request["client"]:
                one.transport.abort()

    def _call(self, do: Callable[[], None]) -> None:
        """Have the server's thread do something, if it still lives."""
        if (loop := self._loop) is not None:
            with suppress(RuntimeError):  # it has closed its loop meanwhile
                loop.call_soon_threadsafe(do)


def _cut_off_quietly(app: App) -> App:
    """`app`, but requests that are under way when the server ends are no errors."""

    async def serve(scope: Message, receive: Receive, send: Send) -> None:
        with suppress(asyncio.CancelledError):
            await app(scope, receive, send)

    return serve
