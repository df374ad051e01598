"""Each operator's request takes effect once, and none takes effect against a newer stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from formation.protocol.order import OperatorRequest

MAX_REMEMBERED_REQUESTS = 64
"""Number of requests that are recognised when they are repeated."""

RESTS = frozenset({"stop", "hold"})
"""Requests that stop robots."""

TRAVEL_TIME = 0.005
"""Approximate delay of a request on a local network [s], which its age does not include.

A larger value would refuse the release of a program that sends it as soon as all have acknowledged its
stop.
"""


@dataclass(slots=True)
class Once:
    """Obeys each request once, and none that a stop or a hold has overtaken.

    A new stop or hold (age 0) is always obeyed, even if its id was used before.

    Operators repeat requests until all have answered. A repeated release must undo neither the hold below
    the stop nor a later stop; and one that was sent before a stop, and is received after it, was meant for
    something else. Times are those at which requests arrived, by the receiver's clock.
    """

    rested: float = float("-inf")
    """When a stop or a hold was last received [s, monotonic]; minus infinity: never."""
    answers: dict[str, str] = field(default_factory=dict)
    """Answers to the known requests, by kind and id."""

    def rest(self, mono: float) -> None:
        """Record a stop or a hold of unknown age: it counts as received at `mono` [s]."""
        self.rested = max(self.rested, mono)

    def fact(self, request: OperatorRequest, received: float) -> str:
        """Id of the stop or hold that `request`, received at `received` [s, monotonic], leaves in force.

        Its own; one that is missing or was used before is replaced by a new one, so that no earlier
        release names it.
        """
        fresh = request.id and f"{request.do} {request.id}" not in self.answers
        return request.id if fresh else f"at-{received:.6f}"

    def answer(
        self,
        request: OperatorRequest,
        received: float,
        obey: Callable[[], bytes],
        refuse: Callable[[str], bytes],
    ) -> bytes:
        """Return ``obey()``, or the answer to the same request before; ``refuse(why)`` if overtaken.

        It came at `received` [s, monotonic].
        """
        known = f"{request.do} {request.id}"
        if known in self.answers and not (request.do in RESTS and request.age == 0.0):
            return self.answers[known].encode()
        overtaken = self._overtaken(request, received)
        reply = refuse("asked for before the newest stop or hold: ask again") if overtaken else obey()
        if request.id:
            self.answers.pop(known, None)  # the newest are remembered longest
            self.answers[known] = reply.decode()
            if len(self.answers) > MAX_REMEMBERED_REQUESTS:
                self.answers.pop(next(iter(self.answers)))
        return reply

    def _overtaken(self, request: OperatorRequest, received: float) -> bool:
        if request.do in RESTS:
            self.rest(received)
            return False
        return request.age > 0.0 and received - request.age < self.rested + TRAVEL_TIME
