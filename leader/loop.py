"""The leader on the bus."""

from __future__ import annotations

import logging

from formation.topics import ORDER, STATUS
from formation.transport.process import Process
from leader.core import Leader

_log = logging.getLogger(__name__)


def lead(leader: Leader, process: Process) -> None:
    """Declare, wait for whoever watches, then lead until told to stop."""

    def answer(request: bytes) -> bytes:
        before = leader.mode
        reply = leader.request(request)
        if leader.mode != before:
            _log.info("the operator changed %s to %s", before, leader.mode)
        return reply

    process.declare(leader)
    process.bus.answer(ORDER.key(leader.robot), answer)
    process.ready(STATUS.key(leader.robot))
    process.run(leader)
