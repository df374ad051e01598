"""The robot's position and heading, from odometry or external poses, without measuring the heading."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from formation.agent.pose.map_frame import MapFrame, MapFrameState, Placement
from formation.agent.pose.mirror import MirrorCheck, MirrorState
from formation.agent.pose.sources import (
    ExternalPoseSource,
    ExternalPoseState,
    OdometrySource,
    OdometryState,
    PoseUpdate,
)
from formation.agent.pose.stream import Stream, StreamState
from formation.control.avoidance import HEADING_GAIN_RATIO, MAX_HEADING_ERROR, course_gain, heading_doubt
from formation.control.controller import Controller
from formation.control.observer import Travel, innovation
from formation.control.plane import angle_between, rotation, shorten, unit
from formation.control.pose_filter import (
    COMMANDED_NOISE,
    ODOMETRY_NOISE,
    Spread,
    filtered,
    first_spread,
    least_noise,
    path_error,
    replaced,
    restarted,
)
from formation.control.tracker import MAX_DELAY
from formation.control.unicycle import Command, control_point
from formation.mission.model import Mission
from formation.protocol.lateness import Trust, trusted
from formation.protocol.order import Order
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import Localised
from formation.ros2.messages import WORLD_FRAME, MapPose, Odometry, Pose, Transforms, decode
from formation.ros2.ros import MAX_POSITION
from formation.topics import AMCL_POSE, TF
from formation.wire import BadMessage, Handler, Now, Sample

START_HEADING_TIME = 1.0
"""Time under way after which a fleet no longer faces as its mission's start says [s]."""
LEARNED_ESTIMATE_LENGTH = 0.5
"""Length of the estimate from which it counts as learned, and may contradict a measured heading."""
LEARNED_HEADING_VARIANCE = 0.02
"""Variance of the pose filter's heading below which it counts as learned: a deviation of 0.1 rad [–]."""
MAX_MOUNTING_ERROR = 0.25 * math.pi
"""Angle between a measured and a learned heading from which they contradict each other [rad]."""
MAX_MISMOUNTED_PATH = 0.2
"""Path after which that holds the robot [m]: in a tight curve a marker off the centre moves sideways."""
MAX_ESTIMATE_LENGTH = 1e100
"""Limit of an observer's estimate: the printed one's grows without bound while a robot reverses."""


@dataclass(slots=True, kw_only=True)
class LocalisationState:
    """What a localisation has learned."""

    stream: StreamState
    source: OdometryState | ExternalPoseState
    map_frame: MapFrameState | None
    mirror: MirrorState | None
    jumped: Reason | None = None
    """The newest jump, as long as it counts; else None."""
    jumps: int = 0
    """Number of jumps."""
    follows: bool = False
    """Whether the newest message closed an interval: otherwise the heading is not updated."""
    trust: Trust = field(default_factory=Trust)
    """Whether the newest message is young enough to act on."""
    age_limit: float = MAX_DELAY
    """Greatest age of a message on arrival [s]."""
    late: int = 0
    """Messages that came more than half a period late."""
    position: complex = 0j
    """Centre, filtered where the law has its pose filtered [m; world frame]."""
    spread: Spread
    """Covariance of that and of `estimate`."""
    travel: Travel | None = None
    """Newest interval; None if the robot's motion in it is unknown."""
    since_last: Travel | None = None
    """Motion since the message before, also across a gap; None for the first, and at a jump."""
    measured: complex = 1.0 + 0.0j
    """Heading as the source measures it, unit [world frame]."""
    estimate: complex
    """The observer's heading, of any length [world frame]."""
    course: complex
    """The same for the collision filter."""
    mismounted: float = 0.0
    """Path along which the learned heading has contradicted the measured one [m]."""
    placed: bool = False
    """Whether a localiser has placed odometry."""
    travelled: float = 0.0
    """Path length since the filter's heading was unknown [m]."""
    joined: bool = False
    """Whether the first order has been received."""
    before: tuple[float, complex, complex] | None = None
    """Stamp [s], control point [m; world frame] and heading before the newest message."""
    calm: float = 0.0
    """Time since the newest jump [s]."""
    judged: float = float("-inf")
    """Arrival of the newest message that was checked for age [s, monotonic]."""


class Localisation:
    """Position by odometry or external poses; heading by the observer of Eq. (3), or as measured.

    The observer uses only the change of the odometry's heading.
    """

    def __init__(self, mission: Mission, robot: str, controller: Controller) -> None:
        spec = mission.robots[robot]
        self._robot = robot
        self.stream = Stream(spec.rate)
        self._source: OdometrySource | ExternalPoseSource = (
            OdometrySource(mission, robot)
            if spec.localisation == "odometry"
            else ExternalPoseSource(mission, robot)
        )
        self.map_frame = MapFrame() if spec.odometry_frame == "map" else None
        """Places odometry by a localiser; None without one."""
        self._mirror = (
            MirrorCheck() if spec.localisation == "external" and spec.heading == "observer" else None
        )
        self._observer = controller.observer
        self._filters = controller.collision_filter
        self._filters_pose = controller.pose_filter
        self._motion_noise = ODOMETRY_NOISE if spec.localisation == "odometry" else COMMANDED_NOISE
        self._least_noise = least_noise(mission.collisions.noise)
        self._measures_heading = spec.heading == "measured"
        self._gain = mission.law.observer_gain
        self._limits = spec.limits
        self._period = 1.0 / spec.rate
        # beside a measured heading the observer only checks, and starts without an estimate
        guesses = self._observer.start is None
        self._watches = self._measures_heading and guesses
        estimate = 0j if self._watches else mission.first_heading(robot)
        # odometry that counts from the mission's start pose gives the turn since then
        counted = spec.localisation == "odometry" and spec.odometry_frame == "start"
        self._guessed = counted and spec.first_heading_deg is None and not self._measures_heading
        # after that time its robot may face in a direction that the mission does not know
        self._guesses = spec.first_heading_deg is None and not self._measures_heading and guesses
        # the filter's own: external poses are too noisy for a higher gain
        self._sharp_gain = self._gain * (HEADING_GAIN_RATIO if spec.localisation == "odometry" else 1.0)
        self._noise = mission.collisions.noise
        self.state = LocalisationState(
            stream=self.stream.state,
            source=self._source.state,
            map_frame=None if self.map_frame is None else self.map_frame.state,
            mirror=None if self._mirror is None else self._mirror.state,
            estimate=estimate,
            course=estimate,
            spread=first_spread(self._least_noise),
        )

    @property
    def source(self) -> str:
        """Source of positions: ``odometry`` or ``pose``."""
        return self._source.name

    @property
    def alignment(self) -> Localised:
        """How the source is placed in the world."""
        return self._source.alignment

    @property
    def doubt(self) -> Reason | None:
        """Why the newest message is doubtful though it follows from the one before."""
        state = self.state
        if max(abs(state.position.real), abs(state.position.imag)) > MAX_POSITION:
            return Reason.of(Code.POSITION_TOO_FAR, source=self.source, limit=MAX_POSITION)
        if self.map_frame is not None and (lost := self.map_frame.doubt) is not None:
            return lost
        if self._mirror is not None and (mirrored := self._mirror.doubt) is not None:
            return mirrored
        return self._contradicted

    @property
    def _contradicted(self) -> Reason | None:
        """Why the measured heading contradicts the robot's motion; None if it does not."""
        if not self._watches or abs(self.state.estimate) <= LEARNED_ESTIMATE_LENGTH:
            return None
        # from 90 degrees on the law drives a robot away from its slot
        lasting = self.state.mismounted > MAX_MISMOUNTED_PATH
        limit = MAX_MOUNTING_ERROR if lasting else 0.5 * math.pi
        angle = abs(float(angle_between(self.state.estimate, self.state.measured)))
        if angle <= limit:
            return None
        return Reason.of(Code.HEADING_CONTRADICTED, source=self.source, angle=angle, limit=limit)

    def _compare_headings(self, path: float) -> None:
        """Count the `path` of the newest interval [m] if the two headings contradict each other in it."""
        if not self._watches:
            return
        state = self.state
        angle = abs(float(angle_between(state.estimate, state.measured)))
        off = angle > MAX_MOUNTING_ERROR and state.spread.heading < LEARNED_HEADING_VARIANCE
        state.mismounted = state.mismounted + path if off else 0.0

    @property
    def correction(self) -> float:
        """Distance of the robot's position from where odometry would be without `align` [m]."""
        return self._source.correction if isinstance(self._source, OdometrySource) else 0.0

    def judge_age(self) -> None:
        """Decide whether the newest message is young enough; call this when all have been read."""
        if self.stream.state.received > self.state.judged:
            self.state.judged = self.stream.state.received
            self.state.trust = trusted(
                self.state.trust, self.stream.age_on_arrival, self.state.age_limit, self.state.judged
            )

    @property
    def heading(self) -> complex:
        """Heading ζ̂ for the law, of unit length [world frame]."""
        return self.state.measured if self._measures_heading else unit(self.state.estimate)

    @property
    def point(self) -> complex:
        """Estimated control point [m; world frame]."""
        return control_point(self.state.position, self.heading, self._limits.offset)

    @property
    def course(self) -> complex:
        """Heading for the collision filter, of unit length [world frame]."""
        return self.state.measured if self._measures_heading else unit(self.state.course)

    @property
    def course_doubt(self) -> float:
        """Possible error of `course` [rad]."""
        state = self.state
        if self._measures_heading:
            return MAX_HEADING_ERROR
        by_distance, lacks = (
            heading_doubt(state.travelled, self._sharp_gain, self._noise),
            1.0 - abs(state.course),
        )
        # its path explains so much; with external poses, wheels may stand though they were commanded
        if math.sin(min(by_distance - MAX_HEADING_ERROR, 0.5 * math.pi)) >= lacks:
            return by_distance
        return MAX_HEADING_ERROR + math.asin(lacks) if lacks < LEARNED_ESTIMATE_LENGTH else math.pi

    def seen_from(self, stamp: float) -> tuple[complex, complex]:
        """Control point [m; world frame] and heading at `stamp` [s], the time of a measurement on board."""
        before = self.state.before
        if before is not None and abs(stamp - before[0]) < abs(stamp - self.stream.state.stamp):
            return before[1], before[2]
        return self.point, self.heading

    def doubt_all(self) -> None:
        """Distrust everything received so far: this process was frozen."""
        self.stream.doubt()
        self.state.follows, self.state.travel, self.state.since_last = False, None, None

    def carried(self) -> None:
        """Reset both filters' heading: the robot was moved by hand."""
        self.state.course, self.state.travelled = self.heading, 0.0
        self.state.spread = first_spread(self._least_noise)

    def joins(self, order: Order) -> None:
        """Correct the guessed heading once order and robot are known: the mission's may be old.

        A robot that joins a moving fleet guesses that it faces as its odometry in the world frame says; with
        external poses, that it faces in the leader's direction.
        """
        if self.state.joined:
            return
        self.state.joined = True
        if order.time < START_HEADING_TIME or not self._guesses or self._guessed:
            return
        if isinstance(self._source, OdometrySource):
            self.state.estimate = self.state.measured
        elif order.place is not None:
            self.state.estimate = rotation(order.place.heading)

    def align(self, position: complex, heading: complex, elapsed: float | None = None) -> None:
        """Move the odometry's placement towards a better pose [m; unit] of its newest message, slowly.

        `elapsed` [s] since the last call, by default a period. It takes effect with the next message.
        """
        if isinstance(self._source, OdometrySource):
            elapsed = self._period if elapsed is None else elapsed
            step, turn = self._source.align(position, heading, elapsed)
            self.state.position += step
            if self._observer.start is None:  # else the estimate is not only a heading
                self.state.estimate *= turn
            self.state.course *= turn

    @property
    def handlers(self) -> dict[str, Handler]:
        """Handlers of a localiser's messages, by key."""
        if self.map_frame is None:
            return {}
        return {AMCL_POSE.key(self._robot): self._take_map_pose, TF.key(self._robot): self._take_transforms}

    def _take_map_pose(self, sample: Sample, _now: Now) -> None:
        """Place odometry by a localiser's pose. Raises BadMessage."""
        frame, last = self.map_frame, self._source.state.last
        if frame is None:
            return
        try:
            pose = decode(MapPose, sample.payload)
            named = pose.frame.removeprefix("/")
            if isinstance(last, Odometry) and named == last.frame.removeprefix("/") != WORLD_FRAME:
                raise BadMessage(f"pose in the frame of odometry, {named}: must be in the map's")
            jump = frame.take_pose(pose)
        except BadMessage as bad:
            frame.refuse(bad)
            raise
        self._relocalised(jump)

    def _take_transforms(self, sample: Sample, _now: Now) -> None:
        """Place odometry by a localiser's transform from the map, if there is one among these."""
        frame, last = self.map_frame, self._source.state.last
        if frame is None or not isinstance(last, Odometry):
            return
        try:
            jump = frame.take_transforms(decode(Transforms, sample.payload), WORLD_FRAME, last.frame)
        except BadMessage as bad:
            frame.refuse(bad)
            raise
        self._relocalised(jump)

    def trust(self) -> None:
        """Believe localiser (`MapFrame.trust`), heading and path again: an order holds the robot."""
        if self._contradicted is not None:
            self.state.estimate, self.state.mismounted = 0j, 0.0
        if self._mirror is not None:
            self._mirror.trust()
        if self.map_frame is not None:
            self._relocalised(self.map_frame.trust())

    def _relocalised(self, jump: Reason | None) -> None:
        """Take over a placement: slowly, or at once if it is the first or a jump."""
        state, source, frame = self.state, self._source, self.map_frame
        if frame is None or not isinstance(source, OdometrySource) or frame.state.placement is None:
            return
        if jump is None and state.placed:
            return
        placement, last = frame.state.placement, source.state.last
        turn = source.place(*placement)
        state.estimate = state.estimate * turn if state.placed else placement.rotation
        if last is not None:  # this step acts on it, also if it has read its odometry already
            state.estimate *= 1.0 if state.placed else last.heading
            state.position, state.measured = placement.of(last.position), placement.rotation * last.heading
            state.before, state.spread = None, replaced(state.spread)
        state.placed, state.course, state.travelled = True, state.estimate, 0.0
        if jump is not None:
            state.jumped, state.calm = jump, 0.0
            state.jumps += 1

    def _follow_map(self, over: float | None) -> None:
        """Move towards the newest placement, if there is a localiser, `over` [s] after the last message."""
        frame, source = self.map_frame, self._source
        if frame is None or frame.state.placement is None or not isinstance(source, OdometrySource):
            return
        placement, last = frame.state.placement, source.state.last
        if last is not None:
            elapsed = None if over is None else min(over, self.stream.limit)
            self.align(placement.of(last.position), placement.rotation * last.heading, elapsed)

    def _map_passed(self, message: Odometry | Pose, seen: PoseUpdate, over: float | None) -> None:
        """Record odometry, with which the localiser's poses of earlier moments are compared.

        `over` [s] after the message before; more than the limit are a gap.
        """
        source = self._source
        if (
            self.map_frame is None
            or not isinstance(message, Odometry)
            or isinstance(source, ExternalPoseSource)
        ):
            return
        placed = Placement(source.state.rotation, source.state.origin)
        gap = over is not None and over > self.stream.limit
        self.map_frame.moved(message, None if seen.jumped is None else placed, gap=gap)
        self.state.placed = self.state.placed and self.map_frame.state.placement is not None

    def goes_on(self, message: Odometry | Pose, arrived: float, since: float) -> str | None:
        """Prepare state of another process, known until `since` [s, monotonic], for the next `message`.

        Return why that is not possible, in words, or None.
        """
        over = arrived - (since if self.stream.state.arrived is None else self.stream.state.arrived)
        if isinstance(self._source, OdometrySource) and isinstance(message, Odometry):
            return self._source.unlike(message, over)
        if isinstance(self._source, ExternalPoseSource) and isinstance(message, Pose):
            self._source.stood(since)
            return self._source.unlike(message, over)
        return f"it was localised by {self._source.name}"

    def commanded(self, moment: float, command: Command) -> None:
        """Record that the robot was sent `command` at `moment` [s, monotonic]."""
        if isinstance(self._source, ExternalPoseSource):
            self._source.commanded(moment, command)

    def update_pose(self, message: Odometry | Pose, arrived: float, now: Now) -> float | None:
        """Process a message; return the interval it closes [s], None if it opens one. Raises BadMessage."""
        state = self.state
        before, stamped = self.stream.state.arrived, self.stream.state.stamp
        elapsed = self.stream.admit(message.stamp, arrived, now)
        state.before = None if before is None else (stamped, self.point, self.heading)
        over = elapsed if elapsed is not None or before is None else arrived - before
        self._follow_map(over)
        speed_before = self._odometry_speed
        seen = self._update_of(message, over, now)
        self._map_passed(message, seen, over)
        believed, state.position = state.position, seen.position
        state.measured, state.follows, state.travel = seen.heading, False, None
        state.since_last = seen.travel if seen.jumped is None else None
        self._compare_turns(state.since_last, elapsed)
        if seen.travel is None:
            if self._observer.start is not None:
                state.estimate = self._observer.start(seen.position, self._gain)
            elif self._guessed and before is None:
                state.estimate = state.course = seen.heading
            state.spread = replaced(state.spread)
            return None
        if seen.jumped is not None:
            state.jumped, state.calm = seen.jumped, 0.0
            state.jumps += 1
            state.estimate *= 0.0 if self._watches else seen.turned
            state.course, state.travelled = self.heading, 0.0
            state.spread = first_spread(self._least_noise)
            return None
        if elapsed is None or elapsed > self.stream.limit:
            # so long a path gives no correction, but the robot turned meanwhile
            if self._observer.start is None:  # else the estimate is not only a heading
                state.estimate *= rotation(seen.travel.turn)
            if self._filters:
                state.course *= rotation(seen.travel.turn)
            state.spread = replaced(state.spread)
            return None
        state.late += elapsed > 1.5 * self._period
        state.follows, state.travel = True, seen.travel
        self._forget_jump(elapsed)
        if self._filters_pose:
            state.position, state.estimate, state.spread = filtered(
                believed, state.estimate, state.spread, seen.travel, seen.position, elapsed,
                self._least_noise, self._motion_noise,
                path_error(speed_before, self._odometry_speed, elapsed),
            )  # fmt: skip
            self._note_restart(abs(seen.position - believed))
            self._compare_headings(abs(seen.travel.distance))
        else:
            state.estimate = shorten(
                self._observer.step(state.estimate, seen.travel, self._gain), MAX_ESTIMATE_LENGTH
            )
        if self._filters:
            gain = course_gain(state.travelled, self._sharp_gain, self._noise)
            state.course = innovation(state.course, seen.travel, gain)
            state.travelled += abs(seen.travel.distance)
        return elapsed

    def _compare_turns(self, travel: Travel | None, elapsed: float | None) -> None:
        """Compare the path of external poses with the commands, unless the interval is unknown or a gap."""
        if self._mirror is None:
            return
        if travel is None or elapsed is None or elapsed > self.stream.limit:
            self._mirror.interrupt()
        else:
            self._mirror.add(travel)

    def _note_restart(self, distance: float) -> None:
        """Count it as a jump if the filter began anew after a `distance` [m] that commands do not explain.

        Only external poses: odometry's own speeds are checked against its positions.
        """
        state = self.state
        if isinstance(self._source, ExternalPoseSource) and restarted(state.spread):
            state.jumped, state.calm = (
                Reason.of(Code.POSITION_JUMPED, source=self.source, distance=distance),
                0.0,
            )
            state.jumps += 1

    def speed(self, dt: float) -> float:
        """Mean forward speed over the newest interval, of `dt` [s] [m/s]; 0 if it is unknown.

        External poses show a motion that commands do not.
        """
        travel = self.state.travel
        if travel is None or dt <= 0.0:
            return 0.0
        return math.copysign(max(abs(travel.distance), abs(travel.displacement)), travel.distance) / dt

    @property
    def _odometry_speed(self) -> float:
        """Forward speed by the newest odometry [m/s]; 0 before the first, and with external poses."""
        last = self._source.state.last
        return last.speed if isinstance(last, Odometry) else 0.0

    def _update_of(self, message: Odometry | Pose, over: float | None, now: Now) -> PoseUpdate:
        if isinstance(self._source, OdometrySource) and isinstance(message, Odometry):
            return self._source.make_update(message, over, self.stream.limit)
        if isinstance(self._source, ExternalPoseSource) and isinstance(message, Pose):
            return self._source.make_update(message, over, now.mono - self.stream.age(now))
        raise TypeError(f"a robot localised by {self._source.name} takes no {type(message).__name__}")

    def _forget_jump(self, elapsed: float) -> None:
        self.state.calm += elapsed
        if self.state.calm > self.stream.limit:
            self.state.jumped = None
