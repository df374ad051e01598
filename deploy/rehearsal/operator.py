"""The operator of a rehearsal: orders to every robot and candidate, repeated until they are answered."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from formation.deploy.driving.remote import PERIOD_SECONDS, Remote
from formation.deploy.rehearsal.fleet import Fleet
from formation.protocol.json_message import decode, encode
from formation.protocol.request import MAX_ENDED, Do, OperatorReply, OperatorRequest
from formation.topics import ORDER
from formation.transport.asking import ENDING, EVERYONE

DESK = "operator's machine"
"""Its messages go through the same air; no robot has a name with spaces."""
REPEAT_PERIOD = 0.1
"""Time after which an unanswered request is repeated [s]."""
MAX_REPEATS = 300
"""A request is given up after so many."""
QUERY_TIME = 0.5
"""Time for the answers to a query [s]."""
WAVER_PERIOD = 0.3
"""Time between the orders of a wavering operator [s]."""
SAME_DRIVER_SECONDS = 1.0
"""Time after which the next drive is that of another driver [s]."""


class Operator:
    """Gives orders over the fleet's bus."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet, self._number = fleet, 0
        self._driver = Remote(fleet.mission, ""), -math.inf  # the newest, and when it lets go [s]
        self._names = (*fleet.mission.candidates, *fleet.mission.followers)
        self.listeners: list[Callable[[str, OperatorRequest, OperatorReply], None]] = []
        """Called with each answer, and the name of the robot or candidate."""
        self.order_listeners: list[Callable[[OperatorRequest], None]] = []
        """Called with each request when it is first sent."""

    def order(self, do: Do, **what: Any) -> OperatorRequest:
        """Order all concerned to `do`; a release and a run first learn what they end."""
        self._number += 1
        request = OperatorRequest(do=do, id=f"order-{self._number}", mission=self._fleet.mission.tag, **what)
        if do not in ENDING:
            self._put(request)
            return request
        in_force: list[str] = []

        def take_reply(_name: str, query: OperatorRequest, reply: OperatorReply) -> None:
            if query.id == learning.id:
                in_force.append(reply.stop if do == "release" else reply.hold)

        learning = OperatorRequest(do="query", id=f"query-{self._number}")
        self.listeners.append(take_reply)
        self._put(learning)

        def end() -> None:
            self.listeners.remove(take_reply)
            ends = tuple(dict.fromkeys(filter(None, in_force)))[:MAX_ENDED]
            self._put(request.model_copy(update={"ends": ends}))

        self._later(QUERY_TIME, end)
        return request

    def set_going(self) -> None:
        """End a stop, then every hold."""
        self.order("release")
        self._later(2.0 * QUERY_TIME, lambda: self.order("run"))

    def waver(self, seconds: float) -> None:
        """Order hold and run in turn for `seconds`."""
        for number in range(int(seconds / WAVER_PERIOD)):
            self._later(number * WAVER_PERIOD, partial(self.order, "run" if number % 2 else "hold"))

    def drive(self, forward: float, turn_rate: float, seconds: float) -> None:
        """Drive the leader by hand for `seconds`, at `forward` [m/s] and `turn_rate` [rad/s], then let go."""
        self.drive_by(lambda _: (forward, turn_rate), seconds)

    def drive_by(self, velocity: Callable[[float], tuple[float, float]], seconds: float) -> None:
        """Drive the leader by hand for `seconds`, then let go.

        `velocity` gives forward speed [m/s] and turn rate [rad/s] at a time since now [s].
        """
        now = self._fleet.engine.now
        remote, ended = self._driver
        if not -0.5 * PERIOD_SECONDS <= now - ended <= SAME_DRIVER_SECONDS:
            remote, self._number = Remote(self._fleet.mission, f"driver-{self._number}"), self._number + 1
        self._driver = remote, now + seconds
        self._drive(remote, velocity, now, now + seconds)

    def _drive(
        self, remote: Remote, velocity: Callable[[float], tuple[float, float]], began: float, end: float
    ) -> None:
        now = self._fleet.engine.now
        over = now >= end - 0.5 * PERIOD_SECONDS
        keys, payload = remote.request(*((0.0, 0.0) if over else velocity(now - began)), now)

        def take_reply(data: bytes) -> None:
            remote.process_replies([data], now, self._fleet.engine.now)

        for key in keys:
            self._fleet.fleet.ask(DESK, key, payload, take_reply)
        if not over:
            self._later(PERIOD_SECONDS, lambda: self._drive(remote, velocity, began, end))

    def _later(self, seconds: float, action: Callable[[], object]) -> None:
        self._fleet.engine.at(self._fleet.engine.now + seconds, action)

    def _put(self, request: OperatorRequest) -> None:
        for listener in self.order_listeners:
            listener(request)
        everyone = request.do in {*EVERYONE, "query"}
        for name in self._names:
            if everyone or name in self._fleet.mission.candidates:
                self._ask(name, request, set(), 0)

    def _ask(self, name: str, request: OperatorRequest, answered: set[str], number: int) -> None:
        if name in answered or number > MAX_REPEATS or (request.do == "query" and number > 4):
            return

        def take_reply(data: bytes) -> None:
            if name not in answered:
                answered.add(name)
                reply = decode(OperatorReply, data)
                for listener in tuple(self.listeners):
                    listener(name, request, reply)

        aged = request.model_copy(update={"age": round(number * REPEAT_PERIOD, 2)})
        self._fleet.fleet.ask(DESK, ORDER.key(name), encode(aged), take_reply)
        self._later(REPEAT_PERIOD, lambda: self._ask(name, request, answered, number + 1))
