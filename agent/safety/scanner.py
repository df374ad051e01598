"""What an agent derives from its robot's range scan: obstacles, the allowed speed, and freshness.

A scan is moved to its robot's present pose: by dead reckoning from the speeds that odometry reports, or,
with external poses, from those at which its wheels follow the commands, over the fraction of a second that
a scan is old. That needs no position and no heading, so neither a heading that is still being learned nor
odometry that restarts moves an obstacle.
"""

from __future__ import annotations

import math
from array import array
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import NamedTuple

from formation.agent.pose.motion_model import Held, forget, spans
from formation.agent.pose.sources import believable
from formation.agent.pose.stream import Stream, StreamState
from formation.control.tracker import FRESH_PERIODS
from formation.control.unicycle import AT_REST, Command, along, driven
from formation.control.zones import MIN_VIEW_ANGLE, Body, Sight, Zone
from formation.mission.model import Mission
from formation.protocol.reasons import Code, Reason
from formation.ros2.messages import LaserScan
from formation.sensing import scan as scans
from formation.sensing.scan import STOOD, Circle, Mate, Motion
from formation.wire import Now

MAX_OBSTACLE_DISTANCE = 2.0
"""Distance beyond which obstacles are ignored [m]."""
LONGEST_SWEEP = 1.0
"""[s]"""
MAX_SCAN_LEAD = 0.1
"""Time by which a scan may arrive before its own stamp [s], as clocks are no more precise."""
UNSEEN_MARGIN = 5e-3
"""Part of its margin that a robot need not see [m], as ranges are no more precise."""
NEAREST_DEPTH = 0.01
"""By how much farther than the nearest point those are that may be the nearest, as ranges have noise [m]."""
RANGE_NOISE = 0.02
"""Distance by which obstacles are kept beyond the least range [m], so that noise does not hide them."""
FROZEN_DISTANCE, FROZEN_ANGLE = 0.03, 0.03
"""Motion [m; rad] after which a scan that stays the same bit for bit is frozen; or a turn of two beams."""
MIN_EQUAL_BEAMS = 8
"""Hits that must have been repeated, in all: a few may be equal by chance."""
MIN_REPEAT_SHARE = 0.75
"""Share of the mission's period after which a scan counts as another: some drivers publish one twice."""
MAX_REMEMBERED_SCANS = 16
"""Earlier scans with which a new one is compared: some drivers send old ones in turn."""
MAX_EMPTY_TIME = 3.0
"""Time for which no beam may come back while other robots should be seen [s]."""


class Repeated(NamedTuple):
    """A scan that may be received again, and the robot's motion since it came first."""

    digest: str
    """Of its ranges."""
    since: float
    """When it first ended [s, monotonic]."""
    beams: int = 0
    """Number of its hits that were repeated since the newest scan that was none of those before."""
    at: complex = 0j
    """Where the robot is now [m; body frame at `since`]."""
    facing: complex = 1.0 + 0.0j
    """Its heading, unit [the same frame]."""
    turn: float = 0.0
    """Its turn [rad]."""

    def moved(self, at: complex, facing: complex, turn: float) -> Repeated:
        """The same after a motion of the robot, to that pose in its frame before and by `turn` [rad]."""
        there = self.at + self.facing * at
        return self._replace(at=there, facing=self.facing * facing, turn=self.turn + turn)


class ScanMemory(NamedTuple):
    """What the next agent of the robot must know of its scans, to notice a frozen scanner."""

    ended: float
    """When the newest ended [s, monotonic]."""
    empty_since: float
    """Since when no beam has come back [s, monotonic]."""
    repeated: tuple[Repeated, ...]
    """The newest that hit something, oldest first."""


@dataclass(slots=True, kw_only=True)
class ScannerState:
    """The newest scan, and the robot's motion since."""

    stream: StreamState
    zone: Zone = Zone.CLEAR
    """The protective zone that limited the newest command."""
    moves: deque[Held] = field(default_factory=deque)
    """The robot's recent motion, oldest first."""
    circles: list[Circle] = field(default_factory=list)
    """Obstacles in the newest scan [m; body frame at its end]."""
    began: float = 0.0
    """When the newest scan began [s, monotonic]."""
    ended: float = 0.0
    """When the newest scan ended [s, monotonic]."""
    range_min: float = 0.0
    """Of the newest scan [m]."""
    range_max: float = math.inf
    """Of the newest scan [m]."""
    increment: float = math.tau
    """Angle between two beams of the newest scan [rad]."""
    unseen: tuple[complex, ...] = ()
    """Directions in which it has no beam, unit [body frame]."""
    invalid: bool = False
    """Whether none of its beams is a measurement."""
    empty_since: float = math.inf
    """Since when no beam has come back [s, monotonic]."""
    missing: tuple[str, ...] = ()
    """Robots that scans without any hit should have shown for long."""
    overhang: float = 0.0
    """Distance by which a body may reach beyond what the newest scan shows of it [m]."""
    repeated: tuple[Repeated, ...] = ()
    """The newest scans that hit something, without their repetitions, oldest first."""
    frozen: Reason | None = None
    """Why it is no measurement of the present; None if it is one."""
    wrong: Held | None = None
    """The newest impossible motion."""
    commanded: Command | None = None
    """The newest command, where the motion is computed from it because no sensor reports it."""


class Scanner:
    """One robot's range scanner. Call `moved` or `commanded`, and `process_scan`, before the rest."""

    def __init__(self, mission: Mission, robot: str) -> None:
        spec = mission.robots[robot]
        self.required = spec.scanner == "required"
        """Whether the robot must not move while it is silent."""
        self.stream = Stream(spec.scan.rate)
        self.state = ScannerState(stream=self.stream.state)
        self._scan, self._radius, self._limits = spec.scan, spec.radius, spec.limits
        self._margin = spec.margin
        self._overhangs = {name: mission.robots[name].overhang for name in mission.followers if name != robot}
        # distance from the scanner to what is outside of body and margin [m]
        self._sees_from = spec.radius + spec.margin - abs(spec.scan.mount.at)
        # a robot that must see its neighbours judges by itself whether it does
        seen = {} if spec.measurement == "scan" else {n: mission.robots[n].seen for n in mission.followers}
        self._shown = {name: one.radius for name, one in seen.items() if one.radius is not None}
        self._body = Body(spec.radius, spec.margin, spec.scan.lag)
        self._lasts = FRESH_PERIODS / spec.rate  # a command at most, then the watchdog stops the robot [s]
        longest = self.stream.limit + self.stream.longest_delay  # age of a scan
        self._keeps = longest + LONGEST_SWEEP  # speeds [s]
        still = self.stream.limit + self._lasts + spec.scan.lag  # for so long it may drive after a scan [s]
        # distance to which the scanner must see, so that the robot can stop from its top speed [m]
        self._sees_to = spec.radius + spec.margin + abs(spec.scan.mount.at) + spec.max_speed * still
        zone = spec.radius + spec.margin + spec.max_speed * (longest + self._lasts + spec.scan.lag)
        # what is further away than this cannot matter before the next scan
        self._reach = max(MAX_OBSTACLE_DISTANCE, zone) + spec.max_speed * longest

    @property
    def margin(self) -> float:
        """Width of the free space around the robot: keeps obstacles in sight, and bodies apart [m]."""
        seen_from = self.state.range_min + abs(self._scan.mount.at) - self._radius
        return max(self._margin + self.state.overhang, seen_from + RANGE_NOISE)

    @property
    def memory(self) -> ScanMemory:
        """What the next agent must know."""
        return ScanMemory(self.state.ended, self.state.empty_since, self.state.repeated)

    def restore(self, memory: ScanMemory) -> None:
        """Have it know what the scanner of another agent did."""
        self.state.ended, self.state.empty_since, self.state.repeated = memory

    def moved(self, moment: float, moving: Command) -> None:
        """Store the speeds that the robot reports at `moment` [s, monotonic].

        Impossible speeds are ignored: they would move the present scan, even through a wall. The robot is
        assumed to continue as before, and its motion since that scan is in doubt.
        """
        state = self.state
        forget(state.moves, moment - self._keeps)
        if believable(moving, self._limits):
            state.moves.append(Held(moment, moving))
        else:
            state.wrong = Held(moment, moving)

    def commanded(self, moment: float, command: Command) -> None:
        """Store a command of `moment` [s, monotonic], where only commands tell how the robot moves.

        Its wheels are assumed to follow with the mission's lag. Wheels that lag less need less distance.
        """
        self._follow(moment)
        if self.state.commanded is None:
            self.moved(moment, AT_REST)
        self.state.commanded = command

    def corrected(self, scan: LaserScan) -> LaserScan:
        """The scan without the faults of its driver, if the mission names the scanner's model."""
        return scan if self._scan.scanner is None else self._scan.scanner.corrected(scan)

    def process_scan(self, scan: LaserScan, arrived: float, now: Now) -> None:
        """Process a scan. Raises BadMessage if its stamp does not follow from the last."""
        state = self.state
        self.stream.admit(scan.stamp, arrived, now)
        self._follow(arrived)
        signed = self.sweep(scan)
        sweep = min(abs(signed), LONGEST_SWEEP)
        # taking a scan for newer than it is may cause a collision: if its stamp is not believed
        # it has the greatest plausible age, and not, as a neighbour's position, none
        began = arrived - min(max(0.0, self.stream.age_on_arrival), self.stream.longest_delay)
        before = state.ended
        # no scan arrives before it is made: some drivers stamp the last beam
        state.began = min(began, arrived - sweep)
        state.ended = state.began + sweep
        state.range_min, state.range_max = scan.range_min, scan.range_max
        view = scan.angle_min, scan.angle_increment, len(scan.ranges)
        state.unseen = scans.unseen(*view, self._scan.mount.heading) if self.required else ()
        state.increment, state.invalid = abs(scan.angle_increment), scan.invalid
        motion = self._motion(state.began, state.ended) if sweep else STOOD
        hits = scans.points(scan, self._scan.mount, self._radius, motion, against=signed < 0.0)
        state.empty_since = math.inf if hits else min(state.empty_since, state.ended)
        state.missing = () if hits else state.missing
        self._compare(scan, len(hits), before)
        found = scans.circles(hits, scan.angle_increment)
        reach = self._reach + self.margin - self._margin
        state.circles = [circle for circle in found if abs(circle.at) - circle.radius < reach]

    def sweep(self, scan: LaserScan) -> float:
        """Time from a scan's first beam to its last [s]; negative if the first beam is the newest."""
        return self._scan.signed_sweep(scan.time_increment * (len(scan.ranges) - 1))

    def fresh(self, now: Now) -> bool:
        """Whether there is a scan of the present."""
        return self.stream.fresh(now) and self.state.frozen is None

    def repeats(self, scan: LaserScan) -> bool:
        """Whether a processed scan is one of the newest again, bit for bit: no new measurement."""
        digest = _digest(scan)
        return any(one.digest == digest and one.beams >= MIN_EQUAL_BEAMS for one in self.state.repeated)

    def _compare(self, scan: LaserScan, hits: int, before: float) -> None:
        """Compare a scan with those before, of which the newest ended at `before` [s, monotonic].

        While the robot moves no two scans are equal, unless they hit nothing.
        """
        state, digest = self.state, _digest(scan)
        motion = *self._went(before, state.ended), self._motion(before, state.ended).turn
        each, state.frozen = [one.moved(*motion) for one in state.repeated], None
        number = next((number for number, one in enumerate(each) if one.digest == digest), None)
        if number is None and hits:
            each = [one._replace(beams=0) for one in each] + [Repeated(digest, state.ended)]
        state.repeated = tuple(each[-MAX_REMEMBERED_SCANS:])
        if number is None:
            return
        known = each[number]._replace(beams=each[number].beams + hits)
        state.repeated = (*each[:number], known, *each[number + 1 :])
        over = state.ended - known.since
        turn_limit = max(FROZEN_ANGLE, 2.0 * abs(scan.angle_increment))
        moved = abs(known.at) > FROZEN_DISTANCE or abs(known.turn) > turn_limit
        if moved and known.beams >= MIN_EQUAL_BEAMS and over >= MIN_REPEAT_SHARE / self._scan.rate:
            state.frozen = Reason.of(
                Code.SCAN_FROZEN,
                duration=over,
                distance=abs(known.at),
                turn=abs(known.turn),
                limit=FROZEN_DISTANCE,
                turn_limit=turn_limit,
            )

    def empty(self, now: Now) -> float:
        """Time for which no beam has come back [s]."""
        return max(0.0, now.mono - self.state.empty_since)

    def expect(self, distances: Mapping[str, float]) -> None:
        """Store which of the robots at `distances` [m] a scan should show, though it has no hit.

        Those of which the mission says what scanners see, if it is two beams wide, in the nearer half of the
        range. A scan that does not cover a full turn need not show them. A scanner that did not show them is
        in doubt until a beam comes back, also when they have gone on.
        """
        state = self.state
        near = 0.0 if state.unseen else 0.5 * state.range_max
        state.missing = state.missing or tuple(
            name
            for name, distance in distances.items()
            if distance < near and self._shown.get(name, 0.0) > distance * state.increment
        )

    def silence(self, now: Now) -> float:
        """Time for which a required scan has been missing [s]; else 0."""
        return self.stream.silence(now) if self.required else 0.0

    @property
    def doubt(self) -> Reason | None:
        """Why the newest scan is not believed; else None."""
        state = self.state
        delay, most = self.stream.state.delay, self.stream.longest_delay
        if self.stream.state.arrived is None or state.frozen is not None:
            return state.frozen
        if delay > most:
            return Reason.of(Code.SCAN_LATE, age=delay, limit=most)
        if delay < -MAX_SCAN_LEAD:
            return Reason.of(Code.SCAN_EARLY, age=-delay, limit=MAX_SCAN_LEAD)
        insufficient = self._insufficient
        if insufficient is None and state.wrong is not None and state.wrong.since >= state.began:
            speed, turn_rate = state.wrong.command
            return Reason.of(Code.SCAN_UNPLACED, speed=speed, turn_rate=turn_rate)
        return insufficient

    @property
    def _insufficient(self) -> Reason | None:
        """Why the newest scan does not show enough to drive by it; else None."""
        state = self.state
        if state.range_min > self._sees_from + UNSEEN_MARGIN:
            return Reason.of(Code.SCAN_BLIND, value=state.range_min, limit=self._sees_from)
        if self.required and state.range_max < self._sees_to:
            return Reason.of(Code.SCAN_SHORT, value=state.range_max, limit=self._sees_to)
        if any(one.real >= math.cos(MIN_VIEW_ANGLE) for one in state.unseen):
            return Reason.of(Code.SCAN_SECTOR, limit=MIN_VIEW_ANGLE)
        if state.invalid or state.missing:
            empty = state.ended - state.empty_since
            return Reason.of(Code.SCAN_EMPTY, duration=empty, robots=state.missing)
        return None

    def strangers(self, now: Now, mates: Sequence[Mate]) -> list[Circle]:
        """What was measured besides `mates` [body frame, now]; nothing if the scan is old.

        `mates` are robots of the fleet that are avoided at positions known from elsewhere; they are
        expected where they were when the scan was made. All other robots of the fleet may be among the
        strangers: `margin` then includes how far their bodies reach beyond what is seen of them.
        """
        state = self.state
        known = {mate.name for mate in mates}
        state.overhang = max((one for name, one in self._overhangs.items() if name not in known), default=0.0)
        self._follow(now.mono)
        if not self.fresh(now):
            return []
        age = now.mono - state.ended
        then = [mate._replace(at=mate.at - age * mate.velocity) for mate in mates]
        return scans.strangers(scans.carried(state.circles, self._went(state.ended, now.mono)), then)

    def sight(self, strangers: Sequence[Circle], now: Now) -> Sight:
        """What the protective zones must keep clear of.

        A command is assumed to last until the watchdog would end it, so that the robot stops in time if
        this agent dies; and for the age of the scan, so that obstacles that have approached meanwhile, as
        fast as the robot itself, count as well.
        """
        self._follow(now.mono)
        moving = self.state.moves[-1].command if self.state.moves else AT_REST
        hold = max(0.0, now.mono - self.state.ended) + self._lasts
        seen = [point for circle in strangers for point in circle.points]
        return Sight(moving, seen, self._body._replace(margin=self.margin), hold, self.state.unseen)

    def beside(self, sight: Sight, speed: float, kept: Callable[[float], float]) -> Sight:
        """Return the sight of a robot that probes straight on at `speed` [m/s] and may be inside its margin.

        There it may drive neither way past a wall or a post. For the few millimetres of a probe it is enough
        that it leaves all that is nearest, by noise too: its margin is then as narrow as the distance that it
        keeps to the rest; `kept` returns that from the least one now [m].
        """
        nearest = min(map(abs, sight.points), default=math.inf)
        if any(point.real * speed >= 0.0 for point in sight.points if abs(point) < nearest + NEAREST_DEPTH):
            return sight
        least = max(self.state.overhang, kept(nearest - sight.body.radius))
        return sight._replace(body=sight.body._replace(margin=min(sight.body.margin, least), spread=0.0))

    def _follow(self, moment: float) -> None:
        """Extend the computed motion to `moment` [s, monotonic]."""
        if self.state.commanded is not None and self.state.moves and moment > self.state.moves[-1].since:
            since, moving = self.state.moves.pop()
            mean, now = driven(moving, self.state.commanded, self._scan.lag, moment - since)
            self.state.moves.append(Held(since, mean))
            self.moved(moment, now)

    def _motion(self, begin: float, end: float) -> Motion:
        """Displacement and turn from one moment to another [s, monotonic]."""
        each = self._during(begin, end)
        return Motion(sum(t * c.speed for t, c in each), sum(t * c.turn_rate for t, c in each))

    def _went(self, begin: float, end: float) -> tuple[complex, complex]:
        pose = 0j, 1.0 + 0.0j
        for time, command in self._during(begin, end):
            pose = along(*pose, command.speed * time, command.turn_rate * time)
        return pose

    def _during(self, begin: float, end: float) -> list[tuple[float, Command]]:
        """Speeds and their durations [s]; before the first known one, zero."""
        return list(spans(self.state.moves, begin, end))[::-1]


def _digest(scan: LaserScan) -> str:
    return blake2b(array("d", scan.ranges), digest_size=8).hexdigest()
