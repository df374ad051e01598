"""A candidate: the virtual leader while it leads, otherwise a standby that follows the state of the fleet.

`Leader.step(now, inbox) -> outbox`, without a clock, a socket or a log. The leader's position depends on how
long the fleet has been running by the monotonic clock: neither a late step nor a corrected system clock moves
it. After a hang of more than `LEADER_TIMEOUT_SECONDS` it goes on from where it was, not from where it would
be. A new leader goes on from the newest order that the robots relay, under a publisher id of its own.

Robots relay the last order of a dead leader for ever. So a leader started to hold goes on in its mode only if
the fleet is *under way*: the beat of that order rose within `formation.protocol.election.expiry`, by this
process's own clock and by every robot that relays it (`PositionAttachment.stale`). It holds as well after it
has itself been suspended for so long.
"""

from __future__ import annotations

import cmath
import math
from collections import Counter, deque
from collections.abc import Sequence
from typing import Protocol

from formation.leader.candidacy import Candidacy, linked
from formation.leader.plan import Plan
from formation.leader.reports import Leadership, OperatorRequests, status
from formation.leader.route import NamedRoute
from formation.mission.model import Mission
from formation.protocol import json_message, order
from formation.protocol.addressed import Addressee
from formation.protocol.attachment import Ballot, PositionAttachment
from formation.protocol.election import absurd, begun, expiry, rank_of, without_absurd_terms
from formation.protocol.order import LEADER_TIMEOUT_SECONDS, Mode, Order, newer
from formation.protocol.request import OperatorRequest
from formation.protocol.status_codec import to_message
from formation.ros2.messages import Pose, Text, decode, encode
from formation.slots.geofence import Geofence
from formation.slots.shape import PlacedShape, check_shape
from formation.topics import BALLOT, POSITION, ROUTE, STATUS, Topic
from formation.transport.runtime.rate import TICK_TOLERANCE, Rate
from formation.wire import BadMessage, Now, Outgoing, Sample

STATUS_RATE = 2.0
"""Rate of statuses [Hz]."""
ROUTE_RATE = 1.0
"""Rate of route messages [Hz]."""
CERTIFICATE_RATE = 1.0
"""Rate of certificates [Hz]."""
MAX_BEAT_LEAD = 0.1
"""By how much beats of changed orders may be ahead of time, if that is over a period [s].

Later orders look as late to robots: they refuse them over 1 s, and hold over 0.3 s if the leader is driven.
"""
CATCH_UP_TIME = 5.0
"""How long after the first relayed order of its term a new leader accepts an earlier stop or hold [s]."""
FORGERY_TIME = 10.0
"""How long a robot is named after its newest forged order; the alarm repeats after as long a silence [s]."""


class Signer(Protocol):
    """A candidate's key: `formation.transport.security.signing.Signer`, or a rehearsed one."""

    @property
    def certificate(self) -> str:
        """The certificate as sent with positions."""

    def sign(self, message: bytes) -> str:
        """Return the signature of `message`."""


class Leader:
    """A candidate of a mission: its leader, or one of its standbys."""

    def __init__(
        self,
        mission: Mission,
        name: str | None = None,
        *,
        hold: bool = False,
        anew: bool = False,
        publisher_id: str = "",
        signer: Signer | None = None,
        known: int = 0,
    ) -> None:
        """`name`: one of ``mission.candidates``, default the leader; `publisher_id`: random, new each start.

        Its orders are signed by `signer`, if there is one.

        With `hold` it waits until it is told to run, unless the fleet is under way; with `anew` it starts
        from the mission's start, not from where the fleet is. `known` is the newest term that the previous
        process knew. Raises ValueError for a name that is no candidate.
        """
        self.name = self.robot = mission.leader if name is None else name
        self.dropped: Counter[str] = Counter()
        """Count of rejected messages, by key."""
        self.plan = Plan(mission, hold=hold, signed=signer is not None, publisher_id=publisher_id)
        self.mission, self._anew, self._publisher_id, self._signer = mission, anew, publisher_id, signer
        self._forged: dict[str, tuple[int, str, float]] = {}  # by robot: how many, why, when [s, monotonic]
        self._absurd: dict[str, float] = {}  # by robot, when it last relayed an absurd term [s, monotonic]
        self.candidacy = Candidacy(mission, self.name, known)
        self.operator_requests = OperatorRequests(
            self.name, self.plan, lambda: self.leadership, Addressee(mission), alone=not mission.standbys
        )
        self._newest: Order | None = None  # relayed by a robot, or its own
        self._newest_rose = float("-inf")  # when the beat of `_newest` rose [s, monotonic]
        self._newest_stale = False  # whether a robot reports that this was long ago
        self._earlier: dict[str, Order] = {}  # orders of earlier terms, by the robot that relays them
        self.mixed: dict[str, tuple[str, float]] = {}  # tag and arrival, by robot of another mission
        self._term = 0  # term of its last order
        self.rate = Rate(mission.robots[mission.leader].rate)
        self._status_rate, self._route_rate = Rate(STATUS_RATE), Rate(ROUTE_RATE)
        self._certificate_rate = Rate(CERTIFICATE_RATE)
        self._order_sent: tuple[object, ...] = ()  # what was ordered at the last advance
        self._mode: Mode = "hold"  # since the last advance
        self._unsent = False  # whether the order has changed and waits for its period
        self._waiting: tuple[str, ...] = ()
        self._fence = Geofence(mission)
        self._fenced = False  # whether the bounds stopped it at the last advance
        self._advanced_at: float | None = None  # time of the last advance [s, monotonic]
        self._leads, self._terms_led, self.beat, self._count = False, 0, 0, 0
        self._first_beat_at = 0.0  # time of this term's first beat [s, monotonic]
        self._restored: Order | None = None  # order of an earlier term from which it went on
        self._found_earlier: tuple[Order, bool] | None = None  # a newer one of those, and whether it is stale
        self._relayed_by: set[str] = set()  # robots that have relayed an order of this term
        self._catch_up_until = 0.0  # until when orders of earlier terms still count [s, monotonic]
        robots = linked(mission).union(mission.waited_for)
        self._followers = {POSITION.key(robot): robot for robot in mission.followers if robot in robots}
        others = [other for other in mission.candidates if other != self.name and mission.standbys]
        self._ballots = {BALLOT.key(other): other for other in others}
        self._routes = {ROUTE.key(other): other for other in others}

    @property
    def publications(self) -> tuple[tuple[Topic, str], ...]:
        """Every topic that it may publish, with its key."""
        own = (STATUS, BALLOT, ROUTE) if self.mission.standbys else (STATUS,)
        return (
            (POSITION, POSITION.key(self.mission.leader)),
            *((topic, topic.key(self.name)) for topic in own),
        )

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """Keys of linked followers' positions, and of other candidates' ballots and routes."""
        return (*self._followers, *self._ballots, *self._routes)

    @property
    def due(self) -> float:
        """When the next step is due if nothing arrives [s, monotonic]."""
        due = min(self.candidacy.due, self._status_rate.due)
        return min(due, self.rate.due, self.plan.driver_due) if self._leads else due

    @property
    def notes(self) -> deque[str]:
        """What has changed, for the log; the caller removes what it has logged."""
        return self.operator_requests.notes

    @property
    def leads(self) -> bool:
        """Whether it led in its newest step."""
        return self._leads

    @property
    def lease_end(self) -> float:
        """Until when it may lead without another step [s, monotonic]; -inf if it does not lead."""
        return self.candidacy.lease_end

    @property
    def term(self) -> int:
        """The newest term for which it was a candidate; 0 before the first."""
        return self.candidacy.term

    @property
    def known(self) -> int:
        """The newest term that it knows."""
        return self.candidacy.known

    @property
    def mode(self) -> Mode:
        """The fleet's mode, as far as known."""
        if self._leads or self.candidacy.state == "listening":
            return self.plan.team_mode.mode
        return self.plan.team_mode.rest.mode or (self._newest.mode if self._newest else "hold")

    @property
    def wanted(self) -> PlacedShape:
        """Where the slots will be in the end if the leader goes straight on."""
        wanted = self.plan.wanted
        if not self.mission.turning:
            return wanted
        heading = self.plan.route.heading(self.route_time)
        return wanted._replace(rotation=wanted.rotation + cmath.phase(heading))

    @property
    def route_time(self) -> float:
        """How long it has been on its route [s]."""
        return self.plan.route_time

    def forgers(self, mono: float) -> dict[str, tuple[int, str]]:
        """Robots that relayed forged orders lately: how many so far, and what was wrong with the newest."""
        return {
            robot: (count, why)
            for robot, (count, why, when) in self._forged.items()
            if mono - when <= FORGERY_TIME
        }

    def where(self, mono: float) -> complex:
        """Extrapolate the leader's position [m; world frame] to `mono` [s], not before the newest step."""
        runs = self._advanced_at is not None and self._leads and self._mode == "run"
        return self.plan.where(mono - self._advanced_at if runs and self._advanced_at is not None else 0.0)

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """Read the inbox, decide whether it leads, then publish; at once if the order has changed."""
        for sample in inbox:
            try:
                self._process_sample(sample, now)
            except BadMessage:
                self.dropped[sample.key] += 1
        outbox = self._ballot_messages(self.candidacy.step(now))
        changed = self._follow_candidacy(now) | self._catch_up(now) | self._advance(now)
        if self._leads:
            outbox += self._position_messages(now, changed=changed)
        if self.mission.standbys and (self._route_rate.tick(now.mono) or changed):
            outbox += self._route_messages()
        if self._status_rate.tick(now.mono) or changed or self.operator_requests.unpublished:
            outbox.append(self._status_message(now, ""))
        return outbox

    def halt(self, now: Now, reason: str) -> list[Outgoing]:
        """Return the last messages: the fleet holds at once instead of waiting for a missing beat.

        The order keeps what the operator requested, so that the next leader goes on with that. Without
        standbys the next one holds until told to run.
        """
        self.candidacy.step(now)
        self._follow_candidacy(now)
        self._advance(now)
        if not self.mission.standbys:
            self.plan.team_mode.hold_at_end()
        outbox = (
            [self._position_message(now, "stop" if self.mode == "stop" else "hold", changed=True)]
            if self._leads
            else []
        )
        outbox += self._ballot_messages(self.candidacy.leave(now))
        return [*outbox, self._status_message(now, reason)]

    def request(self, data: bytes, received: float) -> bytes:
        """Answer a request; it takes effect with the next step. `received` is its arrival [s, monotonic]."""
        try:
            request = json_message.decode(OperatorRequest, data)
        except BadMessage as bad:
            self.dropped["order"] += 1
            return self.operator_requests.reply(ok=False, reason=str(bad))
        return self.operator_requests.answer(request, received)

    @property
    def leadership(self) -> Leadership:
        """Its part in the election, the leading candidate and the mode of the fleet."""
        return Leadership(self.candidacy.state, self._leader, self.mode)

    @property
    def _leader(self) -> str:
        """The leading candidate, as far as known; empty if there is none."""
        if self._leads:
            return self.name
        known = self.mission.candidates[rank_of(self.candidacy.known) :][:1] if self.candidacy.known else ()
        return known[0] if known and known[0] != self.name else ""

    def _process_sample(self, sample: Sample, now: Now) -> None:
        """Take in a message. Raises BadMessage."""
        if sample.key in self._followers:
            self._process_position(self._followers[sample.key], sample, now)
        elif sample.key in self._ballots:
            ballot = json_message.decode(Ballot, decode(Text, sample.payload).text.encode())
            self.candidacy.receive_ballot(ballot, self._ballots[sample.key], sample.arrived, now)
        elif sample.key in self._routes:
            if self.plan.add_route(NamedRoute.read(sample.payload)) and self._leads:
                self.notes.append("received the missing route of the earlier leader, and goes on")
        else:
            raise BadMessage("unknown key")

    def _process_position(self, robot: str, sample: Sample, now: Now) -> None:
        pose = decode(Pose, sample.payload)
        attachment = json_message.decode(PositionAttachment, sample.attachment or b"")
        if attachment.mission != self.mission.tag:
            self.mixed[robot] = attachment.mission, sample.arrived
        relayed, attachment = attachment, without_absurd_terms(attachment, now)
        if attachment is not relayed:
            self._note_absurd(robot, relayed, now)
        ahead = self._why_ahead(attachment.order)
        if sample.unverified or ahead:
            term = attachment.order.term if attachment.order else attachment.term
            attachment = attachment.model_copy(update={"order": None, "term": term})
            if sample.forged or ahead:
                self._report_forgery(robot, sample.unverified or ahead, now)
        if self._leads and attachment.order is not None and attachment.order.term == self.term:
            beat = attachment.order.beat
            sent = self._first_beat_at + (beat - 1) * self.rate.period
            self.plan.relays.receive(robot, beat, sent, sample.arrived)
        self.candidacy.receive(robot, attachment, sample.arrived, now)
        self.plan.cohesion.receive(robot, pose, sample.arrived)
        received = attachment.order
        if received is not None and self._supersedes(robot, received, sample.arrived, now):
            self._check_order(received)
            self._newest, self._newest_rose = received, sample.arrived
            self._newest_stale = attachment.stale
        elif received is not None and self._leads and sample.arrived < self._catch_up_until:
            self._check_order(received)
            self._note_earlier_order(robot, received, sample.arrived, stale=attachment.stale)
        if received is not None and received == self._newest:
            self._newest_stale |= attachment.stale

    def _note_earlier_order(self, robot: str, received: Order, arrived: float, *, stale: bool) -> None:
        """Note an order of an earlier term, from a robot that has not relayed one of this term yet.

        Once any robot has relayed an order of this term, the fleet follows that, and of earlier orders only a
        stop or a hold counts.
        """
        if received.term == self.term:
            self._relayed_by.add(robot)
        elif (
            received.term < self.term
            and robot not in self._relayed_by
            and newer(received, self._restored)
            and (received.mode != "run" or not self._relayed_by)
        ):
            self._found_earlier, self._restored = (received, stale), received
        self._catch_up_until = min(self._catch_up_until, arrived + CATCH_UP_TIME)

    def _check_order(self, received: Order) -> None:
        """Raise BadMessage for an order that no robot of this mission accepts."""
        check_shape(received, self.mission.shapes)
        self._fence.check(received)

    def _report_forgery(self, robot: str, why: str, now: Now) -> None:
        """Raise the alarm for a robot that relays a forged order."""
        count, _, when = self._forged.get(robot, (0, "", float("-inf")))
        self._forged[robot] = count + 1, why, now.mono
        if now.mono - when > FORGERY_TIME:
            self.notes.append(f"ALARM: {robot} relays a forged order: {why}")
            self._status_rate = Rate(STATUS_RATE)

    def _note_absurd(self, robot: str, relayed: PositionAttachment, now: Now) -> None:
        """Log that a robot's term is ignored; again only after `FORGERY_TIME` without one."""
        if now.mono - self._absurd.get(robot, float("-inf")) > FORGERY_TIME:
            term = max(relayed.term, relayed.voted_term, relayed.order.term if relayed.order else 0)
            self.notes.append(f"ignores what {robot} relays of the leader: {absurd(term, now)}")
        self._absurd[robot] = now.mono

    def _why_ahead(self, relayed: Order | None) -> str:
        """Return in words why a relayed order cannot be this leader's; empty if it can."""
        if not self._leads or relayed is None or relayed.term != self.term or relayed.beat <= self.beat:
            return ""
        return f"it is ahead of the leader: beat {relayed.beat}, the leader's own {self.beat}"

    def _supersedes(self, robot: str, received: Order, arrived: float, now: Now) -> bool:
        """Return whether it is newer, or rises in an earlier term while the newest has long been silent.

        As at robots, an earlier term counts where orders are signed only if the newest term begins ahead of
        this clock.
        """
        if newer(received, self._newest):
            return True
        if self._newest is None or received.term == self._newest.term:
            return False
        before, self._earlier[robot] = self._earlier.get(robot), received
        rises = before is not None and before.term == received.term and before.beat < received.beat
        binds = self._signer is not None and begun(self._newest.term, now)
        return rises and not binds and arrived - self._newest_rose > expiry(self.mission)

    def _follow_candidacy(self, now: Now) -> bool:
        """Begin or cease to lead with the candidacy; return whether that changed."""
        if self.candidacy.leading == self._leads:
            return False
        self._leads = self.candidacy.leading
        if not self._leads:
            self.plan.team_mode.stand_by()
            self.notes.append(f"no longer leads, stands by; {self._leader or 'no candidate'} leads")
            return True
        self._terms_led, self.beat, self._count, self._advanced_at = self._terms_led + 1, 0, 0, None
        self.rate = Rate(self.mission.robots[self.mission.leader].rate)
        self._certificate_rate = Rate(CERTIFICATE_RATE)
        self._restored = self._newest
        self._relayed_by.clear()
        self._catch_up_until = math.inf if self._newest is None or self.candidacy.unread else now.mono
        if self._newest is not None:
            self._restore_order(self._newest, now, under_way=self._under_way(now))
        if self.candidacy.unread:
            self.plan.team_mode.hold_until_read()
        self.operator_requests.note_restart(now.mono)
        gone_on = self._newest is not None and not (self._anew and self._terms_led == 1)
        where = f"{self.route_time:.1f} s into its route" if gone_on else "from the start"
        self._term = self.term
        self.notes.append(f"leads in term {self.term}, {where}: {self.mode}")
        return True

    def _under_way(self, now: Now) -> bool:
        """Return whether the beat of the newest order rose a moment ago, so that its leader was alive."""
        return not self._newest_stale and now.mono - self._newest_rose <= expiry(self.mission)

    def _restore_order(self, newest: Order, now: Now, *, under_way: bool) -> None:
        if self._anew and self._terms_led == 1:
            self.plan.team_mode.inherit_stop(newest)
        else:
            self.plan.restore(newest, under_way=under_way, mono=now.mono)

    def _catch_up(self, now: Now) -> bool:
        """Restore an earlier order that arrived only after listening; return whether there was one."""
        late, self._found_earlier = self._found_earlier, None
        if late is None or not self._leads:
            return False
        newest, stale = late
        self._restore_order(newest, now, under_way=not stale)
        self.operator_requests.note_restart(now.mono)
        self._advanced_at = None
        self.notes.append(f"found a newer order: goes on {self.route_time:.1f} s into its route: {self.mode}")
        return True

    def _advance(self, now: Now) -> bool:
        """Advance by the time since the last advance, in the mode of then; return whether the order changed.

        It advances when a position is due or the order has changed, not with each message.
        """
        if not self._leads:
            return False
        self.plan.check_driver(now.mono)
        if self._advanced_at is not None and now.mono - self._advanced_at > expiry(self.mission):
            self.plan.team_mode.hold_after_suspension()
            self.operator_requests.note_restart(now.mono)
            self.notes.append(f"was suspended for {now.mono - self._advanced_at:.0f} s: {self.mode}")
        before, self._order_sent = self._order_sent, self.plan.in_force
        changed = before not in {(), self._order_sent}
        if self._advanced_at is not None:
            if not changed and now.mono < self.rate.due - TICK_TOLERANCE:
                return False
            self.plan.go_on(now.mono, min(now.mono - self._advanced_at, LEADER_TIMEOUT_SECONDS), self._mode)
        self._advanced_at, self._mode = now.mono, self.plan.team_mode.mode
        self._note_why_standing()
        return changed

    def _note_why_standing(self) -> None:
        """Log when it begins or ceases to wait for robots, or to stand at the bounds."""
        waiting = self.plan.cohesion.waits_for if self._mode == "run" else ()
        if bool(waiting) != bool(self._waiting):
            self.notes.append(f"waits for {', '.join(waiting)}" if waiting else "no longer waits")
        self._waiting = waiting
        fenced = self.plan.fenced
        if (fenced is not None) != self._fenced:
            self.notes.append(
                f"stops at the bounds: {fenced.words}" if fenced else "goes on, away from the bounds"
            )
        self._fenced = fenced is not None

    def _ballot_messages(self, ballot: Ballot | None) -> list[Outgoing]:
        if ballot is None:
            return []
        return [Outgoing(BALLOT.key(self.name), encode(Text(json_message.encode(ballot).decode())))]

    def _route_messages(self) -> list[Outgoing]:
        payload = self.plan.route.payload
        return [] if payload is None else [Outgoing(ROUTE.key(self.name), payload)]

    def _position_messages(self, now: Now, *, changed: bool) -> list[Outgoing]:
        """Return its position if it is due, or if the order has `changed`; too many changes wait until then.

        A hold or a stop does not wait.
        """
        changed |= self._unsent
        ahead = (self.beat + 1 - self._periods(now.mono)) * self.rate.period
        early = self.beat > 0 and self.mode == "run" and ahead > max(MAX_BEAT_LEAD, self.rate.period)
        due = self.rate.tick(now.mono)
        self._unsent = changed and early and not due
        if not due and (not changed or self._unsent):
            return []
        certify = not changed or self.beat == 0
        return [self._position_message(now, self.mode, changed=changed, certify=certify)]

    def _periods(self, mono: float) -> int:
        """Return the number of periods of this term by `mono` [s], the present one included."""
        return 1 + math.floor((mono - self._first_beat_at + TICK_TOLERANCE) / self.rate.period)

    def _next_beat(self, mono: float, *, changed: bool) -> int:
        """Return the next beat. Beats count periods, missed ones too, so they tell how late an order is.

        A changed order gets a new beat, which is then repeated until time catches up.
        """
        if self.beat == 0:
            self._first_beat_at = mono
            self.plan.relays.begin()
        periods = self._periods(mono)
        return max(self.beat + (1 if changed or self.beat == 0 else 0), periods)

    def _position_message(self, now: Now, mode: Mode, *, changed: bool, certify: bool = False) -> Outgoing:
        """Return its position with its order or, at times if it may `certify`, with its certificate."""
        before, self.beat = self.beat, self._next_beat(now.mono, changed=changed)
        self._count += 1
        if self._term not in {0, self.term}:
            self.notes.append(f"continues in term {self.term}: its clock was set")
        if self.beat != before or self._newest is None or self._term != self.term:
            self._newest, self._newest_rose = self.plan.order(self.term, self.beat, mode), now.mono
            self._newest_stale = False
        self._term = self.term
        publisher_id = (
            self._publisher_id if self._terms_led == 1 else f"{self._publisher_id}.{self._terms_led}"
        )
        attachment = PositionAttachment(
            publisher_id=publisher_id, count=self._count, order=self._newest, mission=self.mission.tag
        )
        if self._signer is not None and certify and self._certificate_rate.tick(now.mono):
            replaced = {"order": None, "certificate": self._signer.certificate, "term": self.term}
            attachment = attachment.model_copy(update=replaced)
        elif self._signer is not None:
            text = json_message.encode(self._newest).decode()
            signature = self._signer.sign(order.statement(self.mission.fingerprint, text))
            attachment = attachment.model_copy(update={"signed": text, "signature": signature})
        pose = Pose(now.wall, self.plan.where(), self.plan.route.heading(self.route_time))
        return Outgoing(POSITION.key(self.mission.leader), encode(pose), json_message.encode(attachment))

    def _status_message(self, now: Now, reason: str) -> Outgoing:
        return Outgoing(STATUS.key(self.name), encode(to_message(status(self, now, reason), now.wall)))
