"""The leader, or a standby, on the bus."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from formation.leader.core import Leader
from formation.leader.terms import TermFile
from formation.topics import ORDER, STATUS
from formation.transport.runtime.loop import Pauses, Runtime
from formation.transport.security.verifying import Verifier
from formation.wire import Now, Outgoing, Sample

_log = logging.getLogger(__name__)


class _Logged:
    """The leader, logging what changes."""

    def __init__(self, leader: Leader, terms: TermFile | None) -> None:
        self.began = False
        self._leader, self._terms = leader, terms
        self.dropped = leader.dropped

    @property
    def due(self) -> float:
        return self._leader.due

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        self.began = True
        outbox = self._leader.step(now, inbox)
        self._write()
        if self._terms is not None:
            self._terms.save(self._leader.known, now.mono)
        return outbox

    def halt(self, now: Now, reason: str) -> list[Outgoing]:
        outbox = self._leader.halt(now, reason)
        self._write()
        return outbox

    def _write(self) -> None:
        while self._leader.notes:
            _log.info("%s", self._leader.notes.popleft())


def lead(
    leader: Leader, process: Runtime, verifier: Verifier | None = None, terms: TermFile | None = None
) -> Pauses:
    """Declare, wait for the monitor, then lead, or stand by, until told to stop.

    `verifier` checks relayed orders if there are certificates; `terms` stores the newest term.
    """
    logged = _Logged(leader, terms)

    def answer(request: bytes, received: float) -> bytes:
        if logged.began:  # a frozen process first finds out whether it still leads
            process.bus.send(logged.step(process.clock(), ()))
        return leader.request(request, received)

    process.declare(leader, None if verifier is None else verifier.check)
    process.bus.answer(ORDER.key(leader.name), answer)
    process.ready(STATUS.key(leader.name))
    yield from process.loop(logged)
