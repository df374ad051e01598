"""One client's connection: how many there may be, which one makes room, and how long each is waited for.

Sockets, memory and time are the monitor's own, and whoever can reach the page could use them up. So there are
only so many connections, and fewer of one address; nothing is queued for a client that does not read; and a
client that asks nothing is disconnected. A new connection always gets in: it takes the place of one that has
not shown the operator's token, so that a stop is never kept out.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from enum import IntEnum

from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

MAX_CONNECTIONS = 128
"""At a time, of all addresses."""
MAX_PER_ADDRESS = 96
"""At a time, of one address: many browsers may be behind one router, and all of this machine are one."""
ASKING = 5.0
"""A request that has not come whole within one to two of these is not waited for [s]."""
YOUNG = 1.0
"""A connection may send its first request within this time before it counts as silent [s]."""
OPERATOR = "formation.operator"
"""Key of a request's scope that says that it carried the operator's token."""


class Standing(IntEnum):
    """What a connection is to us; the lowest makes room first."""

    SILENT = 0
    """Has not sent a whole request, and has had time to."""
    IDLE = 1
    """Is between two requests."""
    BUSY = 2
    """Has a request under way, such as a stream."""
    NEW = 3
    """Has not sent a whole request yet, and may be about to."""
    OPERATOR = 4
    """Its newest request carried the operator's token. Never makes room."""


class Connection(H11Protocol):
    """As uvicorn's, with limits."""

    _look: asyncio.TimerHandle | None = None
    _waited = False
    since = 0.0
    """When it was made [s, of the loop]."""
    gone = False
    """Whether it was aborted, though the loop may not have said so yet."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A client has dialled."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=0)  # the next frame is not sent before this one is gone
        self.since = self.loop.time()
        self._make_room()
        if not self.gone:
            self._look = self.loop.call_later(ASKING, self._hurry)

    def connection_lost(self, exc: Exception | None) -> None:
        """It has gone."""
        self.gone = True
        if self._look is not None:
            self._look.cancel()
        super().connection_lost(exc)

    @property
    def address(self) -> str:
        """Of the client, without its port."""
        return self.client[0] if self.client else ""

    @property
    def standing(self) -> Standing:
        """What it is to us now."""
        if getattr(self, "scope", None) is not None and self.scope.get(OPERATOR):
            return Standing.OPERATOR
        request: RequestResponseCycle | None = getattr(self, "cycle", None)
        if request is None:
            return Standing.NEW if self.loop.time() - self.since < YOUNG else Standing.SILENT
        return Standing.IDLE if request.response_complete else Standing.BUSY

    def drop(self) -> None:
        """Disconnect on the spot."""
        self.gone = True
        self.transport.abort()

    def _make_room(self) -> None:
        """Keep within the limits, by dropping another connection, or this one if no other may be dropped."""
        there = [one for one in self.connections if isinstance(one, Connection) and not one.gone]
        many = Counter(one.address for one in there)
        if many[self.address] > MAX_PER_ADDRESS:
            there = [one for one in there if one.address == self.address]
        elif len(there) <= MAX_CONNECTIONS:
            return
        others = [one for one in there if one is not self and one.standing is not Standing.OPERATOR]
        # the address with the most connections makes room, then the least of these, then the oldest
        victim = min(others, key=lambda one: (-many[one.address], one.standing, one.since), default=self)
        victim.drop()

    def _hurry(self) -> None:
        request: RequestResponseCycle | None = getattr(self, "cycle", None)  # None before the first one
        answered = request is None or request.response_complete
        waits = answered and self.timeout_keep_alive_task is None
        if waits and self._waited:
            self.drop()
            return
        self._waited = waits
        self._look = self.loop.call_later(ASKING, self._hurry)
