"""The leader's order, as neighbours relay it: which is the newest, and whether its leader is alive.

Neighbours continue to relay the last order of a dead leader, so receiving one proves nothing. An order counts
once its beat has risen at one neighbour, by no more than a leader can have counted in that time. A new term
thus takes one period per hop, and no single message, however high its beat, moves or stops a robot.

The leader counts beats at an even rate, so the beat gives the lateness of its order. An order much later than
the quickest of its term is too old to act on. So a robot behind a link that gets slower and slower holds soon
after its leader has died, before it has read all queued messages. A driven order that is later than
`Order.timeout` counts as silence of its lateness, so robots hold; they relay it, as its leader is alive.

Orders that place a slot outside the mission's bounds are refused, from every sender.

A robot that receives the leader itself refuses relayed orders that are ahead of the leader's.

Orders of terms before the one in force are refused, and with standbys also those of terms before the voted
term. Only a term that has been silent for `formation.protocol.election.TERM_EXPIRY_TIME` yields to an earlier
one with a rising beat: otherwise a leader with a clock that was once ahead would hold robots for ever. Where
orders are signed it yields only while it begins ahead of this robot's clock: a term that began in the past is
no such mistake, and an earlier order, however well signed, may be a recorded one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

from formation.agent.following.gains import Bearable
from formation.agent.following.publisher import rises
from formation.agent.pose.stream import TooLateError
from formation.control.tracker import FRESH_PERIODS
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.attachment import Ballot
from formation.protocol.election import Voter, VoterState, begun, check_term, expiry
from formation.protocol.lateness import MAX_BEAT_LATENESS, Count, counted
from formation.protocol.order import MAX_MOTION_SECONDS, Order, newer
from formation.ros2.messages import Text, decode
from formation.slots.geofence import Geofence
from formation.slots.shape import check_shape
from formation.topics import BALLOT
from formation.wire import BadMessage, Handler, Now, Sample

REFUSED_ORDER_TIME = 1.0
"""Time for which an order that was not signed stays in the status [s]."""
FORGED_ORDER_TIME = 10.0
"""Time for which the status names the robot that relayed a forged order [s]."""


@dataclass(slots=True, kw_only=True)
class OrdersState:
    """The newest orders."""

    voter: VoterState
    newest: Order | None = None
    """The newest order of a leader that has been seen alive; None before the first."""
    rose: float = float("-inf")
    """When its beat last rose [s, monotonic]; for an order later than its timeout, when it was due."""
    age: float = 0.0
    """Time from the leader's step to then, as far as its relays know [s]."""
    signed: tuple[str, str] = "", ""
    """The signed text of the newest order, and its signature; empty without signatures."""
    refused: tuple[str, float] | None = None
    """Why an order was last refused for its signature, and when [s, monotonic]."""
    forged: dict[str, tuple[str, float]] = field(default_factory=dict)
    """The same for forged orders, by the neighbour that relayed them."""
    lived: float = float("-inf")
    """As `rose`, also when this process was frozen."""
    beats: Count | None = None
    """Lateness of the beats."""
    received: dict[str, tuple[Order, float]] = field(default_factory=dict)
    """The newest order from each neighbour, and when it was received [s, monotonic]."""


class Leader(NamedTuple):
    """The leader at one moment."""

    velocity: complex
    """[m/s; world frame]"""
    place: complex | None
    """[m; world frame]; None if robots do not use it."""


class Orders:
    """The leader's orders, as one agent has received them."""

    def __init__(self, mission: Mission, *, votes: bool = True) -> None:
        """`votes`: whether the agent commands its robot, and therefore votes."""
        self.voter = Voter(mission, votes=votes)
        """Votes for a leader on behalf of this robot."""
        self.state = OrdersState(voter=self.voter.state)
        self._shapes, self._bearable = mission.shapes, Bearable.of(mission)
        self._fence = Geofence(mission)
        self._leader, self._candidates = mission.leader, mission.candidates if mission.standbys else ()
        self._rate, self._expiry = mission.robots[mission.leader].rate, expiry(mission)
        self._law = mission.law

    @property
    def handlers(self) -> dict[str, Handler]:
        """Handlers of the candidates' ballots, by key."""
        return {BALLOT.key(name): partial(self._take_ballot, name) for name in self._candidates}

    def _take_ballot(self, candidate: str, sample: Sample, now: Now) -> None:
        ballot = json_message.decode(Ballot, decode(Text, sample.payload).text.encode())
        self.voter.receive(ballot, candidate, sample.arrived, now)

    @property
    def newest(self) -> Order | None:
        """The newest order of a leader that has been seen alive; None before the first."""
        return self.state.newest

    def age(self, mono: float) -> float:
        """Time from the leader's step to `mono` [s], for the newest order; at most `MAX_MOTION_SECONDS`."""
        return min(mono - self.state.rose + self.state.age, MAX_MOTION_SECONDS)

    def leader(self, mono: float) -> Leader | None:
        """The leader at `mono` [s], as its newest order says; None if robots do not use that."""
        newest = self.newest
        if (
            newest is None
            or newest.motion is None
            or not self._law.uses_orders(signed=bool(self.state.signed[0]))
        ):
            return None
        age, place = self.age(mono), newest.place
        if self._law.leader_orders != "place" or place is None:
            return Leader(newest.motion.after(age), None)
        return Leader(newest.motion.after(age), complex(place.x, place.y) + newest.motion.moved(age))

    def stale(self, mono: float) -> bool:
        """Whether the newest order's beat has, by `mono` [s], been silent for too long to bind."""
        return self.newest is not None and mono - self.state.lived > self._expiry

    def refuse(self, why: str, neighbour: str, arrived: float, *, forged: bool) -> None:
        """Record that `neighbour` relayed an order without a valid signature. Raises BadMessage."""
        self.state.refused = why, arrived
        if forged:
            self.state.forged[neighbour] = self.state.refused
        raise BadMessage(why)

    def unsigned(self, now: Now) -> str | None:
        """Why the newest order was refused for its signature, if that was recent."""
        state = self.state
        if state.refused is None or now.mono - state.refused[1] > REFUSED_ORDER_TIME:
            return None
        return state.refused[0]

    def forgers(self, now: Now) -> dict[str, str]:
        """Neighbours that relayed forged orders recently, and what was wrong with the newest."""
        lately = now.mono - FORGED_ORDER_TIME
        return {name: why for name, (why, arrived) in self.state.forged.items() if arrived >= lately}

    def receive(
        self,
        received: Order,
        neighbour: str,
        arrived: float,
        now: Now,
        signed: tuple[str, str] = ("", ""),
        age: float = 0.0,
    ) -> None:
        """Update from the order that came with a neighbour's position. Raises BadMessage.

        `signed`: its signed text and the signature, already verified. `age` [s]: time since the leader's step
        when it arrived, as far as known.
        """
        state = self.state
        check_shape(received, self._shapes)
        self._fence.check(received)
        if received.tuned is not None:
            self._bearable.check(received.tuned)
        try:
            check_term(received.term, now)
        except BadMessage:
            self.voter.refuse(received.term, "ahead", arrived)
            raise
        self._check_ahead(received, neighbour, arrived)
        before = state.received.get(neighbour)
        state.received[neighbour] = received, arrived
        if received.term < max(self.voter.state.voted_term, self._in_force(arrived, now)):
            self.voter.refuse(received.term, "earlier", arrived)
            raise BadMessage(
                "order of an earlier term: another leader has started since, or had a later clock"
            )
        if before is None or received.term != before[0].term or not self._supersedes(received):
            return
        if rises(received.beat, before[0].beat, arrived - before[1], self._rate):
            late = self._lateness(received, arrived)
            _check_late(late, MAX_BEAT_LATENESS)
            silent = late if late > received.timeout else 0.0
            state.newest, state.signed, state.lived = received, signed, arrived
            state.rose, state.age = arrived - silent, age - silent
            self.voter.follows(received.term, arrived)
            _check_late(late, received.timeout)

    def doubt(self) -> None:
        """Require two new messages with a rising beat: this process was frozen."""
        self.state.received.clear()
        self.state.rose = float("-inf")

    def _check_ahead(self, received: Order, neighbour: str, arrived: float) -> None:
        """Raise BadMessage for a relayed order ahead of those received from the leader itself.

        With standbys another one may have begun to lead in a later term.
        """
        from_leader = self.state.received.get(self._leader)
        if (
            neighbour == self._leader
            or from_leader is None
            or arrived - from_leader[1] > FRESH_PERIODS / self._rate
        ):
            return
        own = from_leader[0]
        if newer(received, own) and (received.term == own.term or not self._candidates):
            raise BadMessage(
                f"relayed order is ahead of the leader's own, received here: term {received.term}, beat"
                f" {received.beat}; the leader's own: term {own.term}, beat {own.beat}"
            )

    def _in_force(self, arrived: float, now: Now) -> int:
        """The term of the newest order; 0 for none, or if it has been silent for too long to bind.

        A signed one that began in the past, by this clock, binds for ever.
        """
        if self.newest is None:
            return 0
        signed, _ = self.state.signed
        past = bool(signed) and begun(self.newest.term, now)
        return self.newest.term if past or not self.stale(arrived) else 0

    def _supersedes(self, received: Order) -> bool:
        """Whether an order that is not refused replaces the newest one."""
        return newer(received, self.newest) or (self.newest is not None and received.term < self.newest.term)

    def _lateness(self, received: Order, arrived: float) -> float:
        stamp = received.beat / self._rate
        self.state.beats, late = counted(self.state.beats, received.term, stamp, arrived, MAX_BEAT_LATENESS)
        return late


def _check_late(late: float, limit: float) -> None:
    if late > limit:
        raise TooLateError(f"order too late: {late:.2f} s later than the quickest; limit {limit:g} s")
