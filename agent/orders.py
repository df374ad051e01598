"""The leader's order, as neighbours relay it: which is the newest, and is the leader who gave it alive?

Neighbours go on relaying the last order of a leader that is gone, so hearing one proves nothing. An order
counts once its beat has risen at one neighbour, by no more than a leader can have counted meanwhile. A new
term thus takes one period per hop, and a single message, however high its beat, moves and stops nobody.

An order of a slot outside the mission's bounds is refused, whoever it comes from.

Where there are standbys, a robot that has promised itself to a term takes no order of an earlier one.
"""

from __future__ import annotations

from agent.stream import ABSURD
from agent.tuning import Bearable
from formation.election import Voter
from formation.figure import check_figure
from formation.geofence import Geofence
from formation.mission import Mission
from formation.order import Order, newer
from formation.wire import BadMessage, Now

LEAP = 1.0
"""A beat may rise by so much time's worth between two messages, however soon they follow each other [s]."""


class Orders:
    """What one agent has heard of the leader's will."""

    def __init__(self, mission: Mission) -> None:
        self.newest: Order | None = None
        """The newest order of a leader that has been seen alive; None before the first."""
        self.rose = float("-inf")
        """When its beat last rose [s, monotonic]."""
        self.voter = Voter(mission)
        """Its voice in who leads."""
        self._shapes, self._bearable = mission.shapes, Bearable.of(mission)
        self._fence = Geofence(mission)
        self._rate = mission.robots[mission.leader].rate
        self._heard: dict[str, tuple[Order, float]] = {}  # from each neighbour, and when [s, monotonic]

    def hear(self, heard: Order, neighbour: str, arrived: float, now: Now) -> None:
        """Learn from the order that came with a neighbour's position. Raises BadMessage."""
        check_figure(heard, self._shapes)
        self._fence.check(heard)
        if heard.tuned is not None:
            self._bearable.check(heard.tuned)
        if heard.term * 1e-9 - now.wall > ABSURD:
            raise BadMessage(f"absurd term: begins {heard.term * 1e-9 - now.wall:.0f} s from now")
        before = self._heard.get(neighbour)
        self._heard[neighbour] = heard, arrived
        if heard.term < self.voter.promise or (self.newest is not None and heard.term < self.newest.term):
            raise BadMessage(
                "order of an earlier term: another leader has started since, or had a later clock"
            )
        if before is not None and self._beats(*before, heard, arrived) and newer(heard, self.newest):
            self.newest, self.rose = heard, arrived
            self.voter.follows(heard.term, arrived)

    def doubt(self) -> None:
        """Have a beat count only once two new messages show that it rises: this process was frozen."""
        self._heard.clear()
        self.rose = float("-inf")

    def _beats(self, before: Order, then: float, heard: Order, arrived: float) -> bool:
        """Whether a living leader's beat can have risen like this between two messages of one neighbour."""
        most = 2.0 * self._rate * (LEAP + max(0.0, arrived - then))
        return heard.term == before.term and 0 < heard.beat - before.beat <= most
