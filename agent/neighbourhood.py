"""What an agent knows of each neighbour: where it is by now, how fast it goes, whether that is still true."""

from __future__ import annotations

from agent.localisation import Localisation
from agent.stream import Stream
from agent.voice import Voice
from formation import neighbour
from formation.law import Measured
from formation.mission import Mission
from formation.ros2.messages import Displacement, Pose
from formation.unicycle import control_point
from formation.wire import Now

LATELY = 5.0
"""For so long a second voice stays in the status [s]."""


class Neighbour:
    """One neighbour, by its positions over the network or by displacements that a sensor measures."""

    def __init__(self, mission: Mission, name: str, rate: float) -> None:
        """`rate` [Hz] is how often something is heard of it."""
        spec = mission.robots[name]
        self.name = name
        self.stream = Stream(rate)
        self.voice = Voice(name, spec.rate)
        self.displacement = 0j
        """Newest measured z_ij^(i) [m; body frame]; only where a sensor measures it."""
        # The virtual leader has no body: its position is its control point.
        self._offset = 0.0 if name == mission.leader else spec.control_point_offset
        self._top_speed = spec.top_speed
        self._filter = mission.law.velocity_filter
        self._track: neighbour.Track | None = None
        self._unplaced: tuple[float | None] | None = None

    def take_position(self, pose: Pose, arrived: float, now: Now) -> None:
        """Learn from its published pose. Raises BadMessage."""
        elapsed = self.stream.admit(pose.stamp, arrived, now)
        self._see(control_point(pose.position, pose.heading, self._offset), elapsed)

    def take_displacement(self, measured: Displacement, arrived: float, now: Now) -> None:
        """Learn from a displacement measured on my own body. Raises BadMessage."""
        elapsed = self.stream.admit(measured.stamp, arrived, now)
        self.displacement = measured.displacement
        if self._unplaced is not None and elapsed is not None:  # the one before was never placed
            (before,) = self._unplaced
            elapsed = None if before is None else before + elapsed
        self._unplaced = (elapsed,)

    def place(self, here: Localisation) -> None:
        """Put a displacement that has just been measured into the world, seen from where I was then.

        This waits for the odometry of the same moment, which may come after it: with the pose before, a robot
        at full speed would be a whole period off.
        """
        if self._unplaced is not None:
            (elapsed,), self._unplaced = self._unplaced, None
            me, heading = here.seen_from(self.stream.stamp)
            self._see(me + heading * self.displacement, elapsed)

    def _see(self, point: complex, elapsed: float | None) -> None:
        stamp = self.stream.stamp
        if elapsed is None or self._track is None:
            self._track = neighbour.first_seen(stamp, point)
        else:
            before = self._track._replace(stamp=stamp - elapsed)
            self._track = neighbour.seen(before, stamp, point, self._filter, self._top_speed)

    def fresh(self, now: Now) -> bool:
        """Whether it can be followed."""
        return self.stream.fresh(now)

    @property
    def velocity(self) -> complex:
        """Estimated velocity of its control point [m/s; world frame]."""
        return self._track.velocity if self._track else 0j

    def point(self, now: Now, my_age: float, *, carry: bool) -> complex:
        """Its control point when my own measurement, `my_age` [s] old, was made [m; world frame]."""
        if self._track is None:
            raise ValueError(f"{self.name} has not been seen yet")
        if not carry:
            return complex(self._track.point)
        older = self.stream.age(now) - my_age
        # the oldest sample that counts was a limit on the way and a limit here
        return complex(neighbour.carried_to(self._track, self._track.stamp + older, 2.0 * self.stream.limit))


class Neighbourhood:
    """All the neighbours of one robot, and what the law gets to know of them."""

    def __init__(self, mission: Mission, robot: str, law: str) -> None:
        spec, field = mission.robots[robot], law == "field"
        # a neighbour tells where it is at its own rate; a sensor measures at the rate of the robot it sits on
        self.each = {
            name: Neighbour(
                mission, name, spec.rate if spec.measurement == "local" else mission.robots[name].rate
            )
            for name in spec.neighbours
        }
        self._mission, self._robot = mission, robot
        # the paper's law takes neighbours as they were last seen, and knows no velocities
        self._carry = field and mission.law.delay_compensation
        self._feed_forward = field and mission.law.feed_forward
        self._as_measured = not field and spec.measurement == "local"

    def fresh(self, now: Now) -> list[Neighbour]:
        """Those that can be followed."""
        return [one for one in self.each.values() if one.fresh(now)]

    def silences(self, now: Now) -> dict[str, float]:
        """How long each has been silent [s]; infinite before the first message."""
        return {name: one.stream.silence(now) for name, one in self.each.items()}

    def contested(self, now: Now) -> list[str]:
        """Those for whom a second voice has spoken lately."""
        return [one.name for one in self.each.values() if now.mono - one.voice.contested < LATELY]

    def place(self, here: Localisation) -> None:
        """Put what sensors have measured into the world; to be called with every odometry."""
        for one in self.each.values():
            one.place(here)

    def measured(self, here: Localisation, shape: str, now: Now) -> Measured:
        """The law's input: sums over the fresh neighbours, of which there must be at least one."""
        me, heading, my_age = here.point, here.heading, here.stream.age(now)
        mine = self._mission.slot(self._robot, shape)
        relative, desired, velocity = 0j, 0j, 0j
        fresh = self.fresh(now)
        for one in fresh:
            if self._as_measured:
                relative += one.displacement
            else:
                relative += heading.conjugate() * (one.point(now, my_age, carry=self._carry) - me)
            desired += self._mission.slot(one.name, shape) - mine
            velocity += one.velocity
        mean_velocity = velocity / len(fresh) if self._feed_forward else 0j
        return Measured(relative, desired, len(fresh), mean_velocity)
