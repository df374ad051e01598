"""One client's connection: what it may hold of us, and for how long.

Sockets, memory and patience are the monitor's own, and whoever can reach the page could use them up: so there
are only so many connections, nothing is queued for who does not read, and who asks nothing is hung up on.
"""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

MOST = 128
"""Connections at a time."""
ASKING = 5.0
"""A request that has not come whole within one to two of these is not waited for [s]."""


class Connection(H11Protocol):
    """As uvicorn's, with limits."""

    _look: asyncio.TimerHandle | None = None
    _waited = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A client has dialled."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=0)  # the next frame is not sent before this one is gone
        if len(self.connections) > MOST:
            transport.abort()
            return
        self._look = self.loop.call_later(ASKING, self._hurry)

    def connection_lost(self, exc: Exception | None) -> None:
        """It has gone."""
        if self._look is not None:
            self._look.cancel()
        super().connection_lost(exc)

    def _hurry(self) -> None:
        request: RequestResponseCycle | None = getattr(self, "cycle", None)  # None before the first one
        answered = request is None or request.response_complete
        waits = answered and self.timeout_keep_alive_task is None
        if waits and self._waited:
            self.transport.abort()
            return
        self._waited = waits
        self._look = self.loop.call_later(ASKING, self._hurry)
