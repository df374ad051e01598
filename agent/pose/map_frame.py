"""Where odometry is in a map, by a localiser such as AMCL: its poses, or its transforms map → odom.

Used by robots with `odometry_frame = "map"`. Odometry gives the motion, the localiser gives the *placement*
of odometry's frame in the map, rarely and unevenly: AMCL publishes a pose after each quarter of a metre, and
none while the robot stands. A pose belongs to a moment in the past, so it is compared with odometry then.

A placement that the odometry can explain by its drift is taken, and the robot's pose moves there slowly
(`OdometrySource.align`). One that it cannot explain is taken at once, as a jump, when `JUMP_AGREEMENTS` more
agree with it: a localiser that has found itself agrees with odometry from then on, one that is frozen or
guesses does not. After `MAX_JUMPS` within `JUMPS_DISTANCE` it is not believed until an operator has looked.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from formation.control.plane import angle_between, unit
from formation.protocol.reasons import Code, Reason
from formation.ros2.messages import MapPose, Odometry, Transforms
from formation.wire import BadMessage

HISTORY_TIME = 2.0
"""Age of a pose from which on it is refused [s, the robot's clock]."""
MAX_DEVIATION, MAX_HEADING_DEVIATION = 0.3, 0.3
"""Standard deviation of a pose from which on it is refused [m; rad]: the localiser does not know yet."""
DRIFT_DISTANCE, DRIFT_SHARE = 0.2, 0.2
"""Change of the placement that odometry's drift and the localiser's noise explain [m], and the share of the
distance travelled that is added."""
DRIFT_ANGLE = 0.2
"""The same for its heading [rad]."""
ANCHOR_DISTANCE = 1.0
"""Distance travelled over which the change counts [m]."""
JUMP_AGREEMENTS = 2
"""Number of later placements that must agree with one that odometry cannot explain."""
MAX_JUMPS, JUMPS_DISTANCE = 3, 5.0
"""Number of jumps within so much travel [m] after which the localiser is not believed."""
MAX_UNCORRECTED_DISTANCE = 5.0
"""Distance that a robot may travel without a placement [m]."""
MIN_FROZEN_DISTANCE = 0.05
"""Distance travelled between two equal poses, to the last bit, from which on they are refused [m]."""


class Placement(NamedTuple):
    """Odometry's frame in the map."""

    rotation: complex
    """Unit [map]."""
    origin: complex
    """[m; map]"""

    def of(self, position: complex) -> complex:
        """Position in the map of one in the odometry's frame [m]."""
        return self.origin + self.rotation * position


class Passed(NamedTuple):
    """Odometry at one moment."""

    stamp: float
    """[s, the robot's clock]"""
    position: complex
    """[m; odometry's frame]"""
    heading: complex
    """Unit [odometry's frame]."""
    travelled: float
    """[m]"""


class Suspect(NamedTuple):
    """A placement that odometry does not explain."""

    placement: Placement
    travelled: float
    """When it came [m]."""
    agreements: int = 0


@dataclass(slots=True, kw_only=True)
class MapFrameState:
    """What is known of the placement."""

    passed: deque[Passed] = field(default_factory=deque)
    """Odometry of the last `HISTORY_TIME` seconds, oldest first."""
    placement: Placement | None = None
    """The newest that was taken; None before the first."""
    anchor: tuple[Placement, float] | None = None
    """One from up to `ANCHOR_DISTANCE` ago, and when it was taken [m travelled]."""
    suspect: Suspect | None = None
    corrected: float = 0.0
    """When the newest was taken [m travelled]."""
    jumps: list[float] = field(default_factory=list)
    """When it jumped [m travelled], within `JUMPS_DISTANCE`."""
    distrusted: bool = False
    """Whether it jumped too often."""
    stamp: float = -math.inf
    """Of the newest pose [s]."""
    pose: tuple[complex, complex] | None = None
    """Position [m; map] and heading of the newest pose."""
    since: float = 0.0
    """Stamp of the first of those poses that were equal to it [s]."""


class MapFrame:
    """The placement of one robot's odometry in the map."""

    def __init__(self) -> None:
        self.state = MapFrameState()

    @property
    def travelled(self) -> float:
        """Distance travelled so far [m]."""
        return self.state.passed[-1].travelled if self.state.passed else 0.0

    @property
    def doubt(self) -> Reason | None:
        """Why the robot's position is unknown, or not believed; None if it is known."""
        state = self.state
        if state.placement is None:
            return Reason(Code.NOT_LOCALISED)
        if state.distrusted:
            return Reason.of(Code.LOCALISER_JUMPS, count=float(MAX_JUMPS), distance=JUMPS_DISTANCE)
        uncorrected = self.travelled - state.corrected
        if uncorrected > MAX_UNCORRECTED_DISTANCE:
            return Reason.of(Code.LOCALISER_SILENT, distance=uncorrected, limit=MAX_UNCORRECTED_DISTANCE)
        return None

    def trust(self) -> None:
        """Believe the localiser again: an operator has looked."""
        self.state.distrusted, self.state.jumps = False, []

    def moved(self, odometry: Odometry, anew: Placement | None) -> None:
        """Record odometry; where a new count has begun, `anew` is its placement, by dead reckoning."""
        state, passed = self.state, self.state.passed
        travelled = self.travelled
        if anew is not None:
            passed.clear()
            state.suspect = None
            if state.placement is not None:  # what the localiser told was of the count before
                state.placement, state.anchor = anew, (anew, travelled)
        elif passed:
            travelled += abs(odometry.position - passed[-1].position)
        passed.append(Passed(odometry.stamp, odometry.position, odometry.heading, travelled))
        while passed[0].stamp < odometry.stamp - HISTORY_TIME:
            passed.popleft()

    def take_pose(self, pose: MapPose) -> Reason | None:
        """Take a pose; return the jump that it confirms, if any. Raises BadMessage."""
        state = self.state
        if pose.deviation > MAX_DEVIATION or pose.heading_deviation > MAX_HEADING_DEVIATION:
            raise BadMessage(
                f"pose uncertain by {pose.deviation:.2f} m, {pose.heading_deviation:.2f} rad; limits"
                f" {MAX_DEVIATION:g} m, {MAX_HEADING_DEVIATION:g} rad"
            )
        then = self._then(pose.stamp)
        if pose.stamp <= state.stamp:
            raise BadMessage(f"pose stamped {state.stamp - pose.stamp:.3f} s before the newest")
        state.stamp = pose.stamp
        if state.pose != (pose.position, pose.heading):
            state.pose, state.since = (pose.position, pose.heading), pose.stamp
        elif self._moved_since(state.since, then) > MIN_FROZEN_DISTANCE:
            raise BadMessage("pose frozen: the robot moved, and it is the same to the last bit")
        turn = unit(pose.heading / then.heading)
        return self._take(Placement(turn, pose.position - turn * then.position), then)

    def take_transforms(self, transforms: Transforms, world: str, frame: str) -> Reason | None:
        """Take the transform from `world` to odometry's `frame`, if there is one; return as `take_pose`."""
        if not self.state.passed:
            return None
        found = None
        for one in transforms.transforms:
            if (_plain(one.parent), _plain(one.child)) == (_plain(world), _plain(frame)):
                found = self._take(Placement(one.heading, one.position), self.state.passed[-1]) or found
        return found

    def _take(self, placement: Placement, then: Passed) -> Reason | None:
        state = self.state
        if state.placement is None or state.anchor is None:
            self._place(placement, then)
            return None
        anchor, since = state.anchor
        if _explained(anchor, placement, then, DRIFT_SHARE * max(0.0, then.travelled - since)):
            state.placement, state.suspect, state.corrected = placement, None, then.travelled
            if then.travelled - since > ANCHOR_DISTANCE:
                state.anchor = placement, then.travelled
            return None
        before = state.suspect
        if before is not None:
            drift = DRIFT_SHARE * max(0.0, then.travelled - before.travelled)
            if _explained(before.placement, placement, then, drift, DRIFT_DISTANCE / 2.0):
                state.suspect = before._replace(agreements=before.agreements + 1)
                return self._jump(placement, then) if state.suspect.agreements >= JUMP_AGREEMENTS else None
        state.suspect = Suspect(placement, then.travelled)
        return None

    def _jump(self, placement: Placement, then: Passed) -> Reason:
        state, before = self.state, self.state.placement
        distance = 0.0 if before is None else abs(placement.of(then.position) - before.of(then.position))
        self._place(placement, then)
        state.jumps = [one for one in state.jumps if then.travelled - one <= JUMPS_DISTANCE]
        state.jumps.append(then.travelled)
        state.distrusted = state.distrusted or len(state.jumps) >= MAX_JUMPS
        return Reason.of(Code.RELOCALISED, distance=distance)

    def _place(self, placement: Placement, then: Passed) -> None:
        state = self.state
        state.placement, state.anchor = placement, (placement, then.travelled)
        state.suspect, state.corrected = None, then.travelled

    def _then(self, stamp: float) -> Passed:
        """Odometry at `stamp` [s], between two messages. Raises BadMessage if that is not known."""
        passed = self.state.passed
        if not passed or not passed[0].stamp <= stamp <= passed[-1].stamp + HISTORY_TIME:
            age = math.inf if not passed else passed[-1].stamp - stamp
            raise BadMessage(f"pose stamped {age:.2f} s before the newest odometry; limit {HISTORY_TIME:g} s")
        after = next((one for one in passed if one.stamp >= stamp), passed[-1])
        before = next((one for one in reversed(passed) if one.stamp <= stamp), passed[0])
        if after.stamp <= before.stamp:
            return before
        share = (stamp - before.stamp) / (after.stamp - before.stamp)
        return Passed(
            stamp,
            before.position + share * (after.position - before.position),
            unit(before.heading + share * (after.heading - before.heading)),
            before.travelled + share * (after.travelled - before.travelled),
        )

    def _moved_since(self, stamp: float, then: Passed) -> float:
        """Distance travelled between two poses, as far as it is known [m]."""
        first = self.state.passed[0]
        return then.travelled - (first.travelled if stamp <= first.stamp else self._then(stamp).travelled)


def _explained(
    before: Placement, after: Placement, then: Passed, drift: float, least: float = DRIFT_DISTANCE
) -> bool:
    """Whether noise of `least` [m] and a `drift` [m] explain the change between two placements."""
    shift = abs(after.of(then.position) - before.of(then.position))
    turn = abs(float(angle_between(before.rotation, after.rotation)))
    return shift <= least + drift and turn <= DRIFT_ANGLE


def _plain(frame: str) -> str:
    """A frame's name without a leading slash, as old nodes write it."""
    return frame.removeprefix("/")
