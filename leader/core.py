"""A candidate: the virtual leader while it leads, a standby that knows how things stand while it does not.

`Leader.step(now, inbox) -> outbox`, without a clock, a socket or a log. Where the leader is depends on how
long the team has been running by the monotonic clock: neither a late step nor a corrected system clock moves
it. One that hung for so long that the team took it for gone goes on from where it was, not from where it
would be. Who begins to lead goes on from the newest order that the robots relay, with a voice of its own.
"""

from __future__ import annotations

import cmath
import math
from collections import Counter, deque
from collections.abc import Sequence
from typing import Protocol

from formation import order
from formation.election import TOLD_FOR, expiry, rank_of, without_absurd_terms
from formation.figure import Figure, check_figure
from formation.geofence import Geofence
from formation.mission import Mission
from formation.order import (
    LEADER_LOST,
    Ballot,
    Mode,
    OperatorRequest,
    Order,
    Told,
    newer,
)
from formation.rate import EARLY, Rate
from formation.ros2.messages import Pose, Text, decode, encode
from formation.topics import BALLOT, COURSE, POSITION, STATUS, Topic
from formation.wire import BadMessage, Now, Outgoing, Sample
from leader.candidacy import Candidacy, linked
from leader.conduct import Conduct
from leader.course import Course
from leader.desk import Desk, Seat
from leader.forgeries import Forgeries
from leader.status import Report, status

STATUS_RATE = 2.0
"""[Hz]"""
COURSE_RATE = 1.0
"""[Hz]"""
CERTIFICATE_RATE = 1.0
"""[Hz]"""


class Signer(Protocol):
    """A candidate's key: `formation.transport.signing.Signer`."""

    @property
    def certificate(self) -> str:
        """As it travels with positions."""

    def sign(self, message: bytes) -> str:
        """The signature of `message`."""


class Leader:
    """One who may lead a mission: its leader, or one of its standbys."""

    def __init__(
        self,
        mission: Mission,
        name: str | None = None,
        *,
        hold: bool = False,
        anew: bool = False,
        voice: str = "",
        signer: Signer | None = None,
        known: int = 0,
    ) -> None:
        """`name`: one of ``mission.candidates``, by default the leader; `voice` is drawn anew at every start.

        Its orders are signed by `signer`, if there is one.

        With `hold` it waits until it is told to run, unless the team is under way; with `anew` it does not go
        on from where the team is, but from the mission's start. `known` is the newest term that the process
        before it knew. Raises ValueError for a name that is no candidate.
        """
        self.name = self.robot = mission.leader if name is None else name
        self.dropped: Counter[str] = Counter()
        """Messages that were not used, by key."""
        self.conduct = Conduct(mission, hold=hold)
        self._mission, self._anew, self._voice, self._signer = mission, anew, voice, signer
        self._forgeries = Forgeries()
        self._candidacy = Candidacy(mission, self.name, known)
        self._desk = Desk(self.name, self.conduct, lambda: self._seat, alone=not mission.standbys)
        self._newest: Order | None = None  # that anybody relays, or that it gave itself,
        self._newest_rose = float("-inf")  # and when [s, monotonic]
        self._earlier: dict[str, Order] = {}  # of a term before that, by the robot that relays it
        self._mixed: dict[str, tuple[str, float]] = {}  # robots of another mission: its tag, and when heard
        self._term = 0  # in which it spoke last
        self._rate = Rate(mission.robots[mission.leader].rate)
        self._status_rate, self._course_rate = Rate(STATUS_RATE), Rate(COURSE_RATE)
        self._certificate_rate = Rate(CERTIFICATE_RATE)
        self._in_force: tuple[object, ...] = ()  # what was said of the team's order since the last step
        self._mode: Mode = "hold"  # since the last step
        self._waiting: tuple[str, ...] = ()
        self._fence, self._fenced = Geofence(mission), False  # whether that stopped it at the newest step
        self._stepped: float | None = None  # when that was [s, monotonic]
        self._leads, self._reigns, self._beat, self._count = False, 0, 0, 0
        self._began = 0.0  # when the first beat of this term was [s, monotonic]
        self._unsure = False  # leads, and no robot has said yet whether there was an order before
        self._late: Order | None = None  # the one that there was
        robots = mission.followers if mission.together else linked(mission)
        self._followers = {POSITION.key(robot): robot for robot in mission.followers if robot in robots}
        others = [other for other in mission.candidates if other != self.name and mission.standbys]
        self._ballots = {BALLOT.key(other): other for other in others}
        self._courses = {COURSE.key(other): other for other in others}

    @property
    def publications(self) -> tuple[tuple[Topic, str], ...]:
        """Every topic and key that it may publish."""
        own = (STATUS, BALLOT, COURSE) if self._mission.standbys else (STATUS,)
        return (
            (POSITION, POSITION.key(self._mission.leader)),
            *((topic, topic.key(self.name)) for topic in own),
        )

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """Positions of the followers that it is linked with, and what other candidates say."""
        return (*self._followers, *self._ballots, *self._courses)

    @property
    def due(self) -> float:
        """When a step is wanted though nothing arrives [s, monotonic]."""
        due = min(self._candidacy.due, self._status_rate.due)
        return min(due, self._rate.due) if self._leads else due

    @property
    def notes(self) -> deque[str]:
        """What has changed, for people; whoever has written it down clears it."""
        return self._desk.notes

    @property
    def leads(self) -> bool:
        """Whether it led when it took its newest step."""
        return self._leads

    @property
    def term(self) -> int:
        """The newest term that it stood for; 0 before the first."""
        return self._candidacy.term

    @property
    def known(self) -> int:
        """The newest term that it knows."""
        return self._candidacy.known

    @property
    def mode(self) -> Mode:
        """What the team is to do, as far as this one knows."""
        if self._leads or self._candidacy.standing == "listening":
            return self.conduct.will.mode
        return self.conduct.will.rest.mode or (self._newest.mode if self._newest else "hold")

    @property
    def shape(self) -> str:
        """The shape that was asked for last."""
        return self.conduct.mover.wish.shape

    @property
    def figure(self) -> Figure:
        """Where the slots are."""
        return self.conduct.mover.figure

    @property
    def wanted(self) -> Figure:
        """Where they are to be in the end, if the leader goes straight on."""
        wanted = self.conduct.wanted
        if not self._mission.turning:
            return wanted
        heading = self.conduct.course.heading(self.route_time)
        return wanted._replace(rotation=wanted.rotation + cmath.phase(heading))

    @property
    def route_time(self) -> float:
        """How long it has been on its course [s]."""
        return self.conduct.route_time

    def where(self, mono: float) -> complex:
        """The leader's position [m; world frame] at a time not before the newest step, if it goes on so."""
        runs = self._stepped is not None and self._leads and self._mode == "run"
        return self.conduct.where(mono - self._stepped if runs and self._stepped is not None else 0.0)

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """Learn, find out whether it leads, and only then speak; at once when the order has changed."""
        for sample in inbox:
            try:
                self._take(sample, now)
            except BadMessage:
                self.dropped[sample.key] += 1
        outbox = self._voted(self._candidacy.step(now))
        changed = self._settle(now) | self._catch_up(now) | self._go_on(now)
        if self._leads and (self._rate.tick(now.mono) or changed):
            certify = not changed or self._beat == 0
            outbox.append(self._position(now, self.mode, changed=changed, certify=certify))
        if self._mission.standbys and (self._course_rate.tick(now.mono) or changed):
            outbox += self._told_course()
        if self._status_rate.tick(now.mono) or changed or self._desk.unsaid:
            outbox.append(self._status(now, ""))
        return outbox

    def halt(self, now: Now, reason: str) -> list[Outgoing]:
        """The last words: the team holds at once instead of waiting for a beat that does not come.

        What it was told stays in the order, so that the next to lead goes on with that.
        """
        self._candidacy.step(now)
        self._settle(now)
        self._go_on(now)
        outbox = (
            [self._position(now, "stop" if self.mode == "stop" else "hold", changed=True)]
            if self._leads
            else []
        )
        outbox += self._voted(self._candidacy.leave(now))
        return [*outbox, self._status(now, reason)]

    def request(self, data: bytes, heard: float) -> bytes:
        """Answer what an operator asked at `heard` [s, monotonic]; it takes effect with the next step."""
        try:
            request = order.decode(OperatorRequest, data)
        except BadMessage as bad:
            self.dropped["order"] += 1
            return self._desk.reply(ok=False, reason=str(bad))
        return self._desk.answer(request, heard)

    @property
    def _seat(self) -> Seat:
        return Seat(self._candidacy.standing, self._leader, self.mode)

    @property
    def _leader(self) -> str:
        """Who leads, as far as this one knows; empty for nobody."""
        if self._leads:
            return self.name
        known = (
            self._mission.candidates[rank_of(self._candidacy.known) :][:1] if self._candidacy.known else ()
        )
        return known[0] if known and known[0] != self.name else ""

    def _take(self, sample: Sample, now: Now) -> None:
        """Learn from a message. Raises BadMessage."""
        if sample.key in self._followers:
            self._take_position(self._followers[sample.key], sample, now)
        elif sample.key in self._ballots:
            ballot = order.decode(Ballot, decode(Text, sample.payload).text.encode())
            self._candidacy.hear_ballot(ballot, self._ballots[sample.key], sample.arrived, now)
        elif sample.key in self._courses:
            if self.conduct.learn(Course.read(sample.payload)) and self._leads:
                self.notes.append("knows now which route the leader was on, and goes on")
        else:
            raise BadMessage("unknown key")

    def _take_position(self, robot: str, sample: Sample, now: Now) -> None:
        pose = decode(Pose, sample.payload)
        told = order.decode(Told, sample.attachment or b"")
        if told.mission != self._mission.tag:
            self._mixed[robot] = told.mission, sample.arrived
        told = without_absurd_terms(told, now)
        ahead = self._ahead(told.order)
        if sample.unverified or ahead:
            told = told.model_copy(update={"order": None})
            if sample.forged or ahead:
                self._alarm(robot, sample.unverified or ahead, now)
        self._candidacy.hear(robot, told, sample.arrived, now)
        self.conduct.together.hear(robot, pose, sample.arrived)
        heard = told.order
        if heard is not None and self._supersedes(robot, heard, sample.arrived):
            self._check(heard)
            self._newest, self._newest_rose = heard, sample.arrived
        elif heard is not None and self._unsure:
            self._check(heard)
            self._unsure = False
            self._late = heard if heard.term < self.term else None

    def _check(self, heard: Order) -> None:
        """Raise BadMessage for an order that no robot of this mission takes."""
        check_figure(heard, self._mission.shapes)
        self._fence.check(heard)

    def _alarm(self, robot: str, why: str, now: Now) -> None:
        """Tell people of a robot that relays what no leader gave."""
        if self._forgeries.hear(robot, why, now.mono):
            self.notes.append(f"ALARM: {robot} relays a forged order: {why}")
            self._status_rate = Rate(STATUS_RATE)

    def _ahead(self, relayed: Order | None) -> str:
        """Why a relayed order cannot be this leader's, in words; empty if it can."""
        if not self._leads or relayed is None or relayed.term != self.term or relayed.beat <= self._beat:
            return ""
        return f"it is ahead of the leader: beat {relayed.beat}, the leader's own {self._beat}"

    def _supersedes(self, robot: str, heard: Order, arrived: float) -> bool:
        """Whether it is newer, or rises in an earlier term while the newest has long been silent."""
        if newer(heard, self._newest):
            return True
        if self._newest is None or heard.term == self._newest.term:
            return False
        before, self._earlier[robot] = self._earlier.get(robot), heard
        rises = before is not None and before.term == heard.term and before.beat < heard.beat
        return rises and arrived - self._newest_rose > expiry(self._mission)

    def _settle(self, now: Now) -> bool:
        """Begin to lead, or cease to, as the candidacy says; whether it has."""
        if self._candidacy.leading == self._leads:
            return False
        self._leads = self._candidacy.leading
        if not self._leads:
            self.conduct.will.stand_by()
            self.notes.append(f"leads no more, and stands by; {self._leader or 'nobody'} leads")
            return True
        self._reigns, self._beat, self._count, self._stepped = self._reigns + 1, 0, 0, None
        self._rate = Rate(self._mission.robots[self._mission.leader].rate)
        self._certificate_rate = Rate(CERTIFICATE_RATE)
        self._unsure = self._newest is None
        if self._newest is not None:
            self._continue(self._newest)
        self._desk.goes_on(now.mono)
        gone_on = self._newest is not None and not (self._anew and self._reigns == 1)
        where = f"goes on after {self.route_time:.1f} s of its route" if gone_on else "from the start"
        self._term = self.term
        self.notes.append(f"leads in term {self.term}, {where}: {self.mode}")
        return True

    def _continue(self, newest: Order) -> None:
        """Go on from this order."""
        if self._anew and self._reigns == 1:
            self.conduct.will.inherit_stop(newest)
        else:
            self.conduct.restore(newest)

    def _catch_up(self, now: Now) -> bool:
        """Go on, after all, from where the team was, if its links came later than it listened; whether so."""
        late, self._late = self._late, None
        if late is None or not self._leads:
            return False
        self._continue(late)
        self._desk.goes_on(now.mono)
        self._stepped = None
        self.notes.append(f"goes on after all after {self.route_time:.1f} s of its route: {self.mode}")
        return True

    def _go_on(self, now: Now) -> bool:
        """Spend the time since it last went on in the mode that was in force; whether the order now changes.

        It goes on when a position is due or something has changed, not with each of many messages.
        """
        if not self._leads:
            return False
        before, self._in_force = self._in_force, self._wanted
        changed = before not in {(), self._in_force}
        if self._stepped is not None:
            if not changed and now.mono < self._rate.due - EARLY:
                return False
            self.conduct.go_on(now.mono, min(now.mono - self._stepped, LEADER_LOST), self._mode)
        self._stepped, self._mode = now.mono, self.conduct.will.mode
        self._note_waiting()
        return changed

    @property
    def _wanted(self) -> tuple[object, ...]:
        conduct = self.conduct
        return conduct.will.mode, conduct.mover.wish, conduct.course.id, conduct.tuned

    def _note_waiting(self) -> None:
        waiting = self.conduct.together.waits_for if self._mode == "run" else ()
        if bool(waiting) != bool(self._waiting):
            self.notes.append(f"waits for {', '.join(waiting)}" if waiting else "waits no more")
        self._waiting = waiting
        fenced = self.conduct.fenced
        if bool(fenced) != self._fenced:
            self.notes.append(f"stops at the bounds: {fenced}" if fenced else "goes on, away from the bounds")
        self._fenced = bool(fenced)

    def _voted(self, ballot: Ballot | None) -> list[Outgoing]:
        if ballot is None:
            return []
        return [Outgoing(BALLOT.key(self.name), encode(Text(order.encode(ballot).decode())))]

    def _told_course(self) -> list[Outgoing]:
        payload = self.conduct.course.payload
        return [] if payload is None else [Outgoing(COURSE.key(self.name), payload)]

    def _next_beat(self, mono: float, *, changed: bool) -> int:
        """Beats count periods of time, whatever was missed, so that they tell how late an order is.

        An order that has changed has another beat, and is then said again until time catches up.
        """
        if self._beat == 0:
            self._began = mono
        periods = 1 + math.floor((mono - self._began + EARLY) / self._rate.period)
        return max(self._beat + (1 if changed or self._beat == 0 else 0), periods)

    def _position(self, now: Now, mode: Mode, *, changed: bool, certify: bool = False) -> Outgoing:
        """Where it is, with its order; or, if it may `certify`, now and then with its certificate."""
        before, self._beat = self._beat, self._next_beat(now.mono, changed=changed)
        self._count += 1
        if self._term not in {0, self.term}:
            self.notes.append(f"goes on in term {self.term}: its clock has been set")
        if self._beat != before or self._newest is None or self._term != self.term:
            self._newest, self._newest_rose = self.conduct.order(self.term, self._beat, mode), now.mono
        self._term = self.term
        voice = self._voice if self._reigns == 1 else f"{self._voice}.{self._reigns}"
        told = Told(voice=voice, count=self._count, order=self._newest, mission=self._mission.tag)
        if self._signer is not None and certify and self._certificate_rate.tick(now.mono):
            certificate = self._signer.certificate
            told = Told(
                voice=voice,
                count=self._count,
                certificate=certificate,
                term=self.term,
                mission=self._mission.tag,
            )
        elif self._signer is not None:
            text = order.encode(self._newest).decode()
            signature = self._signer.sign(order.statement(self._mission.fingerprint, text))
            told = told.model_copy(update={"signed": text, "signature": signature})
        pose = Pose(now.wall, self.conduct.where(), self.conduct.course.heading(self.route_time))
        return Outgoing(POSITION.key(self._mission.leader), encode(pose), order.encode(told))

    def _status(self, now: Now, reason: str) -> Outgoing:
        report = Report(
            name=self.name,
            seat=self._seat,
            term=self.term if self._leads else self._candidacy.known,
            conduct=self.conduct,
            mission=self._mission.fingerprint,
            refusals=self._candidacy.refusals(now.mono),
            mixed={robot: tag for robot, (tag, when) in self._mixed.items() if now.mono - when <= TOLD_FOR},
            tag=self._mission.tag,
            beat=self._beat,
            late=self._rate.missed,
            asked=self._desk.asked(),
            dropped=self.dropped,
            forgers=self._forgeries.lately(now.mono),
        )
        return Outgoing(STATUS.key(self.name), encode(status(report, now, reason)))
