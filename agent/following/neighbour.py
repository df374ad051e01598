"""What an agent knows of one neighbour: position, velocity, freshness."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from formation.agent.following.publisher import AcceptedPublisher, AcceptedPublisherState
from formation.agent.following.relative_check import RECENT_TIME, OwnMotion, RelativeCheck, RelativeCheckState
from formation.agent.pose.estimator import Localisation
from formation.agent.pose.stream import Stream, StreamState
from formation.agent.safety.failsafe import Unanswered
from formation.control import tracker as neighbour
from formation.control.unicycle import control_point
from formation.mission.model import Mission
from formation.protocol.attachment import check_mission
from formation.protocol.lateness import Trust, trusted
from formation.protocol.reasons import Code, Reason
from formation.ros2.messages import Displacement, Pose, decode
from formation.wire import Now, Sample

OTHER_MISSION_TIME = 1.0
"""Time after a neighbour's newest position with another mission for which it counts as running that [s]."""
STANDSTILL_TIME = 1.0
"""Time without motion after which a robot counts as standing [s]."""
MAX_STANDSTILL_MOTION = 0.03
"""Apparent motion of a robot that stands, at most [m]."""


class Whereabouts(NamedTuple):
    """Where another robot is, as far as is known."""

    at: complex
    """Position extrapolated with its velocity [m; world frame]."""
    last: complex
    """Newest measured position [m; world frame]."""
    velocity: complex
    """[m/s; world frame]"""
    age: float
    """Age of the oldest data used, of either robot [s]."""
    unsure: float = 0.0
    """For a silent robot: radius of the disc in which it stands [m]."""


def answers(mission: Mission, name: str, robot: str) -> bool:
    """Whether `name` receives the positions of `robot` over the network, and uses them."""
    spec = mission.robots[name]
    if robot in spec.measurable:
        return spec.measurement != "local"
    return robot in mission.avoided_by(name)


@dataclass(slots=True, kw_only=True)
class NeighbourState:
    """What is known of one neighbour."""

    stream: StreamState
    publisher: AcceptedPublisherState
    displacement: complex = 0j
    """Newest measured z_ij^(i) [m; body frame]; only where a sensor measures it."""
    unavailable: bool = False
    """Whether it reports that it is unavailable."""
    searching: bool = False
    """Whether it reports that it must see its neighbours and does not yet."""
    beyond: bool = False
    """Whether it reports that it is outside the mission's bounds."""
    other: tuple[str, float] = "", float("-inf")
    """Tag of the other mission that it runs, and when that was received [s, monotonic]."""
    answered: bool = False
    """Whether it has answered since the stream started afresh."""
    track: neighbour.Track | None = None
    """Its control point."""
    body: neighbour.Track | None = None
    """Its centre; only if positions come over the network."""
    unplaced: tuple[float | None] | None = None
    """Time since the displacement before the newest [s], until the newest is placed in the world."""
    anchor: complex = 0j
    """Where it was when it last moved [m; world frame]."""
    moved: float = float("-inf")
    """When it last moved [s, monotonic]."""
    trust: Trust = field(default_factory=Trust)
    """Whether its newest displacement is young enough to act on."""
    judged: float = float("-inf")
    """Arrival of the newest displacement that was checked [s, monotonic]."""
    check: RelativeCheckState | None = None
    """Only where a sensor measures it."""
    reported: complex | None = None
    """Where it says that it is [m; its world frame]; only where a sensor measures it."""
    reported_at: float = float("-inf")
    """When that was received, if it was recent by its stamp [s, monotonic]."""


class Neighbour:
    """One neighbour, known by its positions over the network or by displacements that a sensor measures."""

    def __init__(
        self,
        mission: Mission,
        name: str,
        rate: float,
        *,
        answers: bool = False,
        check: RelativeCheck | None = None,
    ) -> None:
        """`rate` [Hz] is how often data of it arrive.

        `answers`: it receives this robot's positions, and names them in its own. `check`: where a sensor
        measures it.
        """
        spec = mission.robots[name]
        self.name = name
        self.stream = Stream(rate)
        self.publisher = AcceptedPublisher(name, spec.rate)
        self.check = check
        """Checks its displacements; None where it is known by messages."""
        self.state = NeighbourState(
            stream=self.stream.state,
            publisher=self.publisher.state,
            check=None if check is None else check.state,
        )
        self.answers = answers
        """Whether it names positions of this robot in its own."""
        # The virtual leader has no body: its position is its control point.
        self._tag = mission.tag
        self._offset = 0.0 if name == mission.leader else spec.control_point_offset
        self.top_speed = spec.top_speed
        """Of its control point [m/s]."""
        self._filter = mission.law.velocity_filter
        self._reported_limit = neighbour.FRESH_PERIODS / spec.rate

    def take_position(self, pose: Pose, arrived: float, now: Now, *, answered: bool = False) -> None:
        """Update from its published pose. Raises BadMessage.

        `answered`: the message names a position that this robot sent shortly before.
        """
        state = self.state
        before = self.stream.state.arrived
        elapsed = self.stream.admit(pose.stamp, arrived, now)
        # what follows an answer is at most `longest_delay` later than that, or is refused
        goes_on = before is not None and arrived - before <= max(
            neighbour.FORGETTING_SILENCE, self.stream.limit
        )
        state.answered = answered or (state.answered and goes_on)
        stamp = self.stream.state.stamp
        state.body = self._followed(state.body, stamp, pose.position, elapsed)
        self._see(control_point(pose.position, pose.heading, self._offset), elapsed)

    def take_displacement(self, sample: Sample, now: Now) -> None:
        """Update from a displacement measured by this robot. Raises BadMessage."""
        measured, state = decode(Displacement, sample.payload), self.state
        elapsed = self.stream.admit(measured.stamp, sample.arrived, now)
        state.displacement = measured.displacement
        if state.unplaced is not None and elapsed is not None:  # the one before was never placed
            (before,) = state.unplaced
            elapsed = None if before is None else before + elapsed
        state.unplaced = (elapsed,)

    def take_report(self, pose: Pose, arrived: float, now: Now) -> None:
        """Store where it says that it is, beside a sensor; messages that may be old say nothing."""
        if abs(now.wall - (now.mono - arrived) - pose.stamp) <= RECENT_TIME:
            self.state.reported = control_point(pose.position, pose.heading, self._offset)
            self.state.reported_at = arrived

    def judge(self, own: OwnMotion, age_limit: float, now: Now) -> None:
        """Judge the newest displacement, once; one over `age_limit` [s] old on arrival is not acted on.

        Such ones are not compared with own motion: their delay may change.
        """
        state, stream = self.state, self.stream.state
        if self.check is None or stream.received <= state.judged:
            return
        afresh = state.trust.held or stream.received - state.judged > self.stream.limit
        state.judged = stream.received
        state.trust = trusted(state.trust, self.stream.age_on_arrival, age_limit, state.judged)
        if stream.arrived == stream.received and not state.trust.held:
            age = now.mono - state.reported_at
            reported = state.reported if age <= self._reported_limit else None
            self.check.saw(state.displacement, own, reported, report_age=age, anew=afresh)

    def doubt(self, age_limit: float, now: Now) -> Reason | None:
        """Why its newest displacement is not acted on; None also if there is none."""
        if self.check is None or now.mono - self.stream.state.received > self.stream.limit:
            return None
        if not self.state.trust.held:
            doubt = self.check.state.doubt
            return None if doubt is None else doubt.why
        age = self.stream.age_on_arrival
        code = Code.RELATIVE_WAS_LATE if age <= age_limit else Code.RELATIVE_LATE
        return Reason.of(code, robot=self.name, age=age, limit=age_limit)

    def place(self, here: Localisation) -> None:
        """Convert a new displacement to the world frame, from this robot's pose at that time.

        This waits for the odometry of the same moment, which may arrive later: with the pose before, a robot
        at full speed would be a whole period off.
        """
        if self.state.unplaced is not None:
            (elapsed,), self.state.unplaced = self.state.unplaced, None
            me, heading = here.seen_from(self.stream.state.stamp)
            self._see(me + heading * self.state.displacement, elapsed)

    def _see(self, point: complex, elapsed: float | None) -> None:
        state = self.state
        stamp = self.stream.state.stamp
        if self.stream.state.arrived is not None and abs(point - state.anchor) > MAX_STANDSTILL_MOTION:
            state.anchor, state.moved = point, self.stream.state.arrived
        state.track = self._followed(state.track, stamp, point, elapsed)

    def _followed(
        self, track: neighbour.Track | None, stamp: float, point: complex, elapsed: float | None
    ) -> neighbour.Track:
        if elapsed is None or track is None:
            return neighbour.first_seen(stamp, point)
        before = neighbour.Track(stamp - elapsed, track.point, track.velocity)
        return neighbour.seen(before, stamp, point, self._filter, self.top_speed)

    def check_mission(self, tag: str, arrived: float) -> None:
        """Raise BadMessage, and record it, if it runs another mission than this robot."""
        if tag != self._tag:
            self.state.other = tag, arrived
        check_mission(self.name, tag, self._tag)

    def other_mission(self, now: Now) -> str | None:
        """Tag of the other mission that it runs; None if it runs this one, or is silent."""
        tag, received = self.state.other
        return tag if now.mono - received <= OTHER_MISSION_TIME else None

    def fresh(self, now: Now) -> bool:
        """Whether its data are fresh."""
        return self.stream.fresh(now)

    def unanswered(self, now: Now) -> Unanswered | None:
        """Lateness of its newest message by its stamp, unless that or an answer shows it to be recent.

        None also if it is silent.
        """
        late, limit = self.stream.state.delay, self.stream.longest_delay
        doubted = self.answers and not self.state.answered and abs(late) > limit
        return Unanswered(late, limit) if doubted and self.stream.fresh(now) else None

    def going(self, now: Now) -> bool:
        """Whether it has moved recently."""
        return now.mono - self.state.moved < STANDSTILL_TIME

    @property
    def velocity(self) -> complex:
        """Estimated velocity of its control point [m/s; world frame]."""
        return self.state.track.velocity if self.state.track else 0j

    def point(self, now: Now, my_age: float, *, carry: bool) -> complex:
        """Its control point when this robot's measurement, `my_age` [s] old, was made [m; world frame]."""
        if self.state.track is None:
            raise ValueError(f"{self.name} has not been seen yet")
        return self._carried(self.state.track, now, my_age) if carry else self.state.track.point

    def around(self, now: Now, my_age: float, *, body: bool) -> Whereabouts:
        """Where its centre, or else its control point, was at that moment."""
        track = self.state.body if body else self.state.track
        if track is None:
            raise ValueError(f"{self.name} has not been seen yet")
        carried, age = self._carried(track, now, my_age), self.stream.age(now)
        if self.fresh(now):
            return Whereabouts(carried, track.point, track.velocity, max(age, my_age))
        unsure = neighbour.uncertain(age, self.top_speed)
        middle, radius = neighbour.somewhere(track.point, carried, unsure)
        return Whereabouts(middle, middle, 0j, 0.0, radius)

    def _carried(self, track: neighbour.Track, now: Now, my_age: float) -> complex:
        older = self.stream.age(now) - my_age
        # the oldest sample that counts had the longest believable delay, and then waited `limit` here
        longest = self.stream.longest_delay + self.stream.limit
        return neighbour.carried_to(track, track.stamp + older, longest)
