"""One client's connection, with limits on number and time, and the choice of one to drop.

Clients could use up the monitor's sockets, memory and time. So the number of connections is limited, in all
and per address; nothing is queued for a client that does not read; and a client without a request is
disconnected. A new connection is always accepted: it replaces one that has not shown the operator's token, so
that a stop always gets through.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Mapping
from enum import IntEnum
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

MAX_CONNECTIONS = 128
"""Most connections at a time, of all addresses."""
MAX_PER_ADDRESS = 96
"""Most connections of one address: a router, or this machine, may have many browsers."""
REQUEST_TIMEOUT_SECONDS = 5.0
"""A request that is incomplete after one to two of these is given up [s]."""
FIRST_REQUEST_TIME = 1.0
"""Time for a connection's first request before it counts as silent [s]."""
OPERATOR = "formation.operator"
"""Key in a request's scope: it carried the operator's token."""


class Rank(IntEnum):
    """Rank of a connection; the lowest is dropped first."""

    SILENT = 0
    """No complete request, although there was time for one."""
    IDLE = 1
    """Between two requests."""
    BUSY = 2
    """With a request under way, such as a stream."""
    NEW = 3
    """No complete request yet, but still time for one."""
    OPERATOR = 4
    """Has carried the operator's token. Never dropped."""


class Connection(H11Protocol):
    """Uvicorn's connection, with limits."""

    _timer: asyncio.TimerHandle | None = None
    _waited = False
    since = 0.0
    """When it was made [s, loop's clock]."""
    gone = False
    """Whether it was aborted, even if the loop has not reported it yet."""
    _operator = False
    """Whether an earlier request carried the operator's token; this one may be unchecked."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept a client's connection."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=0)  # the next frame is not sent before this one is gone
        self.since = self.loop.time()
        self._make_room()
        if not self.gone:
            self._timer = self.loop.call_later(REQUEST_TIMEOUT_SECONDS, self._drop_if_idle)

    def connection_lost(self, exc: Exception | None) -> None:
        """Handle the end of the connection."""
        self.gone = True
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """Handle the end of a response."""
        self._operator = self.rank is Rank.OPERATOR
        super().on_response_complete()

    @property
    def address(self) -> str:
        """The client's address, without port."""
        return self.client[0] if self.client else ""

    @property
    def rank(self) -> Rank:
        """Its rank now."""
        scope: Mapping[str, Any] | None = getattr(self, "scope", None)  # None before the first request
        if self._operator or (scope is not None and scope.get(OPERATOR)):
            return Rank.OPERATOR
        request: RequestResponseCycle | None = getattr(self, "cycle", None)
        if request is None:
            return Rank.NEW if self.loop.time() - self.since < FIRST_REQUEST_TIME else Rank.SILENT
        return Rank.IDLE if request.response_complete else Rank.BUSY

    def drop(self) -> None:
        """Disconnect at once."""
        self.gone = True
        self.transport.abort()

    def _make_room(self) -> None:
        """Keep within the limits, by dropping another connection, or this one if no other may be dropped."""
        open_connections = [one for one in self.connections if isinstance(one, Connection) and not one.gone]
        counts = Counter(one.address for one in open_connections)
        if counts[self.address] > MAX_PER_ADDRESS:
            open_connections = [one for one in open_connections if one.address == self.address]
        elif len(open_connections) <= MAX_CONNECTIONS:
            return
        others = [one for one in open_connections if one is not self and one.rank is not Rank.OPERATOR]
        # drop from the address with the most connections the lowest rank, then the oldest
        victim = min(others, key=lambda one: (-counts[one.address], one.rank, one.since), default=self)
        victim.drop()

    def _drop_if_idle(self) -> None:
        request: RequestResponseCycle | None = getattr(self, "cycle", None)  # None before the first one
        answered = request is None or request.response_complete
        waits = answered and self.timeout_keep_alive_task is None
        if waits and self._waited:
            self.drop()
            return
        self._waited = waits
        self._timer = self.loop.call_later(REQUEST_TIMEOUT_SECONDS, self._drop_if_idle)
