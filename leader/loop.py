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
        mode, shape = leader.mode, leader.shape
        reply = leader.request(request)
        if leader.mode != mode:
            _log.info("the operator changed %s to %s", mode, leader.mode)
        if leader.shape != shape:
            _log.info("the operator changed the shape from %s to %s", shape, leader.shape)
        return reply

    process.declare(leader)
    process.bus.answer(ORDER.key(leader.robot), answer)
    process.ready(STATUS.key(leader.robot))
    process.run(leader)
