"""What one agent hears: each message goes to the part that it concerns; what is none is counted, and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial

from agent.avoiding import Avoiding
from agent.localisation import Localisation
from agent.neighbourhood import Neighbour, Neighbourhood
from agent.orders import Orders
from agent.scanner import Scanner
from formation import order
from formation.election import Voter
from formation.geofence import Geofence
from formation.mission import Mission
from formation.order import LONGEST_REASON, Ballot, Told
from formation.ros2.messages import Displacement, LaserScan, Odometry, Pose, Text, decode
from formation.topics import BALLOT, ODOM, POSE, POSITION, RELATIVE, SCAN
from formation.unicycle import Command
from formation.wire import BadMessage, Now, Sample

Handler = Callable[[Sample, Now], float | None]


class Hearing:
    """The inbox of one agent."""

    def __init__(
        self,
        mission: Mission,
        robot: str,
        here: Localisation,
        neighbours: Neighbourhood,
        avoiding: Avoiding,
        orders: Orders,
        fence: Geofence,
        moved: Callable[[float], None],
    ) -> None:
        """The parts from `here` to `orders` learn; `moved` is called when the own position has arrived."""
        self.dropped: Counter[str] = Counter()
        """Messages that were not used, by key."""
        self.last_dropped: dict[str, str] = {}
        """Why the newest of them was not."""
        self._spec, self._leader, self._fence = mission.robots[robot], mission.leader, fence
        self._own = (ODOM if self._spec.localisation == "odometry" else POSE).key(robot)
        self._handlers: dict[str, Handler] = {
            self._own: partial(self._take_own, here, avoiding.scanner, moved)
        }
        for name, neighbour in neighbours.each.items():
            self._handlers[POSITION.key(name)] = partial(self._take_position, neighbour, orders)
            if self._spec.measurement == "local":
                self._handlers[RELATIVE.key(robot, name)] = partial(_take_displacement, neighbour)
        for name, other in avoiding.others.items():
            self._handlers[POSITION.key(name)] = partial(_take_minded, other)
        if avoiding.scanner is not None:
            self._handlers[SCAN.key(robot)] = partial(_take_scan, avoiding.scanner)
        if mission.standbys:
            for name in mission.candidates:
                self._handlers[BALLOT.key(name)] = partial(_take_ballot, name, orders.voter)

    @property
    def keys(self) -> tuple[str, ...]:
        """Every key that concerns it: what tells its own position, its neighbours, whom it minds."""
        return tuple(self._handlers)

    @property
    def unused(self) -> dict[str, tuple[int, str]]:
        """How many messages were not used, by key, and why the newest was not."""
        return {where: (count, self.last_dropped[where]) for where, count in self.dropped.items()}

    def take(self, inbox: Sequence[Sample], now: Now) -> tuple[bool, float | None]:
        """Learn; whether its own position was told, and over which time [s] it is known how it came there."""
        interval, moved = None, False
        for sample in inbox:
            try:
                handle = self._handlers.get(sample.key)
                if handle is None:
                    raise BadMessage("unknown key")
                taken = handle(sample, now)
            except BadMessage as bad:
                self.drop(sample.key, bad)
                continue
            if sample.key == self._own:
                moved = True
                interval = taken if interval is None else interval + (taken or 0.0)
        return moved, interval

    def drop(self, key: str, bad: BadMessage) -> None:
        """Count what is not used, and keep in mind why."""
        where = key if key in self._handlers or key == "order" else "elsewhere"
        self.dropped[where] += 1
        self.last_dropped[where] = str(bad)[:LONGEST_REASON]  # it may quote what a stranger wrote

    def _take_own(
        self,
        here: Localisation,
        scanner: Scanner | None,
        moved: Callable[[float], None],
        sample: Sample,
        now: Now,
    ) -> float | None:
        if self._spec.localisation != "odometry":
            taken = here.take(decode(Pose, sample.payload), sample.arrived, now)
            moved(sample.arrived)
            return taken
        odometry = decode(Odometry, sample.payload)
        taken = here.take(odometry, sample.arrived, now)
        moved(sample.arrived)
        if scanner is not None:
            scanner.moved(sample.arrived, Command(odometry.speed, odometry.turn_rate))
        return taken

    def _take_position(self, neighbour: Neighbour, orders: Orders, sample: Sample, now: Now) -> None:
        pose = decode(Pose, sample.payload)
        told = order.decode(Told, sample.attachment or b"")
        neighbour.check_mission(told.mission, sample.arrived)
        if self._spec.measurement == "network":
            neighbour.stream.check_late(pose.stamp, sample.arrived)  # before anything of it counts
        leads = neighbour.name == self._leader
        neighbour.voice.admit(told, sample.arrived, orders.voter.promise if leads else 0)
        wrong: BadMessage | None = None
        if self._spec.measurement == "network":
            try:
                neighbour.take_position(pose, sample.arrived, now)
            except BadMessage as bad:
                wrong = bad
        neighbour.aside = told.aside
        neighbour.beyond = not self._fence.holds(pose.position)
        try:
            if sample.unverified:
                orders.refuse(sample.unverified, neighbour.name, sample.arrived, forged=sample.forged)
            elif told.order is not None:
                signed = told.signed, told.signature
                orders.hear(told.order, neighbour.name, sample.arrived, now, signed)
        except BadMessage as bad:
            self.drop(sample.key, bad)
        if wrong is not None:
            raise wrong


def _take_minded(other: Neighbour, sample: Sample, now: Now) -> None:
    """Nothing but where it is counts of whom it only minds: that it relays no orders keeps ways short."""
    pose = decode(Pose, sample.payload)
    told = order.decode(Told, sample.attachment or b"")
    other.check_mission(told.mission, sample.arrived)
    other.stream.check_late(pose.stamp, sample.arrived)
    other.voice.admit(told, sample.arrived, 0)
    other.take_position(pose, sample.arrived, now)


def _take_displacement(neighbour: Neighbour, sample: Sample, now: Now) -> None:
    neighbour.take_displacement(decode(Displacement, sample.payload), sample.arrived, now)


def _take_scan(scanner: Scanner, sample: Sample, now: Now) -> None:
    scanner.take(decode(LaserScan, sample.payload), sample.arrived, now)


def _take_ballot(candidate: str, voter: Voter, sample: Sample, now: Now) -> None:
    ballot = order.decode(Ballot, decode(Text, sample.payload).text.encode())
    voter.hear(ballot, candidate, sample.arrived, now)
