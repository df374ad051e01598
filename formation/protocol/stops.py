"""The stop and the hold in force at one robot or candidate, and the requests that end them.

Each stop and each hold has an id. ``release`` ends the stop that it names, and leaves a new hold behind:
ending a stop never starts motion. ``run`` ends the hold that it names, and is refused while stopped. So a
request that was sent before the newest stop or hold ends neither, however late or often it arrives, and each
request takes effect once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from formation.protocol.order import Mode
from formation.protocol.request import OperatorRequest, ReplyCode

MOTION = frozenset({"stop", "hold", "release", "run"})
"""Requests that change what is in force. Each robot and each candidate accepts them."""
MAX_REMEMBERED_REQUESTS = 64
"""Number of requests that are recognised when they are repeated."""
RESTS = frozenset({"stop", "hold"})
"""Requests that stop robots."""
TRAVEL_TIME = 0.005
"""Approximate delay of a request on a local network [s], which its age does not include.

A larger value would refuse the release of a program that sends it as soon as all have acknowledged its
stop.
"""


class Result(NamedTuple):
    """Result of a request."""

    ok: bool
    reason: str = ""
    code: ReplyCode = ""


@dataclass(slots=True)
class Rest:
    """The newest stop and the newest hold, each by its id; empty for none."""

    stop: str = ""
    hold: str = ""

    @property
    def mode(self) -> Mode | None:
        """What is in force, a stop before a hold; None for neither."""
        return "stop" if self.stop else "hold" if self.hold else None

    def change(self, request: OperatorRequest, rest_id: str) -> Result:
        """Obey one of `MOTION`. `rest_id` is the id of the stop or the hold that it leaves in force."""
        match request.do:
            case "stop":
                self.stop = rest_id
            case "hold":
                self.hold = rest_id
            case "release":
                return self._release(request, rest_id)
            case "run":
                return self._run(request)
            case _:
                raise ValueError(f"{request.do}: must be one of {', '.join(sorted(MOTION))}")
        return Result(ok=True)

    def _release(self, request: OperatorRequest, rest_id: str) -> Result:
        if not self.stop:
            return Result(ok=True, code="nothing", reason="nothing to release: no stop is in force")
        if not request.ends:
            return Result(
                ok=False, code="unnamed", reason="release must name the stop that it ends: query first"
            )
        if self.stop not in request.ends:
            return Result(ok=False, code="another", reason="nothing to release: another stop is in force")
        self.stop, self.hold = "", rest_id
        return Result(ok=True)

    def _run(self, request: OperatorRequest) -> Result:
        if self.stop:
            return Result(ok=False, code="stopped", reason="stopped: release it first")
        if self.hold and not request.ends:
            return Result(ok=False, code="unnamed", reason="run must name the hold that it ends: query first")
        if self.hold and self.hold not in request.ends:
            return Result(ok=False, code="another", reason="held since: order run again")
        self.hold = ""
        return Result(ok=True)


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

    def rest_id(self, request: OperatorRequest, received: float) -> str:
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
        overtaken = request.age > 0.0 and received - request.age < self.rested + TRAVEL_TIME
        if request.do in RESTS:
            self.rest(received)
            overtaken = False
        reply = refuse("asked for before the newest stop or hold: ask again") if overtaken else obey()
        if request.id:
            self.answers.pop(known, None)  # the newest are remembered longest
            self.answers[known] = reply.decode()
            if len(self.answers) > MAX_REMEMBERED_REQUESTS:
                self.answers.pop(next(iter(self.answers)))
        return reply
