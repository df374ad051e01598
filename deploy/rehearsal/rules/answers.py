"""Rule of what robots answer to operators: no run while stopped, and nothing that a stop has overtaken."""

from __future__ import annotations

from formation.deploy.rehearsal.engine import VirtualProcess
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.rules.places import Tell
from formation.protocol import json_message
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.protocol.stops import RESTS

WAIT_TIME = 0.05
"""Longest time that a request waits in a robot that is not slow [s]."""


class Answers:
    """The answers of one fleet's robots."""

    def __init__(self, fleet: Fleet, tell: Tell) -> None:
        self._fleet, self._tell = fleet, tell
        self._known: set[tuple[str, str, str]] = set()  # requests that were answered, by robot
        self._stopped: set[VirtualProcess] = set()
        self._rested: dict[VirtualProcess, float] = {}  # when the newest stop or hold was answered [s]
        fleet.fleet.repliers.append(self._note)

    def _note(self, process: VirtualProcess, data: bytes, answer: bytes) -> None:
        name = process.certified or ""
        if self._fleet.agents.get(name, (None, None))[1] is not process:
            return
        request = json_message.decode(OperatorRequest, data)
        reply = json_message.decode(OperatorReply, answer)
        now, known = self._fleet.engine.now, (name, request.do, request.id)
        if known in self._known and not (request.do in RESTS and request.age == 0.0):
            return  # a repeated request gets the same answer, and changes nothing
        self._known.add(known)
        if reply.ok:
            self._check(name, process, request, now)
        if request.do in RESTS:
            self._rested[process] = now
            if request.do == "stop" and reply.ok:
                self._stopped.add(process)
        elif request.do == "release" and reply.ok:
            self._stopped.discard(process)

    def _check(self, name: str, process: VirtualProcess, request: OperatorRequest, now: float) -> None:
        if request.do == "run" and process in self._stopped:
            self._tell("answer", name, "obeys run, though it is stopped")
        given, rested = now - request.age, self._rested.get(process, 0.0)
        ends = request.do in {"run", "release"} and request.age > 0.0
        if ends and given < rested - WAIT_TIME - process.lag:
            self._tell(
                "answer", name, f"obeys {request.do}: {rested - given:.2f} s older than its stop or hold"
            )
