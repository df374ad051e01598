"""The leader's order, as neighbours relay it: which is the newest, and is the leader who gave it alive?

Neighbours go on relaying the last order of a leader that is gone, so hearing one proves nothing. An order
counts once its beat has risen at one neighbour, by no more than a leader can have counted meanwhile. A new
term thus takes one period per hop, and a single message, however high its beat, moves and stops nobody.

The leader counts beats at an even rate, so a beat tells how late its order is. An order whose beat comes much
later than the quickest of its term is too old to act on: a robot behind a link that gets slower and slower
holds soon after its leader has died, and not when it has read all that is queued.

Orders that place a slot outside the mission's bounds are refused, from every sender.

A robot that hears the leader itself takes no relayed order that is ahead of what the leader has said to it.

Orders of earlier terms are refused: of one before that in force, and where there are standbys of one before
that promised. Only a term that has been silent for `formation.election.EXPIRY` gives way to an earlier one
whose beat rises: else a leader with a clock that was ahead once would hold robots for ever.
"""

from __future__ import annotations

from agent.stream import TooLateError
from agent.tuning import Bearable
from formation.election import Voter, check_term, expiry
from formation.figure import check_figure
from formation.geofence import Geofence
from formation.lateness import MAX_BEAT_LATENESS, Count, counted
from formation.mission import Mission
from formation.neighbour import FRESH_PERIODS
from formation.order import Order, newer
from formation.wire import BadMessage, Now

REFUSED_LATELY = 1.0
"""So long after an order that was not signed the robot says so [s]."""
FORGED_LATELY = 10.0
"""For so long the status names the robot that relayed a forged order [s]."""
LEAP = 1.0
"""A beat may rise by so much time's worth between two messages, however soon they follow each other [s]."""


class Orders:
    """What one agent has heard of the leader's will."""

    def __init__(self, mission: Mission, *, votes: bool = True) -> None:
        """`votes`: whether the agent commands its robot, so that it has a vote."""
        self.newest: Order | None = None
        """The newest order of a leader that has been seen alive; None before the first."""
        self.rose = float("-inf")
        """When its beat last rose [s, monotonic]."""
        self.signed = "", ""
        """The newest order as its leader signed it, and the signature; empty where orders are not signed."""
        self.refused: tuple[str, float] | None = None
        """Why an order was last refused for its signature, and when [s, monotonic]."""
        self.forged: dict[str, tuple[str, float]] = {}
        """The same of orders that a neighbour, by name, has forged."""
        self.voter = Voter(mission, votes=votes)
        """Votes for a leader on behalf of this robot."""
        self._shapes, self._bearable = mission.shapes, Bearable.of(mission)
        self._fence = Geofence(mission)
        self._leader, self._votes = mission.leader, bool(mission.standbys)
        self._rate, self._expiry = mission.robots[mission.leader].rate, expiry(mission)
        self._lived = float("-inf")  # as `rose`, also when this process was frozen
        self._beats: Count | None = None
        self._heard: dict[str, tuple[Order, float]] = {}  # from each neighbour, and when [s, monotonic]

    def refuse(self, why: str, neighbour: str, arrived: float, *, forged: bool) -> None:
        """Note that `neighbour` relayed an order that its leader has not signed. Raises BadMessage."""
        self.refused = why, arrived
        if forged:
            self.forged[neighbour] = self.refused
        raise BadMessage(why)

    def unsigned(self, now: Now) -> str | None:
        """Why the newest order was refused for its signature, if that was just now."""
        if self.refused is None or now.mono - self.refused[1] > REFUSED_LATELY:
            return None
        return self.refused[0]

    def forgers(self, now: Now) -> dict[str, str]:
        """Neighbours that relayed forged orders of late, and what was wrong with the newest."""
        lately = now.mono - FORGED_LATELY
        return {name: why for name, (why, arrived) in self.forged.items() if arrived >= lately}

    def hear(
        self, heard: Order, neighbour: str, arrived: float, now: Now, signed: tuple[str, str] = ("", "")
    ) -> None:
        """Learn from the order that came with a neighbour's position. Raises BadMessage.

        `signed`: its text as it was signed, and the signature, which has been verified by now.
        """
        check_figure(heard, self._shapes)
        self._fence.check(heard)
        if heard.tuned is not None:
            self._bearable.check(heard.tuned)
        try:
            check_term(heard.term, now)
        except BadMessage:
            self.voter.refuse(heard.term, "ahead", arrived)
            raise
        self._check_ahead(heard, neighbour, arrived)
        before = self._heard.get(neighbour)
        self._heard[neighbour] = heard, arrived
        if heard.term < max(self.voter.promise, self._in_force(arrived)):
            self.voter.refuse(heard.term, "earlier", arrived)
            raise BadMessage(
                "order of an earlier term: another leader has started since, or had a later clock"
            )
        if before is not None and self._follows(*before, heard, arrived) and self._supersedes(heard):
            self._check_late(heard, arrived)
            self.newest, self.signed, self.rose, self._lived = heard, signed, arrived, arrived
            self.voter.follows(heard.term, arrived)

    def doubt(self) -> None:
        """Have a beat count only once two new messages show that it rises: this process was frozen."""
        self._heard.clear()
        self.rose = float("-inf")

    def _check_ahead(self, heard: Order, neighbour: str, arrived: float) -> None:
        """Raise BadMessage for a relayed order that the leader, who is heard here, has not given yet.

        Where there are standbys, another one may have begun to lead in a later term.
        """
        said = self._heard.get(self._leader)
        if neighbour == self._leader or said is None or arrived - said[1] > FRESH_PERIODS / self._rate:
            return
        own = said[0]
        if newer(heard, own) and (heard.term == own.term or not self._votes):
            raise BadMessage(
                f"relayed order is ahead of the leader, which is heard here: term {heard.term}, beat"
                f" {heard.beat}; the leader's own: term {own.term}, beat {own.beat}"
            )

    def _in_force(self, arrived: float) -> int:
        """The term of the newest order, unless its beat has been silent for too long to bind; 0 for none."""
        return self.newest.term if self.newest is not None and arrived - self._lived <= self._expiry else 0

    def _supersedes(self, heard: Order) -> bool:
        """Whether an order that is not refused takes the place of the newest one."""
        return newer(heard, self.newest) or (self.newest is not None and heard.term < self.newest.term)

    def _check_late(self, heard: Order, arrived: float) -> None:
        stamp = heard.beat / self._rate
        self._beats, late = counted(self._beats, heard.term, stamp, arrived, MAX_BEAT_LATENESS)
        if late > MAX_BEAT_LATENESS:
            raise TooLateError(
                f"order too late: {late:.2f} s later than the quickest; limit {MAX_BEAT_LATENESS:g} s"
            )

    def _follows(self, before: Order, then: float, heard: Order, arrived: float) -> bool:
        """Whether a living leader's beat can have risen like this between two messages of one neighbour."""
        most = 2.0 * self._rate * (LEAP + max(0.0, arrived - then))
        return heard.term == before.term and 0 < heard.beat - before.beat <= most
