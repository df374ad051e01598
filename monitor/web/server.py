"""The page's server, in a separate thread, so that clients cannot delay the monitor.

Nothing that happens here affects the monitor: the server reads from a `Source` what the watching thread has
put there, and logs its own exceptions.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Self

import uvicorn
from starlette.types import Scope

from formation.monitor.web.address import PORT, Bind, listening
from formation.monitor.web.connection import Connection
from formation.monitor.web.guard import Guard, names_of
from formation.monitor.web.routes import Control, Steer, application
from formation.monitor.web.source import Source
from formation.monitor.web.stream import Streams

START_TIMEOUT_SECONDS = 5.0
"""Time for the thread to start [s]."""
STOP_TIMEOUT_SECONDS, FORCED_CLOSE_SECONDS = 1.0, 0.4
"""How long `stop` waits for the thread, and after how long it cuts open connections [s]."""
IDLE_TIMEOUT_SECONDS = 5
"""Time without a request after which a connection is closed [s]."""
MAX_HEAD_BYTES = 16 * 1024
"""Longest head of a request [bytes]."""
_log = logging.getLogger(__name__)
EXPOSED = "this page's token can be read by any machine on the way, which can then stop and drive the robots"
"""Warning about orders from a page that others can reach."""


class PageServer:
    """Serve the page, its stream and the metrics. Start it, best as a context manager."""

    def __init__(
        self, bind: Bind, source: Source, control: Control | None = None, steer: Steer | None = None
    ) -> None:
        """Take the port. Raises OSError on failure."""
        self.source = source
        """The source of the served data."""
        self._socket = listening(bind)
        self.address = bind.url(self._socket.getsockname()[1])
        """The page's URL: ``http://HOST:PORT/``, with a host for a browser on this machine."""
        self.invitation = self.address + (f"#token={control.token}" if control else "")
        """The URL for the operator, with the token. A browser does not send the part after #."""
        self._streams = Streams(source, self._hang_up)
        app = application(source, self._streams, control, steer)
        config = uvicorn.Config(
            Guard(app, names_of(socket.gethostname(), bind.host)),
            log_config=None, log_level="error", access_log=False, lifespan="off", ws="none",
            http=Connection, loop="asyncio", server_header=False, proxy_headers=False,
            timeout_keep_alive=IDLE_TIMEOUT_SECONDS, h11_max_incomplete_event_size=MAX_HEAD_BYTES,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._up = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start serving; steps are expected from now on."""
        self.source.step()
        self._thread.start()
        self._up.wait(START_TIMEOUT_SECONDS)

    def stop(self) -> None:
        """End every connection and the thread, within `STOP_TIMEOUT_SECONDS`. May be called twice."""
        self.source.set_wake(None)
        self._call_in_thread(self._end)
        if self._thread.is_alive():
            self._thread.join(STOP_TIMEOUT_SECONDS)
        self._socket.close()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except (Exception, SystemExit):  # noqa: BLE001 - the monitor goes on without a page
            _log.exception("the page is no longer served")
        finally:
            self._loop = None
            self.source.set_wake(None)
            self.source.set_clients(0)
            self._up.set()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.source.set_wake(lambda: self._call_in_thread(self._streams.wake))
        self._up.set()
        await self._server.serve(sockets=[self._socket])

    def _end(self) -> None:
        self._server.should_exit = True
        self._streams.close()
        asyncio.get_running_loop().call_later(FORCED_CLOSE_SECONDS, self._abort_all)

    def _abort_all(self) -> None:
        self._server.force_exit = True
        for one in list(self._server.server_state.connections):
            one.transport.abort()

    def _hang_up(self, request: Scope) -> None:
        for one in list(self._server.server_state.connections):
            if isinstance(one, Connection) and one.client == request["client"]:
                one.transport.abort()

    def _call_in_thread(self, do: Callable[[], None]) -> None:
        """Call `do` in the server's thread, if it still runs."""
        if (loop := self._loop) is not None:
            with suppress(RuntimeError):  # it has closed its loop meanwhile
                loop.call_soon_threadsafe(do)


def page_server(
    requested: Bind | None, source: Source, control: Control | None = None, steer: Steer | None = None
) -> PageServer:
    """Return a server at the `requested` address, by default at the usual port or, if that is taken, at any.

    It has the port and does not serve yet. Raises OSError if the requested address cannot be had.
    """
    try:
        return PageServer(requested or Bind(), source, control, steer)
    except OSError as error:
        if requested is not None or error.errno != errno.EADDRINUSE:
            raise
    return PageServer(Bind(port=0), source, control, steer)


def words(requested: Bind | None, server: PageServer) -> str:
    """Return the page's address for a log: without the token, but with the place to read it."""
    usual = requested is not None or server.address == Bind().url(PORT)
    where = server.address if usual else f"{server.address} (port {PORT} is taken)"
    invites = server.invitation != server.address
    return f"{where}; to give orders, the one in the ready line" if invites else where
