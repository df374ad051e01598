"""What an agent knows of each neighbour: where it is by now, how fast it goes, whether that is still true."""

from __future__ import annotations

from collections.abc import Iterable

from agent.localisation import Localisation
from agent.stream import Stream
from formation import neighbour
from formation.law import Measured
from formation.messages import Displacement, Pose
from formation.mission import LawSpec, Mission
from formation.unicycle import control_point
from formation.wire import Now


class Neighbour:
    """One neighbour, by its positions over the network or by displacements that a sensor measures."""

    def __init__(self, mission: Mission, name: str) -> None:
        spec = mission.robots[name]
        self.name = name
        self.stream = Stream(spec.rate)
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


def measured(
    fresh: Iterable[Neighbour],
    desired: complex,
    me: complex,
    heading: complex,
    law: LawSpec,
    *,
    now: Now,
    my_age: float,
    as_measured: bool,
) -> Measured:
    """The law's input over the `fresh` neighbours (at least one).

    `desired` is Σ_j z*_ij over them [m; world frame], `me` my control point. `as_measured` takes a sensor's
    displacements as they stand, for the paper's law.
    """
    relative, velocity, count = 0j, 0j, 0
    for one in fresh:
        if as_measured:
            relative += one.displacement
        else:
            relative += heading.conjugate() * (one.point(now, my_age, carry=law.delay_compensation) - me)
        velocity += one.velocity
        count += 1
    return Measured(relative, desired, count, velocity / count if law.feed_forward else 0j)
