"""What an agent makes of its robot's range scan: what is in the way, how fast it may go, is it from now.

A scan is put where its robot is by now: by dead reckoning from the speeds that odometry reports, or, where
its place is told from outside, from those at which its wheels follow the commands, over the fraction of a
second that a scan is old. That asks for no position and no heading, so neither a heading that is still being
learned nor odometry that begins to count anew moves a post.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from agent.odometer import believable
from agent.stream import Stream
from formation import scan as scans
from formation.mission import Mission
from formation.neighbour import FRESH_PERIODS
from formation.ros2.messages import LaserScan
from formation.scan import STOOD, Circle, Mate, Motion
from formation.unicycle import Command, along, driven
from formation.wire import Now
from formation.zones import AT_REST, Body, Zone, guarded

HORIZON = 2.0
"""What is further away is in nobody's way yet [m]."""
LONGEST_SWEEP = 1.0
"""[s]"""
EARLY = 0.1
"""A scan may come so long before its own stamp [s]: clocks are kept no better."""
UNSEEN = 5e-3
"""So much of its margin a robot need not see [m]: ranges are no better."""
NOISE = 0.02
"""What is seen is kept so much further away than it could be seen at least [m], or noise would hide it."""


class Moving(NamedTuple):
    """How the robot has moved from a moment on [s, monotonic]."""

    since: float
    command: Command


class Scanner:
    """One robot's range scanner. Feed it with `moved` or `told`, and `take`; ask the rest for a command."""

    def __init__(self, mission: Mission, robot: str) -> None:
        spec = mission.robots[robot]
        self.required = spec.scanner == "required"
        """Whether the robot may not move while it is silent."""
        self.stream = Stream(spec.scan.rate)
        self.zone = Zone.CLEAR
        """What the newest command met."""
        self._scan, self._radius, self._limits = spec.scan, spec.radius, spec.limits
        # what is outside of body and margin is so far from the scanner [m]
        self._sees_from = spec.radius + spec.scan.margin - abs(spec.scan.mount.at)
        self._body = Body(spec.radius, spec.scan.margin, spec.scan.lag)
        self._lasts = FRESH_PERIODS / spec.rate  # a command at most, then the guard stops the robot [s]
        longest = self.stream.limit + self.stream.longest_way  # that a scan is old
        self._keeps = longest + LONGEST_SWEEP  # speeds [s]
        zone = spec.radius + spec.scan.margin + spec.max_speed * (longest + self._lasts + spec.scan.lag)
        # what is further away than this cannot matter before the next scan
        self._reach = max(HORIZON, zone) + spec.max_speed * longest
        self._moves: deque[Moving] = deque()
        self._circles: list[Circle] = []  # of the newest scan [m; body frame at its end]
        self._began = self._ended = 0.0  # [s, monotonic]
        self._range_min = 0.0  # of the newest scan [m]
        self._wrong: Moving | None = None  # the newest that it cannot have done
        self._told: Command | None = None  # what it does by now follows from this, for nobody says it

    @property
    def margin(self) -> float:
        """Of free space that is kept around the robot, so that what is seen stays to be seen [m]."""
        seen_from = self._range_min + abs(self._scan.mount.at) - self._radius
        return max(self._scan.margin, seen_from + NOISE)

    def moved(self, moment: float, moving: Command) -> None:
        """The robot said at `moment` [s, monotonic] that it goes so fast.

        Faster than it can go is no motion: by that the scan in hand would be carried away, through a wall.
        The robot is taken to go on as before, and what it has done since that scan is in doubt.
        """
        while len(self._moves) > 1 and self._moves[1].since < moment - self._keeps:
            self._moves.popleft()
        if believable(moving, self._limits):
            self._moves.append(Moving(moment, moving))
        else:
            self._wrong = Moving(moment, moving)

    def told(self, moment: float, command: Command) -> None:
        """The robot is told so from `moment` [s, monotonic] on, and only by that is known how it moves.

        Its wheels are taken to follow with the mission's lag. Wheels that lag less have less way to go.
        """
        self._follow(moment)
        if self._told is None:
            self.moved(moment, AT_REST)
        self._told = command

    def take(self, scan: LaserScan, arrived: float, now: Now) -> None:
        """Learn from a scan. Raises BadMessage for one whose stamp does not follow from the last."""
        self.stream.admit(scan.stamp, arrived, now)
        self._follow(arrived)
        says = scan.time_increment * (len(scan.ranges) - 1)
        told = says if self._scan.sweep is None else self._scan.sweep
        sweep = min(abs(told), LONGEST_SWEEP)
        # a scan that is taken for newer than it is may cost more than room: by a stamp that is not believed
        # it is as old as it can well be, and not, as a neighbour's position, from now
        began = arrived - min(max(0.0, self.stream.underway), self.stream.longest_way)
        # no scan comes before it is made: there are drivers that stamp the last beam
        self._began = min(began, arrived - sweep)
        self._ended = self._began + sweep
        self._range_min = scan.range_min
        motion = self._motion(self._began, self._ended) if sweep else STOOD
        hits = scans.points(scan, self._scan.mount, self._radius, motion, against=told < 0.0)
        found = scans.circles(hits, scan.angle_increment)
        reach = self._reach + self.margin - self._scan.margin
        self._circles = [circle for circle in found if abs(circle.at) - circle.radius < reach]

    def fresh(self, now: Now) -> bool:
        """Whether there is a scan that is believed."""
        return self.stream.fresh(now)

    def silence(self, now: Now) -> float:
        """For how long a scan has been missing that the robot may not move without [s]; else 0."""
        return self.stream.silence(now) if self.required else 0.0

    @property
    def doubt(self) -> str | None:
        """Why the newest scan is not to be believed, in words that follow its name; else None."""
        way, most = self.stream.underway, self.stream.longest_way
        if self.stream.arrived is None:
            return None
        if way > most:
            return f"stamped {way:.2f} s before it came, must be {most:g} s at most"
        if way < -EARLY:
            return f"stamped {-way:.2f} s after it came, must be {EARLY:g} s at most"
        if self._range_min > self._sees_from + UNSEEN:
            return f"has range_min {self._range_min:g} m: this robot needs at most {self._sees_from:.3g} m"
        if self._wrong is not None and self._wrong.since >= self._began:
            speed, turn_rate = self._wrong.command
            return f"cannot be placed by odometry that said {speed:.3g} m/s, {turn_rate:.3g} rad/s"
        return None

    def strangers(self, now: Now, mates: Sequence[Mate]) -> list[Circle]:
        """What was seen and is none of `mates` [body frame, now]; nothing by a scan that is old.

        `mates` are those of the team whose places now are known from elsewhere, and who are minded there;
        they are looked for where they were when the scan was made.
        """
        self._follow(now.mono)
        if not self.fresh(now):
            return []
        age = now.mono - self._ended
        then = [mate._replace(at=mate.at - age * mate.velocity) for mate in mates]
        return scans.strangers(scans.carried(self._circles, self._went(self._ended, now.mono)), then)

    def guarded(self, command: Command, strangers: Sequence[Circle], now: Now) -> Command:
        """The command, slowed as the protective zones ask for `strangers`.

        It is taken to last until the guard would end it, so that the robot stops in time though this agent
        dies; and for as long as the scan is old, so that what has come nearer meanwhile, as fast as the robot
        itself, is minded as well.
        """
        self._follow(now.mono)
        moving = self._moves[-1].command if self._moves else AT_REST
        hold = max(0.0, now.mono - self._ended) + self._lasts
        seen = [point for circle in strangers for point in circle.points]
        body = self._body._replace(margin=self.margin)
        command, self.zone = guarded(command, moving, seen, body, hold)
        return command

    def _follow(self, moment: float) -> None:
        """What the robot does at `moment` [s, monotonic], and has done since that was asked last."""
        if self._told is not None and self._moves and moment > self._moves[-1].since:
            since, moving = self._moves.pop()
            mean, now = driven(moving, self._told, self._scan.lag, moment - since)
            self._moves.append(Moving(since, mean))
            self.moved(moment, now)

    def _motion(self, begin: float, end: float) -> Motion:
        """Way and turn from one moment to another [s, monotonic]."""
        each = self._during(begin, end)
        return Motion(sum(t * c.speed for t, c in each), sum(t * c.turn_rate for t, c in each))

    def _went(self, begin: float, end: float) -> tuple[complex, complex]:
        pose = 0j, 1.0 + 0.0j
        for time, command in self._during(begin, end):
            pose = along(*pose, command.speed * time, command.turn_rate * time)
        return pose

    def _during(self, begin: float, end: float) -> list[tuple[float, Command]]:
        """What it did for how long [s]; before the first that is known, it stood."""
        spans = []
        for move in reversed(self._moves):
            time = end - max(move.since, begin)
            if time > 0.0:
                spans.append((time, move.command))
            end = min(end, move.since)
        return spans[::-1]
