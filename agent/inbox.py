"""Pass each received message to the parts that use it; count those that are refused, and why.

The handler of a message that only one part uses is in that part's `handlers`; the others are here.

A process that was frozen (SIGSTOP, a suspended machine, no CPU for long) then reads the messages that waited
in its sockets, with the arrival time of now. So messages that arrive within `DRAIN_TIME` of waking are
refused, and nothing received before counts as fresh.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

from formation.agent.collision_filter import Avoiding
from formation.agent.following.attachment import Answers
from formation.agent.following.neighbour import Neighbour
from formation.agent.following.neighbours import Neighbourhood
from formation.agent.following.orders import Orders
from formation.agent.perception.perception import Perception
from formation.agent.pose.estimator import Localisation
from formation.agent.safety.scanner import Scanner
from formation.control.unicycle import Command
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import LEADER_TIMEOUT_SECONDS
from formation.protocol.request import MAX_REASON_CHARS
from formation.ros2.messages import LaserScan, Odometry, Pose, decode
from formation.slots.geofence import Geofence
from formation.topics import ODOM, POSE, POSITION, SCAN
from formation.wire import BadMessage, Handler, Now, Sample

MAX_PAUSE = LEADER_TIMEOUT_SECONDS
"""Longest time between two steps of a process that was not frozen [s]; each makes at least two a second."""
DRAIN_TIME = 0.25
"""Time after waking in which messages that waited may still arrive [s]."""


@dataclass(slots=True)
class Wakefulness:
    """Whether one agent was frozen, by the times of its steps."""

    pause: float = 0.0
    """Length of the newest freeze, until it is over [s]; 0 if there is none."""
    stepped: float | None = None
    """Time of the newest step [s, monotonic]."""
    woke: float = float("-inf")
    """When the newest freeze ended [s, monotonic]."""

    def step(self, moment: float) -> bool:
        """Record a step at `moment` [s, monotonic]; whether the process has just woken from a freeze."""
        last, self.stepped = self.stepped, moment
        if last is None or moment - last <= MAX_PAUSE:
            return False
        self.pause, self.woke = moment - last, moment
        return True

    def waited(self, arrived: float) -> bool:
        """Whether a message that arrived then [s, monotonic] may have waited during a freeze."""
        return self.pause > 0.0 and arrived <= self.woke + DRAIN_TIME

    def confirm(self, *, beat_rose: float, follows: bool) -> None:
        """End the freeze once the leader's beat has risen since [s, monotonic], and the own pose follows."""
        if follows and beat_rose > self.woke:
            self.pause = 0.0


@dataclass(slots=True)
class InboxState:
    """Messages that were not used."""

    dropped: Counter[str] = field(default_factory=Counter)
    """Their number, by key."""
    last_dropped: dict[str, str] = field(default_factory=dict)
    """Why the newest of them was not used, by key."""
    refused: dict[str, float] = field(default_factory=dict)
    """When the newest of them arrived that the robot's own sensors sent [s, monotonic], by key."""


class Inbox:
    """Passes one agent's messages on."""

    def __init__(
        self,
        mission: Mission,
        robot: str,
        here: Localisation,
        neighbours: Neighbourhood,
        avoiding: Avoiding,
        perception: Perception | None,
        orders: Orders,
        answers: Answers,
        fence: Geofence,
        moved: Callable[[float], None],
    ) -> None:
        """Update the parts from `here` to `answers`; call `moved` when an own position has arrived."""
        self.state = InboxState()
        self._spec, self._leader, self._fence = mission.robots[robot], mission.leader, fence
        self._own = (ODOM if self._spec.localisation == "odometry" else POSE).key(robot)
        self._scan = SCAN.key(robot)
        self._handlers: dict[str, Handler] = {
            self._own: partial(self._take_own, here, avoiding.scanner, moved)
        }
        for name, neighbour in neighbours.each.items():
            self._handlers[POSITION.key(name)] = partial(self._take_position, neighbour, orders, answers)
        for name, other in avoiding.others.items():
            self._handlers[POSITION.key(name)] = partial(_take_avoided, other, answers)
        if avoiding.scanner is not None:
            self._handlers[self._scan] = partial(_take_scan, avoiding.scanner, perception)
        for part in (neighbours, here, orders):
            self._handlers |= part.handlers
        self.keys = tuple(self._handlers)
        """Every key that it subscribes to: own position, neighbours, and robots that it avoids."""

    def process_inbox(self, inbox: Sequence[Sample], now: Now) -> tuple[bool, float | None]:
        """Process `inbox`; whether an own position came, and the time since the one before [s]."""
        interval, moved = None, False
        for sample in inbox:
            try:
                handle = self._handlers.get(sample.key)
                if handle is None:
                    raise BadMessage("unknown key")
                taken = handle(sample, now)
            except BadMessage as bad:
                self.drop(sample.key, bad)
                if sample.key in {self._own, self._scan}:
                    self.state.refused[sample.key] = sample.arrived
                continue
            if sample.key == self._own:
                moved = True
                interval = taken if interval is None else interval + (taken or 0.0)
        return moved, interval

    def own_refusal(self, since: float) -> str:
        """Why the newest own position was refused, if it came after `since` [s, monotonic]; else empty."""
        return self._refusal(self._own, since)

    def scan_refusal(self, since: float) -> str:
        """Why the newest range scan was refused, if it came after `since` [s, monotonic]; else empty."""
        return self._refusal(self._scan, since)

    def _refusal(self, key: str, since: float) -> str:
        came = self.state.refused.get(key, -math.inf)
        return self.state.last_dropped.get(key, "") if came > since else ""

    def drop(self, key: str, bad: BadMessage) -> None:
        """Count a message that is not used, and store why."""
        where = key if key in self._handlers or key == "order" else "elsewhere"
        self.state.dropped[where] += 1
        self.state.last_dropped[where] = str(bad)[:MAX_REASON_CHARS]  # it may quote a stranger's text

    def _take_own(
        self,
        here: Localisation,
        scanner: Scanner | None,
        moved: Callable[[float], None],
        sample: Sample,
        now: Now,
    ) -> float | None:
        if self._spec.localisation != "odometry":
            taken = here.update_pose(decode(Pose, sample.payload), sample.arrived, now)
            moved(sample.arrived)
            return taken
        odometry = decode(Odometry, sample.payload)
        taken = here.update_pose(odometry, sample.arrived, now)
        moved(sample.arrived)
        if scanner is not None:
            scanner.moved(sample.arrived, Command(odometry.speed, odometry.turn_rate))
        return taken

    def _take_position(
        self, neighbour: Neighbour, orders: Orders, answers: Answers, sample: Sample, now: Now
    ) -> None:
        pose = decode(Pose, sample.payload)
        attachment = json_message.decode(PositionAttachment, sample.attachment or b"")
        neighbour.check_mission(attachment.mission, sample.arrived)
        if self._spec.measurement != "local":
            neighbour.stream.check_late(pose.stamp, sample.arrived)  # before any of it is used
        leads = neighbour.name == self._leader
        neighbour.publisher.admit(attachment, sample.arrived, orders.voter.state.voted_term if leads else 0)
        wrong: BadMessage | None = None
        if self._spec.measurement != "local":
            try:
                answered = answers.answered(neighbour.name, attachment.received, sample.arrived)
                neighbour.take_position(pose, sample.arrived, now, answered=answered)
            except BadMessage as bad:
                wrong = bad
        else:
            neighbour.take_report(pose, sample.arrived, now)
        neighbour.state.unavailable = attachment.unavailable
        neighbour.state.searching = attachment.searching
        neighbour.state.beyond = not self._fence.holds(pose.position)
        try:
            if sample.unverified:
                orders.refuse(sample.unverified, neighbour.name, sample.arrived, forged=sample.forged)
            elif attachment.order is not None:
                signed = attachment.signed, attachment.signature
                late = 0.0 if self._spec.measurement == "local" else neighbour.stream.believed_delay
                age = attachment.order_age + late
                orders.receive(attachment.order, neighbour.name, sample.arrived, now, signed, age)
        except BadMessage as bad:
            self.drop(sample.key, bad)
        if wrong is not None:
            raise wrong


def _take_avoided(other: Neighbour, answers: Answers, sample: Sample, now: Now) -> None:
    """Use the position of a robot that is only avoided, and none of the orders that it relays."""
    pose = decode(Pose, sample.payload)
    attachment = json_message.decode(PositionAttachment, sample.attachment or b"")
    other.check_mission(attachment.mission, sample.arrived)
    other.stream.check_late(pose.stamp, sample.arrived)
    other.publisher.admit(attachment, sample.arrived, 0)
    answered = answers.answered(other.name, attachment.received, sample.arrived)
    other.take_position(pose, sample.arrived, now, answered=answered)
    other.state.searching = attachment.searching


def _take_scan(scanner: Scanner, perception: Perception | None, sample: Sample, now: Now) -> None:
    scan = scanner.corrected(decode(LaserScan, sample.payload))
    scanner.process_scan(scan, sample.arrived, now)
    if perception is not None:
        perception.take_scan(scan, scanner)
