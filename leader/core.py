"""The virtual leader: a point that goes along the mission's route and says what the team is to do.

`Leader.step(now, inbox) -> outbox`, without a clock, a socket or a log. Where it is depends on how long it
has been running by the monotonic clock: neither a late step nor a corrected system clock moves it. A leader
that hung for so long that the team took it for gone goes on from where it was, not from where it would be.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from formation import order
from formation.mission import Mission
from formation.order import (
    LEADER_LOST,
    LONGEST_REASON,
    Do,
    Mode,
    Once,
    OperatorReply,
    OperatorRequest,
    Order,
    Told,
)
from formation.rate import Rate
from formation.ros2.messages import Diagnostics, Pose, Status, encode
from formation.route import Route
from formation.topics import POSITION, STATUS, Topic
from formation.wire import BadMessage, Now, Outgoing, Sample

STATUS_RATE = 2.0
"""[Hz]"""
OK, WARNING = 0, 1


class Leader:
    """The leader of a mission. Its term begins with its first step."""

    def __init__(self, mission: Mission, *, hold: bool = False, voice: str = "") -> None:
        """With `hold` it waits at its start until it is told to run; `voice` is drawn anew at every start."""
        self.robot = mission.leader
        self.route_time = 0.0
        """How long it has been running, and so where on its route it is [s]."""
        self.dropped: Counter[str] = Counter()
        """Messages that were not used, by key."""
        self._voice = voice
        self._route = Route.of(mission)
        self.shape = mission.first_shape
        """The shape that the team is to take: the one that was asked for last."""
        self._shapes, self._fingerprint = tuple(mission.shapes), mission.fingerprint
        self._rate = Rate(mission.robots[mission.leader].rate)
        self._status_rate = Rate(STATUS_RATE)
        self._told: Mode = "hold" if hold else "run"
        self._holding = False  # an operator asked for it
        self._stopped = False  # latched until released
        self._once = Once()
        self._in_force: tuple[Mode, str] = "hold", self.shape  # mode and shape since the last step
        self._stepped: float | None = None  # when that was [s, monotonic]
        self._term = 0
        self._beat = 0

    @property
    def publications(self) -> tuple[tuple[Topic, str], ...]:
        """Every topic and key that it publishes."""
        return tuple((topic, topic.key(self.robot)) for topic in (POSITION, STATUS))

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """None: nobody tells the leader where to be."""
        return ()

    @property
    def due(self) -> float:
        """When the next position is due [s, monotonic]."""
        return min(self._rate.due, self._status_rate.due)

    @property
    def mode(self) -> Mode:
        """What the team is to do: a stop outranks a hold, and a hold what it was told before."""
        if self._stopped:
            return "stop"
        return "hold" if self._holding else self._told

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """Go on along the route; a position when one is due, and at once when the order has changed."""
        self.dropped.update(sample.key for sample in inbox)
        changed = self._go_on(now)
        outbox = []
        if self._rate.tick(now.mono) or changed:
            outbox.append(self._position(now))
        if self._status_rate.tick(now.mono) or changed:
            outbox.append(self._status(now, ""))
        return outbox

    def halt(self, now: Now, reason: str) -> list[Outgoing]:
        """The last words: the team holds at once instead of waiting for a beat that does not come."""
        self._told = "hold"
        self._go_on(now)
        return [self._position(now), self._status(now, reason)]

    def request(self, data: bytes) -> bytes:
        """Answer an operator's request; it takes effect with the next step."""
        try:
            request = order.decode(OperatorRequest, data)
        except BadMessage as bad:
            self.dropped["order"] += 1
            return self._reply(ok=False, reason=str(bad))
        return self._once.answer(
            request, lambda: self._obey(request), lambda reason: self._reply(ok=False, reason=reason)
        )

    def _obey(self, request: OperatorRequest) -> bytes:
        if request.shape is not None:
            return self._take(request.shape)
        return self._change(request.do)

    def _take(self, shape: str) -> bytes:
        """Another shape changes nothing else: who stands goes on standing, and takes it when he goes on."""
        if shape not in self._shapes:
            return self._reply(ok=False, reason=f"shape {shape!r}: must be one of {', '.join(self._shapes)}")
        self.shape = shape
        return self._reply(ok=True, reason=f"in shape {shape}")

    def _change(self, wanted: Do) -> bytes:
        if self._stopped and wanted == "run":
            return self._reply(ok=False, reason="stopped: release it first")
        reason = ""
        if wanted == "run":
            self._told, self._holding = "run", False
        elif wanted == "hold":
            self._holding = True
        elif wanted == "stop":
            self._stopped = True
        elif self._stopped:
            self._stopped = False
        elif self._holding:
            self._holding = False
        else:
            reason = "there was nothing to release"
        return self._reply(ok=True, reason=reason)

    def _go_on(self, now: Now) -> bool:
        """Spend the time since the last step in the mode that was in force; whether the order now changes."""
        first = self._stepped is None
        if self._stepped is None:
            self._term = int(now.wall * 1e9)
        elif self._in_force[0] == "run":
            self.route_time += min(now.mono - self._stepped, LEADER_LOST)
        wanted = self.mode, self.shape
        changed = wanted != self._in_force and not first
        self._stepped, self._in_force = now.mono, wanted
        self._once.aware(now.mono)
        return changed

    def _reply(self, *, ok: bool, reason: str) -> bytes:
        said = reason[:LONGEST_REASON]
        return order.encode(OperatorReply(robot=self.robot, ok=ok, mode=self.mode, reason=said))

    def _position(self, now: Now) -> Outgoing:
        where, heading = self._route.position(self.route_time), self._route.heading(self.route_time)
        self._beat += 1
        what = Order(term=self._term, beat=self._beat, mode=self.mode, shape=self.shape)
        told = Told(voice=self._voice, count=self._beat, order=what)
        return Outgoing(POSITION.key(self.robot), encode(Pose(now.wall, where, heading)), order.encode(told))

    def _status(self, now: Now, reason: str) -> Outgoing:
        if not reason and self.route_time >= self._route.total:
            reason = "at the end of the route"
        values = {
            "state": self.mode,
            "reason": reason,
            "shape": self.shape,
            "mission": self._fingerprint,
            "beat": str(self._beat),
            "route_time": f"{self.route_time:.3f}",
            "late": str(self._rate.missed),
            **{f"dropped {key}": str(count) for key, count in self.dropped.items()},
        }
        message = f"{self.mode}: {reason}" if reason else self.mode
        level = OK if self.mode == "run" else WARNING
        status = Status(f"{self.robot}: leader", level, message, self.robot, values)
        return Outgoing(STATUS.key(self.robot), encode(Diagnostics(now.wall, (status,))))
