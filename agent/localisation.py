"""Where am I, and which way do I face: from odometry or from outside, without measuring the heading."""

from __future__ import annotations

import math

from agent.odometer import Odometer
from agent.overhead import Overhead
from agent.sighting import Sighting
from agent.stream import Stream
from formation import heading as observers
from formation.avoidance import SHARPER, SLACK, course_gain, heading_doubt
from formation.heading import Travel
from formation.lateness import Trust, trusted
from formation.mission import Mission
from formation.neighbour import LONGEST_WAY
from formation.order import Order
from formation.plane import rotation, shorten, unit
from formation.ros2.messages import Odometry, Pose
from formation.ros2.ros import MAX_POSITION
from formation.unicycle import Command, control_point
from formation.wire import Now

UNDER_WAY = 1.0
"""A team that has been on its way for longer no longer faces as its mission's start says [s]."""
SURE = 0.5
"""From this length on the observer's estimate is learned from the way, and may doubt a measured heading."""
LONGEST = 1e100
"""Where the printed observer's estimate is cut off: it grows without end while a robot reverses."""


class Localisation:
    """Position by odometry or from outside; heading by the observer of Eq. (3), or as it is measured.

    Of the odometry's heading the observer uses only the change.
    """

    def __init__(self, mission: Mission, robot: str, law: str) -> None:
        spec = mission.robots[robot]
        self.stream = Stream(spec.rate)
        self.jumped: str | None = None
        """The newest jump in words, for as long as it is minded; else None."""
        self.jumps = 0
        """How many there were."""
        self.follows = False
        """Whether the newest message closed an interval: without that the heading is not kept up."""
        self.trust = Trust()
        """Whether the newest message is young enough to act on."""
        self.age_limit = LONGEST_WAY
        """How old it may be when it comes [s]."""
        self.late = 0
        """Messages that came more than half a period late."""
        self.position = 0j
        """Centre [m; world frame]."""
        self.travel: Travel | None = None
        """Newest interval; None where it is unknown how the robot came where it is."""
        self._source: Odometer | Overhead = (
            Odometer(mission, robot) if spec.localisation == "odometry" else Overhead(mission, robot)
        )
        self._printed = law == "paper"
        self._measures_heading = spec.heading == "measured"
        self._measured = 1.0 + 0.0j
        self._gain = mission.law.observer_gain
        self._limits = spec.limits
        self._period = 1.0 / spec.rate
        # beside a measured heading the observer only watches, and begins with what it has seen: nothing
        self._estimate = 0j if self._measures_heading and not self._printed else mission.first_heading(robot)
        # who counts from the mission's start pose has turned since by what the odometry says
        counted = spec.localisation == "odometry" and spec.odometry_frame == "start"
        self._guessed = counted and spec.first_heading_deg is None and not self._measures_heading
        # from then on its robot may face another way than any that the mission knows of
        self._guesses = spec.first_heading_deg is None and not self._measures_heading and not self._printed
        # the filter's own: positions from outside are too noisy to learn from them faster
        self._sharp_gain = self._gain * (SHARPER if spec.localisation == "odometry" else 1.0)
        self._noise = mission.collisions.noise
        self._course = self._estimate
        self._way = 0.0  # since it knew nothing of it [m]
        self._joined = False
        self._before: tuple[float, complex, complex] | None = None
        self._calm = 0.0
        self._judged = float("-inf")  # arrival of the newest message that was checked for age [s, monotonic]

    @property
    def source(self) -> str:
        """What positions come from: ``odometry`` or ``pose``."""
        return self._source.name

    @property
    def alignment(self) -> str:
        """How that is placed in the world, in words."""
        return self._source.alignment

    @property
    def doubt(self) -> str | None:
        """What makes the newest message hard to believe though it follows from the one before, in words."""
        if max(abs(self.position.real), abs(self.position.imag)) > MAX_POSITION:
            return f"is beyond ±{MAX_POSITION:g} m"
        learned = self._measures_heading and not self._printed and abs(self._estimate) > SURE
        # from 90 degrees on the law drives a robot away from where it shall be
        if learned and (self._measured.conjugate() * self._estimate).real < 0.0:
            return "has a heading against the way that the robot goes"
        return self._source.doubt

    @property
    def age(self) -> float:
        """How old the newest message was when it came [s], by its stamp or by how quickly others came.

        A stamp from the future says nothing of that. A stamp from the past may be of a clock that is wrong,
        but the same stamp comes from a driver that is late, so it counts.
        """
        stream = self.stream
        refused = stream.arrived is None or stream.received > stream.arrived
        return stream.late if refused else max(stream.late, stream.underway)

    def judge_age(self) -> None:
        """Decide whether the newest message is young enough; to be called when all have been read."""
        if self.stream.received > self._judged:
            self._judged = self.stream.received
            self.trust = trusted(self.trust, self.age, self.age_limit, self._judged)

    @property
    def heading(self) -> complex:
        """Heading ζ̂ as the law is to take it, of unit length [world frame]."""
        return self._measured if self._measures_heading else unit(self._estimate)

    @property
    def point(self) -> complex:
        """Estimated control point [m; world frame]."""
        return control_point(self.position, self.heading, self._limits.offset)

    @property
    def course(self) -> complex:
        """Heading as the collision filter is to take it, of unit length [world frame]."""
        return self._measured if self._measures_heading else unit(self._course)

    @property
    def course_doubt(self) -> float:
        """By how much that may be wrong [rad]."""
        if self._measures_heading:
            return SLACK
        by_way, lacks = heading_doubt(self._way, self._sharp_gain, self._noise), 1.0 - abs(self._course)
        # its way explains so much; seen from outside, wheels may stand though they were told to go
        if math.sin(min(by_way - SLACK, 0.5 * math.pi)) >= lacks:
            return by_way
        return SLACK + math.asin(lacks) if lacks < SURE else math.pi

    def seen_from(self, stamp: float) -> tuple[complex, complex]:
        """Control point [m; world frame] and heading when something was measured on board at `stamp` [s]."""
        before = self._before
        if before is not None and abs(stamp - before[0]) < abs(stamp - self.stream.stamp):
            return before[1], before[2]
        return self.point, self.heading

    def doubt_all(self) -> None:
        """Trust nothing that was heard: this process was frozen."""
        self.stream.doubt()
        self.follows, self.travel = False, None

    def carried(self) -> None:
        """Forget the filter's heading: the robot was moved by hand."""
        self._course, self._way = self.heading, 0.0

    def joins(self, order: Order) -> None:
        """Order and robot are known; the first time, the mission's guess of its heading may be old.

        Who joins a team that is under way guesses that its odometry, which counts in the world, also faces
        where it says; seen from outside, that it faces where the leader goes.
        """
        if self._joined:
            return
        self._joined = True
        if order.time < UNDER_WAY or not self._guesses or self._guessed:
            return
        if isinstance(self._source, Odometer):
            self._estimate = self._measured
        elif order.place is not None:
            self._estimate = rotation(order.place.heading)

    def goes_on(self, message: Odometry | Pose, arrived: float, since: float) -> str | None:
        """Ready what another process has known until `since` [s, monotonic] for its robot's next `message`.

        Why that is not to be, in words.
        """
        over = arrived - (since if self.stream.arrived is None else self.stream.arrived)
        if isinstance(self._source, Odometer) and isinstance(message, Odometry):
            return self._source.unlike(message, over)
        if isinstance(self._source, Overhead) and isinstance(message, Pose):
            self._source.stood(since)
            return self._source.unlike(message, over)
        return f"it was localised by {self._source.name}"

    def told(self, moment: float, command: Command) -> None:
        """The robot was sent `command` at `moment` [s, monotonic]."""
        if isinstance(self._source, Overhead):
            self._source.told(moment, command)

    def take(self, message: Odometry | Pose, arrived: float, now: Now) -> float | None:
        """Learn from a message: the interval it closes [s], None where it opens one. Raises BadMessage."""
        before, stamped = self.stream.arrived, self.stream.stamp
        elapsed = self.stream.admit(message.stamp, arrived, now)
        self._before = None if before is None else (stamped, self.point, self.heading)
        over = elapsed if elapsed is not None or before is None else arrived - before
        seen = self._see(message, over, now)
        self.position, self._measured, self.follows = seen.position, seen.heading, False
        self.travel = None
        if seen.travel is None:
            if self._printed:
                self._estimate = observers.printed_start(seen.position, self._gain)
            elif self._guessed and before is None:
                self._estimate = self._course = seen.heading
            return None
        if seen.jumped is not None:
            self.jumped, self._calm = seen.jumped, 0.0
            self.jumps += 1
            self._estimate *= 0.0 if self._measures_heading and not self._printed else seen.turned
            self._course, self._way = self.heading, 0.0
            return None
        if elapsed is None or elapsed > self.stream.limit:
            if not self._printed:  # nothing is learned from so long a way, but it turned meanwhile
                self._estimate *= rotation(seen.travel.turn)
                self._course *= rotation(seen.travel.turn)
            return None
        self.late += elapsed > 1.5 * self._period
        self.follows, self.travel = True, seen.travel
        self._mind(elapsed)
        if self._printed:
            self._estimate = shorten(observers.mended(self._estimate, seen.travel, self._gain), LONGEST)
        else:
            self._estimate = observers.innovation(self._estimate, seen.travel, self._gain)
            gain = course_gain(self._way, self._sharp_gain, self._noise)
            self._course = observers.innovation(self._course, seen.travel, gain)
            self._way += abs(seen.travel.distance)
        return elapsed

    def _see(self, message: Odometry | Pose, over: float | None, now: Now) -> Sighting:
        if isinstance(self._source, Odometer) and isinstance(message, Odometry):
            return self._source.see(message, over, self.stream.limit)
        if isinstance(self._source, Overhead) and isinstance(message, Pose):
            return self._source.see(message, over, now.mono - self.stream.age(now))
        raise TypeError(f"a robot localised by {self._source.name} takes no {type(message).__name__}")

    def _mind(self, elapsed: float) -> None:
        """Forget a jump after as long as silence would be minded."""
        self._calm += elapsed
        if self._calm > self.stream.limit:
            self.jumped = None
