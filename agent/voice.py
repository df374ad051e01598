"""Whose voice is it that speaks for a neighbour, and is what it says new?

Two agents that run for one robot by mistake, and a recording of one that is played back, say well-formed
positions on the right key. A neighbour is therefore bound to the first voice heard of it, and each voice to
its own count: another voice is refused until the first has been silent for longer than anybody would follow
it, and what was said before is refused always. A voice that was followed by another may speak again when that
one is silent: else an agent that was cut off while a second one ran would be refused for ever. Only who leads
in a later term, to which the agent has promised its own voice, need not wait for that.
"""

from __future__ import annotations

from formation.neighbour import FRESH_PERIODS
from formation.order import Told
from formation.wire import BadMessage

LEAP = 1.0
"""A count may rise by so much time's worth between two messages, however soon they follow each other [s]."""
REMEMBERED = 64
"""Of so many voices that have fallen silent the newest count is known: what they said is refused again."""


class Voice:
    """The one voice that speaks for a neighbour."""

    def __init__(self, name: str, rate: float) -> None:
        """`rate` [Hz] is how often `name` tells its position."""
        self.limit = FRESH_PERIODS / rate
        """Silence after which another voice may speak for it [s]."""
        self.contested = float("-inf")
        """When another voice was last refused [s, monotonic]."""
        self._name, self._rate = name, rate
        self._bound: Told | None = None
        self._heard = float("-inf")
        self._leapt: tuple[int, float] | None = None  # a count that rose too far in a silence, and when
        self._former: dict[str, int] = {}  # the newest count of each voice before

    def admit(self, told: Told, arrived: float, promise: int = 0) -> None:
        """Let the voice speak, or raise BadMessage. `promise` is the term that the agent follows, if any."""
        if self._bound is not None:
            self._judge(told, self._bound, arrived - self._heard, arrived, promise)
        self._bound, self._heard, self._leapt = told, arrived, None

    def _judge(self, told: Told, bound: Told, wait: float, arrived: float, promise: int) -> None:
        if told.voice == bound.voice:
            if told.count <= bound.count:
                raise BadMessage(f"said before: position {told.count} of this voice, now at {bound.count}")
            if not self._follows(told.count, bound.count, wait) and not self._goes_on(told, wait, arrived):
                raise BadMessage(f"position {told.count} of this voice, just now at {bound.count}")
            return
        if told.count <= self._former.get(told.voice, -1):
            raise BadMessage(f"said before: position {told.count} of a former voice of {self._name}")
        if wait <= self.limit and not 0 < _term(bound) < _term(told) == promise:
            self.contested = arrived
            raise BadMessage(f"{self._name} speaks with a second voice")
        self._former.pop(told.voice, None)
        self._former[bound.voice] = bound.count
        if len(self._former) > REMEMBERED:
            self._former.pop(next(iter(self._former)))

    def _follows(self, count: int, before: int, wait: float) -> bool:
        return 0 < count - before <= 2.0 * self._rate * (LEAP + max(0.0, wait))

    def _goes_on(self, told: Told, wait: float, arrived: float) -> bool:
        """Whether a leap after a silence is confirmed by a second message that follows from the first.

        Without that a robot that tells more than twice as often as its mission promises would be refused for
        ever after an outage, because its count then rises faster than what is allowed.
        """
        leapt, self._leapt = self._leapt, (told.count, arrived)
        if leapt is None or wait <= self.limit:
            return False
        return self._follows(told.count, leapt[0], arrived - leapt[1])


def _term(told: Told) -> int:
    return told.order.term if told.order is not None else told.term
