"""Where am I, and which way do I face: from the robot's own odometry, without measuring the heading."""

from __future__ import annotations

from agent.stream import Stream
from formation import heading as observers
from formation.heading import Travel
from formation.messages import Odometry
from formation.mission import Mission
from formation.plane import angle_between, shorten, unit
from formation.unicycle import control_point
from formation.wire import Now

LONGEST = 1e100
"""Where the printed observer's estimate is cut off: it grows without end while a robot reverses."""
JUMP_MARGIN = 0.1
"""How far a position may be off what the robot's speed explains before it counts as a jump [m]."""
TURN_MARGIN = 0.3
"""The same for its heading [rad]."""


class Localisation:
    """Position by odometry, heading by the observer of Eq. (3): of the odometry's only the change is used."""

    def __init__(self, mission: Mission, robot: str, law: str) -> None:
        spec = mission.robots[robot]
        self.stream = Stream(spec.rate)
        self.jumped: str | None = None
        """The newest jump in words, for as long as it is minded; else None."""
        self.follows = False
        """Whether the newest message closed an interval: without that the heading is not kept up."""
        self.late = 0
        """Odometry messages that came more than half a period late."""
        self.position = 0j
        """Centre [m; world frame]."""
        self._printed = law == "paper"
        self._gain = mission.law.observer_gain
        self._limits = spec.limits
        self._period = 1.0 / spec.rate
        self._estimate = mission.first_heading(robot)
        self._last: Odometry | None = None
        self._before: tuple[float, complex, complex] | None = None
        self._calm = 0.0

    @property
    def heading(self) -> complex:
        """Estimated heading ζ̂, of unit length [world frame]."""
        return unit(self._estimate)

    @property
    def point(self) -> complex:
        """Estimated control point [m; world frame]."""
        return control_point(self.position, self.heading, self._limits.offset)

    def seen_from(self, stamp: float) -> tuple[complex, complex]:
        """Control point [m; world frame] and heading when something was measured on board at `stamp` [s]."""
        before = self._before
        if before is not None and abs(stamp - before[0]) < abs(stamp - self.stream.stamp):
            return before[1], before[2]
        return self.point, self.heading

    def take(self, odometry: Odometry, arrived: float, now: Now) -> float | None:
        """Learn from a message: the interval it closes [s], None where it opens one. Raises BadMessage."""
        before = self.stream.arrived
        elapsed = self.stream.admit(odometry.stamp, arrived, now)
        last, self._last = self._last, odometry
        self._before = None if last is None else (last.stamp, self.point, self.heading)
        self.position, self.follows = odometry.position, False
        if last is None and self._printed:
            self._estimate = observers.printed_start(odometry.position, self._gain)
        if last is None or before is None:
            return None
        over = arrived - before if elapsed is None else elapsed
        travel = Travel(
            distance=0.5 * (last.speed + odometry.speed) * over,
            # ∫ω dt exactly, however ω changed in between; the heading itself is never read
            turn=float(angle_between(last.heading, odometry.heading)),
            displacement=odometry.position - last.position,
        )
        if self._is_jump(travel, over):
            return None
        if elapsed is None or elapsed > self.stream.limit:
            return None
        self.late += elapsed > 1.5 * self._period
        self.follows = True
        self._mind(elapsed)
        if self._printed:
            self._estimate = shorten(observers.printed(self._estimate, travel, self._gain), LONGEST)
        else:
            self._estimate = observers.innovation(self._estimate, travel, self._gain)
        return elapsed

    def _is_jump(self, travel: Travel, over: float) -> bool:
        """Whether the robot cannot have driven that far, or turned so much, in `over` [s]."""
        farthest = max(abs(travel.displacement), abs(travel.distance))
        if farthest > 1.5 * self._limits.max_speed * over + JUMP_MARGIN:
            self.jumped = f"{farthest:.2f} m"
        elif abs(travel.turn) > 1.5 * self._limits.max_turn_rate * over + TURN_MARGIN:
            self.jumped = f"{travel.turn:+.2f} rad"
        else:
            return False
        self._calm = 0.0
        return True

    def _mind(self, elapsed: float) -> None:
        """Forget a jump after as long as silence would be minded."""
        self._calm += elapsed
        if self._calm > self.stream.limit:
            self.jumped = None
