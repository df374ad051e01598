"""What an agent knows of each neighbour: where it is by now, how fast it goes, whether that is still true.

And whom it follows: neighbours that can be followed; while there is none, fallbacks that can; while there is
no such either, neighbours that are on their way back to their slots; or nobody.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from agent.localisation import Localisation
from agent.slots import Slots
from agent.stream import Stream
from agent.voice import Voice
from formation import neighbour
from formation.graph import cyclic_core
from formation.law import Measured
from formation.mission import Mission
from formation.order import check_mission
from formation.ros2.messages import Displacement, Pose
from formation.stability.losses import leads
from formation.unicycle import control_point
from formation.wire import Now

MIXED = 1.0
"""After its newest position with another mission a neighbour counts as running that for so long [s]."""
LATELY = 5.0
"""For so long a second voice stays in the status [s]."""
RECOVERED = 0.5
"""A neighbour can be followed for so long before fallbacks are let go for it [s]."""
STANDS = 1.0
"""A robot that has not moved for so long stands [s]."""
MOVED = 0.03
"""So far a robot that stands may seem to move [m]."""


class Whereabouts(NamedTuple):
    """Where another robot is, as far as is known."""

    at: complex
    """Where its velocity has carried it [m; world frame]."""
    last: complex
    """Where it was seen last [m; world frame]."""
    velocity: complex
    """[m/s; world frame]"""
    age: float
    """Of what is known of either robot [s]."""
    unsure: float = 0.0
    """If it is silent: radius of a disc in which it stands [m]."""


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
        self.aside = False
        """Whether it says that others had better go on without it."""
        self.beyond = False
        """Whether it says that it is outside the mission's bounds."""
        # The virtual leader has no body: its position is its control point.
        self._tag = mission.tag
        self._other = "", float("-inf")  # tag of the other mission that it runs, and when that was heard
        self._offset = 0.0 if name == mission.leader else spec.control_point_offset
        self._top_speed = spec.top_speed
        self._filter = mission.law.velocity_filter
        self._track: neighbour.Track | None = None
        self._body: neighbour.Track | None = None  # its centre; only where positions come over the network
        self._unplaced: tuple[float | None] | None = None
        self._anchor = 0j  # where it was when it last moved,
        self._moved = float("-inf")  # and when [s, monotonic]

    def take_position(self, pose: Pose, arrived: float, now: Now) -> None:
        """Learn from its published pose. Raises BadMessage."""
        elapsed = self.stream.admit(pose.stamp, arrived, now)
        stamp = self.stream.stamp
        self._body = self._followed(self._body, stamp, pose.position, elapsed)
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
        if self.stream.arrived is not None and abs(point - self._anchor) > MOVED:
            self._anchor, self._moved = point, self.stream.arrived
        self._track = self._followed(self._track, stamp, point, elapsed)

    def _followed(
        self, track: neighbour.Track | None, stamp: float, point: complex, elapsed: float | None
    ) -> neighbour.Track:
        if elapsed is None or track is None:
            return neighbour.first_seen(stamp, point)
        before = track._replace(stamp=stamp - elapsed)
        return neighbour.seen(before, stamp, point, self._filter, self._top_speed)

    def check_mission(self, tag: str, arrived: float) -> None:
        """Raise BadMessage, and keep in mind, that it runs another mission than this robot."""
        if tag != self._tag:
            self._other = tag, arrived
        check_mission(self.name, tag, self._tag)

    def other_mission(self, now: Now) -> str | None:
        """Tag of the other mission that it runs, as heard lately; None if it runs this one, or is silent."""
        tag, heard = self._other
        return tag if now.mono - heard <= MIXED else None

    def fresh(self, now: Now) -> bool:
        """Whether what is known of it is from now."""
        return self.stream.fresh(now)

    def going(self, now: Now) -> bool:
        """Whether it has moved lately."""
        return now.mono - self._moved < STANDS

    @property
    def velocity(self) -> complex:
        """Estimated velocity of its control point [m/s; world frame]."""
        return self._track.velocity if self._track else 0j

    def point(self, now: Now, my_age: float, *, carry: bool) -> complex:
        """Its control point when my own measurement, `my_age` [s] old, was made [m; world frame]."""
        if self._track is None:
            raise ValueError(f"{self.name} has not been seen yet")
        return self._carried(self._track, now, my_age) if carry else self._track.point

    def around(self, now: Now, my_age: float, *, body: bool) -> Whereabouts:
        """Where its centre, or else its control point, was at that moment."""
        track = self._body if body else self._track
        if track is None:
            raise ValueError(f"{self.name} has not been seen yet")
        carried, age = self._carried(track, now, my_age), self.stream.age(now)
        if self.fresh(now):
            return Whereabouts(carried, track.point, track.velocity, max(age, my_age))
        unsure = neighbour.uncertain(age, self._top_speed)
        middle, radius = neighbour.somewhere(track.point, carried, unsure)
        return Whereabouts(middle, middle, 0j, 0.0, radius)

    def _carried(self, track: neighbour.Track, now: Now, my_age: float) -> complex:
        older = self.stream.age(now) - my_age
        # the oldest sample that counts was on the way for as long as is believed, and then a limit here
        longest = self.stream.longest_way + self.stream.limit
        return neighbour.carried_to(track, track.stamp + older, longest)


class Neighbourhood:
    """All whom one robot may measure, and what the law gets to know of those whom it follows."""

    def __init__(self, mission: Mission, robot: str, law: str) -> None:
        spec, field = mission.robots[robot], law == "field"
        # a neighbour tells where it is at its own rate; a sensor measures at the rate of the robot it sits on
        self.each = {
            name: Neighbour(
                mission, name, spec.rate if spec.measurement == "local" else mission.robots[name].rate
            )
            for name in spec.measurable
        }
        self.guides: tuple[str, ...] = ()
        """Whom it follows."""
        self._mission, self._robot = mission, robot
        self._neighbours, self._fallbacks = spec.neighbours, spec.fallback_neighbours
        self._circular = mission.names.index(robot) in cyclic_core(mission.graph)
        self._instead = False  # whether it goes by its fallbacks
        self._back = float("inf")  # since when a neighbour can be followed again [s, monotonic]
        # the paper's law takes neighbours as they were last seen, and knows no velocities
        self._carry = field and mission.law.delay_compensation
        self._feed_forward = field and mission.law.feed_forward
        self._as_measured = not field and spec.measurement == "local"

    def doubt_all(self) -> None:
        """Trust nothing that was heard: this process was frozen."""
        for one in self.each.values():
            one.stream.doubt()

    def choose(self, now: Now) -> None:
        """Settle whom to follow."""
        usable = self._usable(self._neighbours, now)
        if self._circular and len(usable) < len(self._neighbours):
            usable = self._leading(usable, usable)
        if usable and not self._instead:
            self.guides = usable
            return
        others = self._leading(self._usable(self._fallbacks, now), usable)
        self._back = min(self._back, now.mono) if usable else float("inf")
        self._instead = bool(others) and not now.mono - self._back >= RECOVERED
        if self._instead:
            self.guides = others
        else:
            self.guides = usable or self._leading(self._returning(now), usable)

    def _usable(self, names: tuple[str, ...], now: Now) -> tuple[str, ...]:
        known = [(name, self.each[name]) for name in names]
        return tuple(name for name, one in known if not one.aside and not one.beyond and one.fresh(now))

    def _returning(self, now: Now) -> tuple[str, ...]:
        """Neighbours that are aside, and on their way back."""
        known = [(name, self.each[name]) for name in self._neighbours]
        return tuple(
            name for name, one in known if one.aside and not one.beyond and one.fresh(now) and one.going(now)
        )

    def _leading(self, names: tuple[str, ...], usable: tuple[str, ...]) -> tuple[str, ...]:
        """Those who follow the leader by a way of their own, when only these neighbours can be followed."""
        lost = set(self._neighbours).difference(usable)
        return tuple(name for name in names if leads(self._mission, name, self._robot, lost - {name}))

    def aside(self, now: Now) -> tuple[str, ...]:
        """Who is heard, and is no guide."""
        return tuple(name for name, one in self.each.items() if name not in self.guides and one.fresh(now))

    @property
    def beyond(self) -> tuple[str, ...]:
        """Neighbours that say they are outside the mission's bounds."""
        return tuple(name for name, one in self.each.items() if one.beyond)

    def leaderless(self, now: Now) -> bool:
        """Whether the leader is a neighbour, and silent."""
        leader = self._mission.leader
        return leader in self._neighbours and not self.each[leader].fresh(now)

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

    def measured(self, here: Localisation, slots: Slots, now: Now) -> Measured:
        """The law's input: sums over those whom it follows, of which there must be at least one."""
        me, heading, my_age = here.point, here.heading, here.stream.age(now)
        mine, my_velocity = slots.at[self._robot], slots.velocity[self._robot]
        relative, desired, velocity = 0j, 0j, 0j
        for name in self.guides:
            one = self.each[name]
            if self._as_measured:
                relative += one.displacement
            else:
                relative += heading.conjugate() * (one.point(now, my_age, carry=self._carry) - me)
            desired += slots.at[name] - mine
            # z*_ij moves as well: I am to move as the neighbour does, but for that
            velocity += one.velocity - (slots.velocity[name] - my_velocity)
        mean_velocity = velocity / len(self.guides) if self._feed_forward else 0j
        return Measured(relative, desired, len(self.guides), mean_velocity)


def other_missions(each: Iterable[Neighbour], now: Now) -> dict[str, str]:
    """Those that run another mission, with its tag."""
    found = {one.name: one.other_mission(now) for one in each}
    return {name: tag for name, tag in found.items() if tag is not None}
