"""An operator's requests take effect once each, in an order that sets nobody going against a newer stop."""

from __future__ import annotations

from collections.abc import Callable

from formation.order import OperatorRequest

REMEMBERED = 64
"""So many requests are known when they are put again."""

RESTS = frozenset({"stop", "hold"})
"""What brings robots to rest."""

STEPS = 0.25
"""Who is asked knows the time by its newest step, which may be so old [s]."""


class Once:
    """Obeys each request once, and none that a stop or a hold has overtaken.

    Operators repeat theirs until all have answered. A release that is put again must undo neither the hold
    below the stop nor a stop that came meanwhile; and one that was put before a stop, and is heard after it,
    was meant for something else.
    """

    def __init__(self) -> None:
        self.now = float("-inf")
        """When the newest step was [s, monotonic]."""
        self._rested = float("-inf")  # when a stop or a hold was heard last; infinite: since the newest step
        self._answers: dict[str, bytes] = {}

    def aware(self, mono: float) -> None:
        """A step is taken [s, monotonic]. What was heard since the one before counts as heard only now.

        Before the first step nobody knows the time, and after one that took long nobody knows it well: a stop
        that was heard then must not be taken for an older one than it is.
        """
        self.now, self._rested = mono, min(self._rested, mono)

    def rest(self) -> None:
        """A stop or a hold is in force, nobody here knows since when: it counts as heard only now."""
        self._rested = float("inf")

    @property
    def rested(self) -> float:
        """When a stop or a hold was heard last [s, monotonic].

        Infinite: since the newest step; minus infinity: never.
        """
        return self._rested

    @property
    def answers(self) -> dict[str, str]:
        """What was answered to the requests that are known, by their ids."""
        return {number: reply.decode() for number, reply in self._answers.items()}

    def answer(
        self, request: OperatorRequest, obey: Callable[[], bytes], refuse: Callable[[str], bytes]
    ) -> bytes:
        """What ``obey()`` answers, or answered to the same request before; ``refuse(why)`` if overtaken."""
        if request.id in self._answers:
            return self._answers[request.id]
        overtaken = self._overtaken(request)
        reply = refuse("asked for before the newest stop or hold: ask again") if overtaken else obey()
        if request.id:
            self._answers[request.id] = reply
            if len(self._answers) > REMEMBERED:
                self._answers.pop(next(iter(self._answers)))
        return reply

    def _overtaken(self, request: OperatorRequest) -> bool:
        if request.do in RESTS:
            self.rest()
            return False
        return request.age > 0.0 and self.now - self._rested < request.age + STEPS
