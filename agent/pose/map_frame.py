"""Where odometry is in a map, by a localiser such as AMCL: its poses, or its transforms map → odom.

Used by robots with `odometry_frame = "map"`. Odometry gives the motion, the localiser gives the *placement*
of odometry's frame in the map, rarely and unevenly: AMCL publishes a pose after each quarter of a metre, and
none while the robot stands. A pose belongs to a moment in the past, so it is compared with odometry then.

A placement that the odometry can explain by its drift is taken, and the robot's pose moves there slowly
(`OdometrySource.align`). One that it cannot explain is taken at once, as a jump, when `JUMP_AGREEMENTS` more
agree with it: a localiser that has found itself agrees with odometry from then on, one that is frozen or
guesses does not. After `MAX_JUMPS` within `JUMPS_DISTANCE` it is not believed until an operator has looked.
Nor is one that was taken at once, and which later ones contradict `MAX_CONTRADICTIONS` times before
`ANCHOR_DISTANCE` has confirmed it: a wrong base frame, or a second localiser on the topic.

AMCL repeats its newest transform, with new stamps, until its next update. What is repeated, to the last bit,
is no news: it agrees with nothing and corrects nothing. An agreement counts only after motion, or after a
while if the robot stands. AMCL tells nothing more of a robot that stands: a pose given to it by hand (RViz)
is taken while an order holds the robot (`MapFrame.trust`), or when the robot has moved on.
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

HISTORY_TIME = 1.0
"""Age of a pose from which on it is refused [s, the robot's clock]; AMCL's are 0.05 to 0.3 s old."""
MAX_DEVIATION, MAX_HEADING_DEVIATION = 0.3, 0.3
"""Standard deviation of a pose from which on it is refused [m; rad]: the localiser does not know yet. Also
the robot's motion since its stamp: a wrong clock, which looks like an age, shifts a placement by no more."""
DRIFT_DISTANCE, DRIFT_SHARE = 0.2, 0.2
"""Change of the placement that odometry's drift and the localiser's noise explain [m], and the share of the
distance travelled that is added."""
DRIFT_ANGLE = 0.2
"""The same for its heading [rad]."""
ANCHOR_DISTANCE = 1.0
"""Distance travelled over which the change counts [m]."""
JUMP_AGREEMENTS = 2
"""Number of later placements that must agree with one that odometry cannot explain."""
AGREEMENT_DISTANCE, AGREEMENT_ANGLE, AGREEMENT_TIME = 0.08, 0.15, 0.4
"""Motion [m or rad] and time [s] from one agreement to the next. After two of them a frozen localiser, off by
the motion, no longer agrees with itself; and a mistake must last for 0.8 s."""
STANDING_TIME, STANDING_SHARE = 1.0, 0.25
"""Time from one to the next where the robot stands [s], and the share of that motion that is standing."""
MAX_JUMPS, JUMPS_DISTANCE = 3, 5.0
"""Number of jumps within so much travel [m] after which the localiser is not believed."""
CONTRADICTION_DISTANCE, CONTRADICTION_ANGLE = 0.5, 0.5
"""Change of the placement, beyond the share for drift, that a localiser's noise does not explain [m; rad]."""
MAX_CONTRADICTIONS = 2
"""Number of contradictions after which a placement that motion has not confirmed is not believed."""
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
    first: Passed
    """Odometry when it came."""
    agreed: Passed
    """The same of the newest agreement that counted."""
    agreements: int = 0


class Trial(NamedTuple):
    """A placement that was taken at once, and which motion has not confirmed yet."""

    since: float
    """When it was taken, or last contradicted [m travelled]."""
    contradictions: int = 0
    """Number of later placements that agree neither with it nor with one another."""


class Received(NamedTuple):
    """The newest transform of the localiser that was not refused."""

    placement: Placement
    stamp: float
    """[s, the localiser's clock]"""
    arrived: float
    """Stamp of the newest odometry then [s, the robot's clock]."""
    refused: float = math.inf
    """Stamp of the newest one refused since [s, the localiser's clock]; infinite if none was."""


@dataclass(slots=True, kw_only=True)
class MapFrameState:
    """What is known of the placement."""

    passed: deque[Passed] = field(default_factory=deque)
    """Odometry of the last `HISTORY_TIME` seconds, oldest first."""
    placement: Placement | None = None
    """The newest that was taken; None before the first, and while that of a new count is unknown."""
    anchor: tuple[Placement, float] | None = None
    """One from up to `ANCHOR_DISTANCE` ago, and when it was taken [m travelled]."""
    suspect: Suspect | None = None
    trial: Trial | None = None
    """That of the placement, until motion confirms it."""
    refused: str = ""
    """Why the newest message of the localiser was refused; empty if it was not."""
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
    """When the first of those poses came that were equal to it [m travelled]."""
    newest: Received | None = None
    """The newest transform, also of a count before; None before the first."""
    outdated: Placement | None = None
    """That of odometry's count before, until the localiser knows the new one."""


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
        uncorrected = self.travelled - state.corrected
        silent = state.placement is None or uncorrected > MAX_UNCORRECTED_DISTANCE
        if silent and state.refused:
            return Reason.of(Code.LOCALISER_REFUSED, detail=state.refused)
        if state.placement is None:
            return Reason(Code.NOT_LOCALISED)
        if state.distrusted:
            return Reason.of(Code.LOCALISER_JUMPS, count=float(MAX_JUMPS), distance=JUMPS_DISTANCE)
        if silent:
            return Reason.of(Code.LOCALISER_SILENT, distance=uncorrected, limit=MAX_UNCORRECTED_DISTANCE)
        if state.trial is not None and state.trial.contradictions >= MAX_CONTRADICTIONS:
            count = float(state.trial.contradictions)
            return Reason.of(Code.LOCALISER_CONTRADICTS, count=count, distance=ANCHOR_DISTANCE)
        return None

    def trust(self) -> Reason | None:
        """Believe the localiser again: an order holds the robot, so that an operator can look.

        Its newest placement is taken, though nothing agrees with it, once the robot has stood for
        `STANDING_TIME`; return that jump.
        """
        state = self.state
        state.distrusted, state.jumps = False, []
        state.trial = None if state.trial is None else Trial(self.travelled)
        if state.suspect is None or not self._stood_since(state.suspect.agreed, state.passed[-1]):
            return None
        return self._jump(state.suspect.placement, state.passed[-1])

    def moved(self, odometry: Odometry, anew: Placement | None, *, gap: bool = False) -> None:
        """Record odometry; where a new count has begun, `anew` is its placement, by dead reckoning.

        After a `gap` in odometry that is not believed: the robot may have been carried.
        """
        state, passed = self.state, self.state.passed
        travelled = self.travelled
        set_back = bool(passed) and odometry.stamp < passed[-1].stamp
        if set_back:  # the robot's clock: older stamps are to be believed again
            state.stamp = -math.inf
            state.newest = None if state.newest is None else state.newest._replace(stamp=-math.inf)
        if anew is not None:
            if state.placement is not None:  # what the localiser told was of the count before
                state.outdated = state.outdated or state.placement
                state.placement, state.anchor = None if gap else anew, (anew, travelled)
        elif passed:
            travelled += abs(odometry.position - passed[-1].position)
        if anew is not None or set_back:
            passed.clear()
            state.suspect = None
        passed.append(Passed(odometry.stamp, odometry.position, odometry.heading, travelled))
        while passed[0].stamp < odometry.stamp - HISTORY_TIME:
            passed.popleft()

    def refuse(self, bad: BadMessage) -> None:
        """Record why the localiser's newest message was refused."""
        self.state.refused = str(bad)

    def take_pose(self, pose: MapPose) -> Reason | None:
        """Take a pose; return the jump that it confirms, if any. Raises BadMessage."""
        state = self.state
        if pose.deviation > MAX_DEVIATION or pose.heading_deviation > MAX_HEADING_DEVIATION:
            raise BadMessage(
                f"pose uncertain by {pose.deviation:.2f} m, {pose.heading_deviation:.2f} rad; limits"
                f" {MAX_DEVIATION:g} m, {MAX_HEADING_DEVIATION:g} rad: push the robot until the localiser is"
                " certain (AMCL: call request_nomotion_update)"
            )
        then = self._then(pose.stamp)
        if pose.stamp <= state.stamp:
            raise BadMessage(f"pose stamped {state.stamp - pose.stamp:.3f} s before the newest")
        now = state.passed[-1]
        moved = abs(now.position - then.position)
        turned = abs(float(angle_between(then.heading, now.heading)))
        if moved > MAX_DEVIATION or turned > MAX_HEADING_DEVIATION:
            raise BadMessage(
                f"pose {now.stamp - pose.stamp:.2f} s old: the robot moved {moved:.2f} m, {turned:.2f} rad"
                f" since; limits {MAX_DEVIATION:g} m, {MAX_HEADING_DEVIATION:g} rad: check its clock"
            )
        state.stamp = pose.stamp
        if state.pose != (pose.position, pose.heading):
            state.pose, state.since = (pose.position, pose.heading), then.travelled
        elif then.travelled - state.since > MIN_FROZEN_DISTANCE:
            raise BadMessage("pose frozen: the robot moved, and it is the same to the last bit")
        else:
            return None
        turn = unit(pose.heading / then.heading)
        return self._take(Placement(turn, pose.position - turn * then.position), then)

    def take_transforms(self, transforms: Transforms, world: str, frame: str) -> Reason | None:
        """Take the transform from `world` to odometry's `frame`, if there is one; return as `take_pose`.

        Stamps must rise, else it raises BadMessage; they may be in the future (AMCL's `transform_tolerance`).
        Where none was taken for `HISTORY_TIME`, the localiser's clock was set back: any that rise are taken.
        """
        state, wanted = self.state, (_plain(world), _plain(frame))
        found = [one for one in transforms.transforms if (_plain(one.parent), _plain(one.child)) == wanted]
        if not found or not state.passed:
            return None
        one, newest, then = found[-1], state.newest, state.passed[-1]
        if newest is not None and one.stamp <= newest.stamp:
            silent = then.stamp - newest.arrived > HISTORY_TIME
            if not (silent and newest.refused < one.stamp):
                state.newest = newest._replace(refused=one.stamp)
                raise BadMessage(f"transform stamped {newest.stamp - one.stamp:.3f} s before the newest")
        placement = Placement(one.heading, one.position)
        state.newest = Received(placement, one.stamp, then.stamp)
        return None if newest is not None and newest.placement == placement else self._take(placement, then)

    def _take(self, placement: Placement, then: Passed) -> Reason | None:
        state = self.state
        state.refused = ""
        stale = state.outdated is not None and _explained(state.outdated, placement, then, 0.0)
        if state.placement is None or state.anchor is None:
            if not stale:
                self._place(placement, then)
            elif state.suspect is None:  # true only where the robot is where the count before began
                state.suspect = Suspect(placement, then, then)
            return None
        anchor, since = state.anchor
        drifted = DRIFT_SHARE * max(0.0, then.travelled - since)
        if _explained(anchor, placement, then, drifted):
            self._try(then, None if state.suspect is None else state.suspect.placement, drifted)
            state.placement, state.suspect, state.corrected = placement, None, then.travelled
            state.outdated = None
            if then.travelled - since > ANCHOR_DISTANCE:
                state.anchor = placement, then.travelled
            return None
        if stale:
            return None  # the localiser took the new count for motion
        before = state.suspect
        drift = 0.0 if before is None else DRIFT_SHARE * max(0.0, then.travelled - before.first.travelled)
        if before is None or not _explained(before.placement, placement, then, drift, DRIFT_DISTANCE / 2.0):
            if before is not None:
                self._try(then, placement, drifted)
            state.suspect = Suspect(placement, then, then)
        elif self._counts(before, then):
            state.suspect = before._replace(agreed=then, agreements=before.agreements + 1)
            return self._jump(placement, then) if before.agreements + 1 >= JUMP_AGREEMENTS else None
        return None

    def _try(self, then: Passed, other: Placement | None, drifted: float) -> None:
        """Count a contradiction by `other`, once for each motion; else end the trial, if motion confirms it.

        `drifted` [m] is what odometry's drift since the anchor explains.
        """
        trial, anchor = self.state.trial, self.state.anchor
        if trial is None or anchor is None:
            return
        limits = CONTRADICTION_DISTANCE, CONTRADICTION_ANGLE
        over = then.travelled - trial.since
        if other is not None and not _explained(anchor[0], other, then, drifted, *limits):
            if over >= AGREEMENT_DISTANCE:
                self.state.trial = Trial(then.travelled, trial.contradictions + 1)
        elif over > ANCHOR_DISTANCE and trial.contradictions < MAX_CONTRADICTIONS:
            self.state.trial = None

    def _counts(self, suspect: Suspect, then: Passed) -> bool:
        """Whether an agreement of `then` is independent of those before."""
        moved = _motion(suspect.first, then) >= suspect.agreements + 1
        late = then.stamp - suspect.agreed.stamp >= AGREEMENT_TIME
        return (moved and late) or self._stood_since(suspect.agreed, then)

    def _stood_since(self, before: Passed, then: Passed) -> bool:
        """Whether `STANDING_TIME` has passed, and the robot has stood lately."""
        passed = self.state.passed
        stood = _motion(passed[0], passed[-1]) <= STANDING_SHARE
        return stood and then.stamp - before.stamp >= STANDING_TIME

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
        state.suspect, state.outdated, state.corrected = None, None, then.travelled
        state.trial = Trial(then.travelled)

    def _then(self, stamp: float) -> Passed:
        """Odometry at `stamp` [s], between two messages. Raises BadMessage if that is not known."""
        passed = self.state.passed
        if not passed or not passed[0].stamp <= stamp <= passed[-1].stamp + HISTORY_TIME:
            age = math.inf if not passed else passed[-1].stamp - stamp
            side = "after" if age < 0.0 else "before"
            raise BadMessage(
                f"pose stamped {abs(age):.2f} s {side} the newest odometry; limit {HISTORY_TIME:g} s:"
                " check the clock of the localiser (chrony)"
            )
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


def _motion(before: Passed, after: Passed) -> float:
    """Motion between two moments, as a multiple of that for an agreement."""
    turn = abs(float(angle_between(before.heading, after.heading)))
    return max(abs(after.position - before.position) / AGREEMENT_DISTANCE, turn / AGREEMENT_ANGLE)


def _explained(
    before: Placement,
    after: Placement,
    then: Passed,
    drift: float,
    least: float = DRIFT_DISTANCE,
    least_turn: float = DRIFT_ANGLE,
) -> bool:
    """Whether noise of `least` [m] and `least_turn` [rad], and a `drift` [m], explain the change."""
    shift = abs(after.of(then.position) - before.of(then.position))
    turn = abs(float(angle_between(before.rotation, after.rotation)))
    return shift <= least + drift and turn <= least_turn


def _plain(frame: str) -> str:
    """A frame's name without a leading slash, as old nodes write it."""
    return frame.removeprefix("/")
