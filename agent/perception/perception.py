"""A robot's pose by what its range scanner sees of its neighbours; whether that can be relied on.

Used by robots with `measurement = "scan"`. Neighbours publish their positions as ever; a scan shows where
the robot itself is among them, and corrects the drift of its odometry. Only neighbours nearer to the leader
are used (of two that are equally near, the one that the mission lists first), as an error would otherwise
come back to the robot that made it.

The robot is *locked* once its neighbours have been where they say in `LOCK_SCANS` scans, and nowhere else.
It stands until then. While it sees no neighbour it goes on by odometry, for `MAX_RECKONING_TIME` or until
the error may be `MAX_RECKONING_ERROR`; others do not use it meanwhile. If for `MAX_REFUSED_TIME` neighbours
are not where they say, it is no longer locked; also if, in `MAX_DISAGREED_SCANS` scans or for
`MAX_DISAGREED_TIME`, as many are not where they say as are, or if scans move the pose by `MAX_CORRECTION` on
`CORRECTED_DISTANCE` of path. After `MAX_LOST_LOCKS` within `LOST_LOCKS_DISTANCE` it stands until an operator
has looked.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from formation.agent.following.neighbour import Neighbour
from formation.agent.perception import pose_filter
from formation.agent.perception.association import Candidate, Outcome, associate
from formation.agent.perception.pose_filter import PATH_DEVIATION, Estimate, Measurement
from formation.agent.pose.estimator import Localisation
from formation.agent.safety.scanner import Scanner
from formation.control.plane import angle_between, rotation, unit
from formation.control.tracker import MAX_DELAY, believed_delay, carried_to
from formation.mission.model import Mission
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import Sight
from formation.ros2.messages import LaserScan
from formation.sensing.detection import Beams, Detection, beams
from formation.wire import Now

LIMITED = (Code.SCAN_BLIND, Code.SCAN_SHORT, Code.SCAN_SECTOR)
"""Doubts about a scan that shows what it shows, and not enough to drive by it alone."""
START_DEVIATION, START_HEADING_DEVIATION = 0.1, math.radians(2.0)
"""Standard deviation of a start pose, per axis [m; rad]: of a robot that was placed by eye. A robot with one
neighbour in sight learns its heading only while it drives; more doubt would let noise turn it."""
DOUBTED_DEVIATION, DOUBTED_HEADING_DEVIATION = 0.1, math.radians(5.0)
"""Standard deviation of a pose at which no neighbour is where it says, per axis [m; rad]."""
PLACE_DEVIATION = 0.005
"""Standard deviation of a neighbour's published place [m]."""
LOCK_SCANS = 5
"""Scans that must show neighbours where they say, without one that does not."""
LONE_WEIGHT = 0.1
"""Weight of a scan that shows one of several neighbours: it does not tell the heading."""
MAX_REFUSED_TIME = 2.0
"""Time for which neighbours may not be where they say [s]."""
MAX_DISAGREED_SCANS = 25
"""Scans in a row in which as many neighbours are not where they say as are, from which on the robot is no
longer locked: another robot or a post may stand where the seen one should be."""
MAX_DISAGREED_TIME = 5.0
"""The same for a slower scanner [s], though in `LOCK_SCANS` scans at least."""
MIN_MISSED_BEAMS = 12.0
"""Beams in a row that did not come back from a neighbour's place, from which on it is not there: of 10 % lost
beams that are too many."""
MIN_RECKONING_TIME = 2.0
"""Time without a seen neighbour after which the status says so [s]."""
MAX_RECKONING_TIME = 30.0
"""Longest time for which a robot goes on without a seen neighbour [s]."""
MAX_RECKONING_ERROR = 0.03
"""Greatest standard deviation of the error that arises meanwhile [m]."""
STEADY_HEADING_DEVIATION = 0.003
"""Standard deviation of the heading of a robot that sees its neighbours while it drives [rad]."""
MAX_MISPLACEMENT = 0.02
"""Difference of the pose from the estimate from which on it does not lock, and is no landmark [m]."""
LANDMARK_DISTANCE = 1.0
"""Distance at which a difference of headings counts for that [m]."""
MAX_LOCKED_MISPLACEMENT = 0.1
"""The same from which on a robot is no longer locked [m]."""
MAX_LOST_LOCKS, LOST_LOCKS_DISTANCE = 3, 5.0
"""Number of locks that scans contradicted within so much travel [m], after which the robot stands until an
operator has looked: odometry's heading may be wrong for good."""
CORRECTED_DISTANCE, MAX_CORRECTION = 1.0, 0.2
"""Path [m] on which scans may move the pose of a locked robot by so much [m]. They move it further if the
scanner is mounted otherwise than the mission says, if the scans are another robot's, or if they show
something else for a neighbour."""
CORRECTION_STEP = 0.01
"""Path within which corrections are added up to one [m]."""
REFUSED_DEVIATION, REFUSED_HEADING_DEVIATION = 0.01, math.radians(0.3)
"""By so much a scan that shows no neighbour where it says widens the estimate, per axis [m; rad]."""
MAX_WAIT = MAX_DELAY
"""Longest time for which a scan waits for the odometry of its time, while newer ones are left out [s]."""
TRAIL_TIME = 3.0
"""Time for which the own motion is kept, longer than the age of any scan that is used [s]."""


class Waypoint(NamedTuple):
    """Where odometry was."""

    moment: float
    """[s, monotonic]"""
    position: complex
    """[m; frame that begins with the trail]"""
    heading: complex
    """Unit [the same frame]."""


class Correction(NamedTuple):
    """How scans moved the pose on a short path."""

    travelled: float
    """Path since the start, at the first of them [m]."""
    moved: complex
    """[m; fleet's frame]"""


class Scanned(NamedTuple):
    """A scan that has not been used yet."""

    beams: Beams
    began: float
    """[s, monotonic]"""
    ended: float
    """[s, monotonic]"""
    against: bool
    """Whether its first beam is the newest."""

    def moment(self, number: float) -> float:
        """When a beam was measured [s, monotonic]."""
        share = number / max(1, self.beams.beam_count - 1)
        return self.began + (1.0 - share if self.against else share) * (self.ended - self.began)


@dataclass(slots=True, kw_only=True)
class MateState:
    """What scans say of one neighbour."""

    outcome: Outcome = Outcome.HIDDEN
    """By the newest scan."""
    seen_at: float = -math.inf
    """When it was seen last [s, monotonic]."""
    deviation: float = 0.0
    """Standard deviation of its place relative to this robot, by the newest scan [m]."""
    missed: float = 0.0
    """Beams in a row that should have met it, and did not come back."""
    placed: bool = True
    """Whether it publishes a position that can be relied on."""


@dataclass(slots=True, kw_only=True)
class PerceptionState:
    """The estimate, and what it is based on."""

    mates: dict[str, MateState]
    estimate: Estimate | None = None
    """None before the first odometry."""
    trail: deque[Waypoint] = field(default_factory=deque)
    """Own motion by odometry, oldest first."""
    scanned: Scanned | None = None
    """A scan that waits for the odometry of its time."""
    locked: bool = False
    agreed: float = 0.0
    """Scans that showed neighbours where they say, since one did not; with one of several they count less."""
    disagreed: int = 0
    """Scans in which as many neighbours were not where they say as were; the others count against it."""
    seen_at: float = -math.inf
    """When a neighbour was seen last [s, monotonic]."""
    path: float = 0.0
    """Path since then [m]."""
    travelled: float = 0.0
    """Path since the start [m]."""
    lost_locks: list[float] = field(default_factory=list)
    """Where scans contradicted a lock [m travelled], within `LOST_LOCKS_DISTANCE`."""
    corrections: deque[Correction] = field(default_factory=deque)
    """How scans have moved the estimate since the robot was locked, on the newest `CORRECTED_DISTANCE` of
    path, oldest first."""
    misplacement: float = 0.0
    """Difference of the pose from the estimate, towards which it moves slowly, at a usual landmark [m]."""
    refused_since: float = math.inf
    """Since when neighbours are not where they say [s, monotonic]."""


class Expected(NamedTuple):
    """A robot as it should be in sight, and where the scanner was."""

    candidate: Candidate
    centre: complex
    """Of what scanners see of it, by what it publishes [m; fleet's frame]."""
    scanner: complex
    """Place of the scanner at the moment of the beam [m; body frame now]."""
    axis: complex
    """Its x axis, unit [body frame now]."""


class Perception:
    """Where one robot is in its fleet's frame, by odometry and scans."""

    def __init__(self, mission: Mission, robot: str) -> None:
        self.mates = mission.landmarks_of(robot)
        """The neighbours by which it corrects its pose."""
        self.state = PerceptionState(mates={name: MateState() for name in self.mates})
        scan = mission.robots[robot].scan
        self._mount, self._noise = scan.mount, scan.noise
        within_time = max(LOCK_SCANS, round(MAX_DISAGREED_TIME * scan.rate))
        self._max_disagreed = min(MAX_DISAGREED_SCANS, within_time)
        self._specs = {name: mission.robots[name] for name in mission.followers}

    def moved(self, arrived: float, here: Localisation) -> None:
        """Follow the odometry that arrived [s, monotonic]."""
        state, stream = self.state, here.stream
        moment = arrived - believed_delay(stream.state.delay, stream.longest_delay)
        travel, last = here.state.since_last, state.trail[-1] if state.trail else None
        if state.estimate is None or travel is None or last is None:
            self._begin(moment, here)
            return
        elapsed = max(0.0, moment - last.moment)
        turned = rotation(travel.turn)
        motion = travel.displacement * (here.state.measured / turned).conjugate()
        state.estimate = pose_filter.moved(state.estimate, motion, travel.turn, elapsed)
        state.path += abs(motion)
        state.travelled += abs(motion)
        state.trail.append(_after(last, max(moment, last.moment), motion, turned))
        while len(state.trail) > 1 and state.trail[1].moment < moment - TRAIL_TIME:
            state.trail.popleft()

    def take_scan(self, scan: LaserScan, scanner: Scanner) -> None:
        """Keep a scan that `scanner` has just processed, until the odometry of its time has come.

        One that is frozen, late or early, or not placed by believable speeds, is not used; nor is one that
        repeats an earlier one bit for bit, also while the robot stands; nor one that comes while another
        waits, as scans may come faster than odometry.
        """
        times, doubt, waits = scanner.state, scanner.doubt, self.state.scanned
        if waits is not None and times.ended - waits.ended <= MAX_WAIT:
            return
        if (doubt is None or doubt.code in LIMITED) and not scanner.repeats(scan):
            against = scanner.sweep(scan) < 0.0
            self.state.scanned = Scanned(beams(scan, self._noise), times.began, times.ended, against)

    def doubt_all(self) -> None:
        """Forget the newest scan: this process was frozen."""
        self.state.scanned, self.state.agreed = None, 0.0

    def step(self, here: Localisation, others: Iterable[Neighbour], now: Now) -> None:
        """Use the newest scan if its odometry has come; move the pose towards the estimate.

        `others` are all robots that publish their positions to this one.
        """
        state = self.state
        if state.estimate is None or not state.trail:
            return
        bodies = [one for one in others if one.name in self._specs and _is_placed(one, now)]
        names = [one.name for one in bodies]
        for name, mate in state.mates.items():
            mate.placed = name in names
        if state.scanned is not None and state.trail[-1].moment >= state.scanned.ended:
            scanned, state.scanned = state.scanned, None
            if scanned.began >= state.trail[0].moment:
                self._use(scanned, bodies, now)
        # With wrong odometry the estimate of a robot that stands may follow a neighbour that drives away. The
        # pose must not, or the leader would not wait.
        if state.locked or not self._absent:
            here.align(state.estimate.position, state.estimate.heading)
        turn = abs(angle_between(here.state.measured, state.estimate.heading))
        state.misplacement = abs(state.estimate.position - here.state.position) + LANDMARK_DISTANCE * turn
        self._lock(locked=state.locked and state.misplacement < MAX_LOCKED_MISPLACEMENT)

    def trust(self) -> None:
        """Rely on new locks again: an operator holds the robot, and can look."""
        self.state.lost_locks.clear()

    def sight(self, now: Now) -> Sight:
        """What the pose is based on."""
        if not self.state.locked:
            return Sight.SEARCHING
        reckons = now.mono - self.state.seen_at > MIN_RECKONING_TIME
        return Sight.RECKONING if reckons else Sight.LOCKED

    def placed(self, now: Now) -> bool:
        """Whether its position is a landmark for others: it can be relied on, and no longer moves there.

        Not while scans show no neighbour where it says, though the robot is locked until that lasts.
        """
        seen = self.doubt(now) is None and self.sight(now) is Sight.LOCKED
        refused = self.state.refused_since < math.inf
        return seen and not refused and self.state.misplacement < MAX_MISPLACEMENT

    def ages(self, now: Now) -> dict[str, float]:
        """Time since each neighbour was seen last [s], of those that have been seen."""
        each = self.state.mates.items()
        return {name: round(now.mono - one.seen_at, 3) for name, one in each if one.seen_at > -math.inf}

    def deviations(self, now: Now) -> dict[str, float]:
        """Standard deviation of each seen neighbour's place relative to this robot [m]."""
        gone = self.lost(now)
        return {name: round(one.deviation, 4) for name, one in self.state.mates.items() if name not in gone}

    def lost(self, now: Now) -> tuple[str, ...]:
        """The neighbours that have not been seen for `MIN_RECKONING_TIME`, or never."""
        each = self.state.mates.items()
        return tuple(name for name, one in each if now.mono - one.seen_at > MIN_RECKONING_TIME)

    def doubt(self, now: Now) -> Reason | None:
        """Why the pose cannot be relied on; None if it can."""
        state = self.state
        if len(state.lost_locks) >= MAX_LOST_LOCKS:
            return Reason.of(
                Code.SIGHT_UNRELIABLE,
                count=float(MAX_LOST_LOCKS),
                distance=LOST_LOCKS_DISTANCE,
                robots=self.mates,
            )
        unplaced = [name for name, one in state.mates.items() if not one.placed]
        if not state.locked:
            absent = self._absent
            if not absent and state.refused_since < math.inf:
                absent = list(self.mates)
            if absent:
                return Reason.of(Code.SIGHT_CONTRADICTED, robots=absent)
            if state.agreed >= LOCK_SCANS:
                off, most = state.misplacement, MAX_MISPLACEMENT
                return Reason.of(Code.SIGHT_PLACING, distance=off, limit=most)
            return Reason.of(
                Code.SIGHT_SEARCHING,
                robots=self.lost(now) or self.mates,
                count=state.agreed,
                limit=LOCK_SCANS,
                unplaced=unplaced,
            )
        age, error = now.mono - state.seen_at, self.reckoning_error
        if age > MAX_RECKONING_TIME or (age > MIN_RECKONING_TIME and error > MAX_RECKONING_ERROR):
            return Reason.of(
                Code.SIGHT_LOST,
                robots=self.mates,
                age=age,
                limit=MAX_RECKONING_TIME,
                distance=error,
                most=MAX_RECKONING_ERROR,
                unplaced=unplaced,
            )
        return None

    @property
    def reckoning_error(self) -> float:
        """Standard deviation of the error that has arisen since a neighbour was seen [m]."""
        path = self.state.path
        return math.hypot(PATH_DEVIATION * math.sqrt(path), STEADY_HEADING_DEVIATION * path)

    @property
    def _absent(self) -> list[str]:
        """Neighbours that the newest scan shows to be not where they say."""
        return [name for name, mate in self.state.mates.items() if mate.outcome is Outcome.ABSENT]

    def _begin(self, moment: float, here: Localisation) -> None:
        """Begin at the pose that is known otherwise: at first, and when odometry does not tell the motion."""
        state = self.state
        pose = here.state.position, here.state.measured
        deviations = START_DEVIATION, START_HEADING_DEVIATION
        if state.estimate is not None:
            deviations = DOUBTED_DEVIATION, DOUBTED_HEADING_DEVIATION
        state.estimate = pose_filter.first(*pose, *deviations)
        state.trail = deque([Waypoint(moment, 0j, 1.0 + 0.0j)])
        state.scanned, state.locked, state.agreed = None, False, 0.0
        state.refused_since = math.inf

    def _use(self, scanned: Scanned, others: list[Neighbour], now: Now) -> None:
        """Correct the estimate by a scan."""
        state, before = self.state, self.state.estimate
        expected = {one.name: there for one in others if (there := self._expected(one, scanned, now))}
        found = associate(
            scanned.beams,
            [one.candidate for one in expected.values()],
            lambda name, one: self._squared_distance(expected[name], one),
        )
        for name, mate in state.mates.items():
            mate.outcome = Outcome.HIDDEN
            if name not in found:
                mate.missed = 0.0
                continue
            seen = found[name].detection
            mate.outcome, mate.deviation = found[name].outcome, expected[name].candidate.deviation
            if seen is not None and not self._correct(expected[name], seen):
                mate.outcome = Outcome.UNCLEAR
            if mate.outcome is Outcome.SEEN:
                mate.seen_at = now.mono
            mate.missed += found[name].missed
            if mate.outcome not in {Outcome.MISSING, Outcome.ABSENT}:
                mate.missed = 0.0
        self._refuse_missing()
        self._judge(now.mono)
        if before is not None and state.estimate is not None:
            self._limit_correction(state.estimate.position - before.position)

    def _limit_correction(self, moved: complex) -> None:
        """End the lock of a robot if scans, the newest by `moved` [m], move it too far for its path."""
        state = self.state
        each = state.corrections
        if not state.locked:
            each.clear()
            return
        if each and state.travelled - each[-1].travelled < CORRECTION_STEP:
            each[-1] = each[-1]._replace(moved=each[-1].moved + moved)
        else:
            each.append(Correction(state.travelled, moved))
        while each[0].travelled < state.travelled - CORRECTED_DISTANCE:
            each.popleft()
        if abs(sum([one.moved for one in each])) > MAX_CORRECTION:
            state.agreed = 0.0
            self._lock(locked=False)

    def _refuse_missing(self) -> None:
        """Take neighbours for absent of which too many beams are missing."""
        for mate in self.state.mates.values():
            if mate.outcome is Outcome.MISSING and mate.missed >= MIN_MISSED_BEAMS:
                mate.outcome = Outcome.ABSENT

    def _judge(self, moment: float) -> None:
        """Decide whether the robot is locked, after a scan at `moment` [s, monotonic]."""
        state = self.state
        outcomes = [mate.outcome for mate in state.mates.values()]
        seen, absent = outcomes.count(Outcome.SEEN), outcomes.count(Outcome.ABSENT)
        refused = absent > 0
        weight = 1.0 if seen >= min(2, len(outcomes)) else LONE_WEIGHT
        if seen and not refused:
            state.agreed = min(state.agreed + weight, LOCK_SCANS)
        elif refused or moment - state.seen_at > MIN_RECKONING_TIME:
            state.agreed = 0.0
        if refused and absent >= seen:
            state.disagreed = min(state.disagreed + 1, self._max_disagreed)
        elif seen:
            state.disagreed = max(0, state.disagreed - 1) if weight < 1.0 else 0
        if seen:
            state.seen_at, state.path, state.refused_since = moment, 0.0, math.inf
            placed = state.agreed >= LOCK_SCANS and state.misplacement < MAX_MISPLACEMENT
            self._lock(locked=placed or (state.locked and state.disagreed < self._max_disagreed))
        elif refused:
            state.refused_since = min(state.refused_since, moment)
            self._lock(locked=state.locked and moment - state.refused_since < MAX_REFUSED_TIME)
        if refused and state.estimate is not None:
            state.estimate = self._wider(state.estimate, seen=seen > 0)

    @property
    def lost_locks(self) -> list[float]:
        """Path since scans contradicted a lock [m], of the last times: the robot's next agent must know."""
        return [self.state.travelled - one for one in self.state.lost_locks]

    def restore(self, lost_locks: Sequence[float]) -> None:
        """Have it know the `lost_locks` of the agent before."""
        self.state.lost_locks = [self.state.travelled - one for one in lost_locks]

    def _lock(self, *, locked: bool) -> None:
        """Store whether the robot is `locked`, and where a lock was lost that scans contradict."""
        state = self.state
        if state.locked and not locked and len(state.lost_locks) < MAX_LOST_LOCKS:
            since = state.travelled - LOST_LOCKS_DISTANCE
            state.lost_locks = [one for one in state.lost_locks if one >= since]
            state.lost_locks.append(state.travelled)
        state.locked = locked

    def _wider(self, estimate: Estimate, *, seen: bool) -> Estimate:
        """The estimate after a scan in which a neighbour is not where it says; `seen`: another one is."""
        if self.state.locked or seen:
            return pose_filter.widened(estimate, REFUSED_DEVIATION, REFUSED_HEADING_DEVIATION)
        return pose_filter.doubted(estimate, DOUBTED_DEVIATION, DOUBTED_HEADING_DEVIATION)

    def _expected(self, one: Neighbour, scanned: Scanned, now: Now) -> Expected | None:
        """Where a robot should be in the scan; None if the scanner is inside of it."""
        spec, estimate, scan = self._specs[one.name], self.state.estimate, scanned.beams
        track, point = one.state.body, one.state.track
        if track is None or point is None or estimate is None:
            return None
        facing = unit(point.point - track.point)  # of the robot, from its centre to its control point
        longest = one.stream.longest_delay + one.stream.limit
        moment, angle, there = scanned.ended, 0.0, 0j
        centre = scanner = 0j
        axis = 1.0 + 0.0j
        for _ in range(1 if scanned.began == scanned.ended else 2):
            scanner, axis = self._scanner_at(moment)
            stamp = track.stamp + moment - (now.mono - one.stream.age(now))
            centre = carried_to(track, stamp, longest) + facing * spec.seen.at
            there = pose_filter.expected(estimate, centre, scanner)
            in_scan = there * axis.conjugate()
            angle = math.atan2(in_scan.imag, in_scan.real)
            moment = scanned.moment(scan.number(angle))
        radius = spec.seen.radius or spec.radius
        if abs(there) <= radius:
            return None
        at_place = pose_filter.sightline(estimate, centre, scanner, there, (0.0, 0.0))
        deviation = math.hypot(pose_filter.deviation(estimate, at_place, abs(there)), PLACE_DEVIATION)
        candidate = Candidate(one.name, abs(there), angle, radius, deviation)
        return Expected(candidate, centre, scanner, axis)

    def _scanner_at(self, moment: float) -> tuple[complex, complex]:
        """The scanner's place [m] and x axis at `moment` [s, monotonic], in the body frame now."""
        now, then = self.state.trail[-1], _between(self.state.trail, moment)
        back = now.heading.conjugate()
        facing = back * then.heading
        return back * (then.position - now.position) + facing * self._mount.at, facing * self._mount.heading

    def _measurements(self, one: Expected, seen: Detection) -> tuple[Measurement, Measurement]:
        estimate = self.state.estimate
        if estimate is None:
            raise ValueError("no odometry yet")
        place = PLACE_DEVIATION * PLACE_DEVIATION
        variances = (
            seen.distance_variance + place,
            seen.angle_variance + place / (seen.distance * seen.distance),
        )
        ray = one.axis * rotation(seen.angle) * seen.distance
        return pose_filter.sightline(estimate, one.centre, one.scanner, ray, variances)

    def _squared_distance(self, one: Expected, seen: Detection) -> float:
        estimate = self.state.estimate
        if estimate is None:
            return math.inf
        return pose_filter.squared_distance(estimate, *self._measurements(one, seen))

    def _correct(self, one: Expected, seen: Detection) -> bool:
        """Correct the estimate by range, then by bearing; whether both were used."""
        used = True
        for which in (0, 1):
            measurement = self._measurements(one, seen)[which]
            after = (
                None if self.state.estimate is None else pose_filter.updated(self.state.estimate, measurement)
            )
            if after is None:
                used = False
            else:
                self.state.estimate = after
        return used


def _is_placed(one: Neighbour, now: Now) -> bool:
    """Whether the published position of a robot can be relied on."""
    placed = one.state.body is not None and one.fresh(now) and not one.state.searching
    return placed and one.unanswered(now) is None


def _after(last: Waypoint, moment: float, motion: complex, turned: complex) -> Waypoint:
    return Waypoint(moment, last.position + last.heading * motion, unit(last.heading * turned))


def _between(trail: deque[Waypoint], moment: float) -> Waypoint:
    """Where the robot was at `moment` [s, monotonic]; the newest place if that is later."""
    after = trail[-1]
    for before in reversed(trail):
        if before.moment <= moment:
            break
        after = before
    else:
        return trail[0]
    if after.moment <= before.moment:
        return before
    share = min(1.0, (moment - before.moment) / (after.moment - before.moment))
    return Waypoint(
        moment,
        before.position + share * (after.position - before.position),
        unit(before.heading + share * (after.heading - before.heading), before.heading),
    )
