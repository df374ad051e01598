"""An operator's requests take effect once each, in an order that sets nobody going against a newer stop."""

from __future__ import annotations

from collections.abc import Callable

from formation.order import OperatorRequest

REMEMBERED = 64
"""So many requests are known when they are put again."""

RESTS = frozenset({"stop", "hold"})
"""What brings robots to rest."""

TRAVEL = 0.005
"""A request is on its way for about so long on a local network [s], which its age cannot say.

More would refuse the release of a program that asks for it as soon as all have acknowledged its stop.
"""


class Once:
    """Obeys each request once, and none that a stop or a hold has overtaken.

    A stop or a hold that is asked for afresh is always obeyed: who uses an id again means it again.

    Operators repeat theirs until all have answered. A release that is put again must undo neither the hold
    below the stop nor a stop that came meanwhile; and one that was put before a stop, and is heard after it,
    was meant for something else. Times are those at which requests came, by the clock of who is asked.
    """

    def __init__(self) -> None:
        self._rested = float("-inf")
        self._answers: dict[str, bytes] = {}

    def rest(self, mono: float) -> None:
        """A stop or a hold is in force, nobody here knows since when: it counts as heard at `mono` [s]."""
        self._rested = max(self._rested, mono)

    @property
    def rested(self) -> float:
        """When a stop or a hold was heard last [s, monotonic]; minus infinity: never."""
        return self._rested

    @property
    def answers(self) -> dict[str, str]:
        """What was answered to the requests that are known, each by what it was and its id."""
        return {known: reply.decode() for known, reply in self._answers.items()}

    def fact(self, request: OperatorRequest, heard: float) -> str:
        """Id of the stop or the hold that `request`, which came at `heard` [s, monotonic], leaves in force.

        Its own; one that is missing or was used before is drawn anew, so that no earlier release names it.
        """
        fresh = request.id and f"{request.do} {request.id}" not in self._answers
        return request.id if fresh else f"at-{heard:.6f}"

    def answer(
        self,
        request: OperatorRequest,
        heard: float,
        obey: Callable[[], bytes],
        refuse: Callable[[str], bytes],
    ) -> bytes:
        """What ``obey()`` answers, or answered to the same request before; ``refuse(why)`` if overtaken.

        It came at `heard` [s, monotonic].
        """
        known = f"{request.do} {request.id}"
        if known in self._answers and not (request.do in RESTS and request.age == 0.0):
            return self._answers[known]
        overtaken = self._overtaken(request, heard)
        reply = refuse("asked for before the newest stop or hold: ask again") if overtaken else obey()
        if request.id:
            self._answers.pop(known, None)  # the newest are remembered longest
            self._answers[known] = reply
            if len(self._answers) > REMEMBERED:
                self._answers.pop(next(iter(self._answers)))
        return reply

    def _overtaken(self, request: OperatorRequest, heard: float) -> bool:
        if request.do in RESTS:
            self.rest(heard)
            return False
        return request.age > 0.0 and heard - request.age < self._rested + TRAVEL
