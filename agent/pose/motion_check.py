"""Does the robot move as commanded? Its commands against its sensor, without a clock.

Net displacement counts, not path length: a sensor that trembles around one place shows no motion. A leg is
the commanded and the measured motion since the sensor last showed motion. It is compared for several delays
between command and sensor, and no possible delay may explain the difference:

    FROZEN    commanded more than `Tolerance.net_min`, seen less than MIN_MOTION_SHARE of it, now or at the
              farthest; or commanded more than `still_min`, and every position so far within `still`
    TURN      the same for the heading, where the sensor measures one; also if it turns the other way
    SPEEDS    odometry's own speeds and positions disagree, or its speeds have the wrong sign
    CARRIED   seen more than MAX_MOTION_RATIO times what was commanded, plus a tolerance; since the sensor
              last showed motion, or over the last `EXCESS_DISTANCE`: a wrong scale, or a position that slides
    TURNED    the same for the heading
    LATE      positions follow the commands later than they may (`formation.agent.pose.motion_model`)

Noise up to 5 mm (standard deviation), delays up to `MAX_COMMAND_LOOP_DELAY` plus the robot's lag and one
period, and slip up to half of the distance do not add up to a disagreement. A disagreement lasts until the
sensor shows a probe's motion (`formation.agent.pose.probe`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from formation.agent.pose.motion_model import (
    DELAY_COUNT,
    Between,
    MotionModel,
    MotionModelState,
    OwnDelay,
    OwnDelayState,
    ahead_at,
    path_at,
    positions,
    turning_at,
    turns,
)
from formation.control.observer import Travel
from formation.control.plane import rotation
from formation.mission.model import Mission
from formation.protocol.status import MotionFault

MAX_COMMAND_LOOP_DELAY = 0.35
"""Delay of a command to the wheels and a measurement back that is no fault, on a busy computer too [s]."""
HALF_DELAY_INDEX = DELAY_COUNT // 2
"""Index of half the longest delay: motion without a command is judged by what was commanded since then."""
MIN_MOTION_SHARE = 0.4
"""Share of the commanded motion below which the robot does not move as commanded."""
MAX_MOTION_RATIO = 1.5
"""Greatest ratio of seen to commanded motion that is no fault."""
EXCESS_DISTANCE = 0.3
"""Commanded path over which too much motion is summed up, though each leg of it is plausible [m]."""
FORGETTING_TIME = 20.0
"""Time constant with which a leg is forgotten [s], so that small model errors do not add up for ever."""
SPEED_WINDOW_DISTANCE = 0.1
"""Distance by either after which odometry's speeds are compared with its positions [m]."""
MIN_SPEED_WINDOW_TIME = 0.4
"""Shortest time between two such comparisons [s]."""
MAX_REVERSED_DISTANCE = 0.05
"""Reported distance against the commanded direction that is no fault [m]."""


class Disagreement(NamedTuple):
    """Expected and measured motion of a robot."""

    kind: MotionFault
    expected: float
    """By its commands (SPEEDS: by the positions) [m; TURN and TURNED: rad]; LATE: the limit [s]."""
    seen: float
    """By its sensor (SPEEDS: by the reported speeds) [the same unit]; LATE: the delay [s]."""
    over: float
    """Time between [s]."""


class Tolerance(NamedTuple):
    """Tolerances of one leg; lengths [m], or angles [rad]."""

    net_min: float
    """Commanded net motion from which on the share counts."""
    still_min: float
    """Commanded net motion from which on a sensor that stays within `still` is frozen."""
    still: float
    moved: float
    """Seen net motion that ends a leg."""
    carried: float
    """Motion without a command that is no fault."""


POSITION = Tolerance(net_min=0.06, still_min=0.035, still=0.006, moved=0.02, carried=0.06)
HEADING = Tolerance(net_min=0.3, still_min=0.2, still=0.05, moved=0.12, carried=0.4)
POSITION_FAULTS = MotionFault.FROZEN, MotionFault.CARRIED
HEADING_FAULTS = MotionFault.TURN, MotionFault.TURNED


class LegMemory(NamedTuple):
    """What the next agent of the robot must know of a leg; lengths [m], or angles [rad]."""

    commanded: complex
    """Commanded net motion [frame of the newest heading]."""
    path: float
    """Commanded path."""
    seen: complex
    """Net motion by the sensor."""
    farthest: float
    """Largest size of `seen`."""
    began: float
    """[s, monotonic]"""


class MotionMemory(NamedTuple):
    """What the next agent of the robot must know of its motion, to notice a frozen sensor."""

    doubt: Disagreement | None
    """The disagreement that has not been disproved yet."""
    position: LegMemory
    heading: LegMemory


@dataclass(slots=True, kw_only=True)
class LegState:
    """What a leg has summed up; lengths [m], or angles [rad]."""

    seen: complex = 0j
    """Net motion by the sensor."""
    origins: list[complex] = field(default_factory=lambda: [0j] * DELAY_COUNT)
    """Where the model was when the leg began, by delay."""
    path_before: float = 0.0
    """Path of the model, half the longest delay before."""
    farthest: float = 0.0
    """Largest size of `seen`."""
    least: float = 0.0
    """Commanded net motion, with the delay that makes it least."""
    excursions: list[float] = field(default_factory=lambda: [0.0] * DELAY_COUNT)
    """Largest commanded net motion so far, by delay."""
    began: float = float("-inf")
    """[s, monotonic]"""


class Leg:
    """Commanded and seen motion since the sensor last showed motion."""

    def __init__(self, tolerance: Tolerance, *, signed: bool = False) -> None:
        """`signed`: motion has a sign, which must be that of the commands."""
        self.state = LegState()
        self._tolerance, self._signed = tolerance, signed

    def begin(self, moment: float, models: Sequence[complex], path_before: float) -> None:
        """Start afresh."""
        state = self.state
        state.seen, state.farthest, state.least, state.began = 0j, 0.0, 0.0, moment
        state.excursions = [0.0] * DELAY_COUNT
        state.origins, state.path_before = list(models), path_before

    def memory(self, model: complex, heading: complex, path: float) -> LegMemory:
        """What the next agent must know, with the newest state of the model."""
        state = self.state
        commanded = (model - state.origins[0]) / heading
        return LegMemory(commanded, path - state.path_before, state.seen, state.farthest, state.began)

    def resume(self, earlier: LegMemory, seen: complex) -> None:
        """Continue an earlier agent's leg in one that has just begun; the sensor saw `seen` in between."""
        state = self.state
        state.origins = [one - earlier.commanded for one in state.origins]
        state.path_before -= earlier.path + abs(seen)
        state.seen, state.began = earlier.seen + seen, earlier.began
        state.farthest = max(earlier.farthest, abs(state.seen))

    def excuse(self, seen: complex) -> None:
        """Let the motion `seen` in a gap need no command: nothing is known of what happened in it."""
        self.state.path_before -= abs(seen)

    def add(self, seen: complex, remaining: float, models: Sequence[complex], path: float) -> None:
        """Add an interval; everything before counts only as the share `remaining`."""
        state = self.state
        state.seen = remaining * state.seen + seen
        state.origins = [
            now + remaining * (was - now) for now, was in zip(models, state.origins, strict=True)
        ]
        state.path_before = path + remaining * (state.path_before - path)
        state.farthest = max(state.farthest, abs(state.seen))
        commanded = [abs(now - was) for now, was in zip(models, state.origins, strict=True)]
        state.least = min(commanded)
        state.excursions = list(map(max, state.excursions, commanded))

    def judge(
        self,
        moment: float,
        models: Sequence[complex],
        path: float,
        slack: Callable[[], float],
        kinds: tuple[MotionFault, MotionFault],
    ) -> Disagreement | None:
        """What disagrees; `slack` returns the model's possible error between two delays.

        `kinds` name too little and too much motion.
        """
        state = self.state
        limits, seen, least = self._tolerance, abs(state.seen), state.least
        over = min(moment - state.began, FORGETTING_TIME)  # what was before has faded
        if least > limits.still_min:
            error = slack()
            still = least > limits.still_min + error and state.farthest < limits.still
            if still or (least > limits.net_min + error and seen < MIN_MOTION_SHARE * least):
                return Disagreement(kinds[0], least, seen, over)
        # a robot that went there and back has been away, whatever the delay
        away = min(state.excursions)
        if state.farthest < MIN_MOTION_SHARE * away and away > limits.net_min + slack():
            return Disagreement(kinds[0], away, state.farthest, over)
        if (excess := self.excess(moment, path, kinds[1])) is not None:
            return excess
        if least > limits.net_min and self._against(models) and least > limits.net_min + slack():
            return Disagreement(kinds[0], least, -seen, over)
        return None

    def excess(self, moment: float, path: float, kind: MotionFault) -> Disagreement | None:
        """How much more motion is seen than was commanded, if that is a fault."""
        seen, most = abs(self.state.seen), path - self.state.path_before
        if seen <= MAX_MOTION_RATIO * most + self._tolerance.carried:
            return None
        return Disagreement(kind, most, seen, min(moment - self.state.began, FORGETTING_TIME))

    def _against(self, models: Sequence[complex]) -> bool:
        """Whether the seen motion has another sign than the commanded net motion, whatever the delay."""
        seen, origins = self.state.seen.real, self.state.origins
        return self._signed and all(
            seen * (now - was).real < 0.0 for now, was in zip(models, origins, strict=True)
        )

    def shows_motion(self, models: Sequence[complex], path: float) -> bool:
        """Whether enough motion is seen to end the leg: some, and no more than was commanded."""
        seen = abs(self.state.seen)
        enough = seen > self._tolerance.moved and seen > MIN_MOTION_SHARE * self.state.least
        most = MAX_MOTION_RATIO * (path - self.state.path_before) + self._tolerance.moved
        return enough and seen <= most and not self._against(models)


@dataclass(slots=True, kw_only=True)
class SpeedWindow:
    """Motion by odometry's speeds and by its positions, since the window began."""

    began: float = 0.0
    """[s, monotonic]"""
    ahead_before: list[float] = field(default_factory=lambda: [0.0] * DELAY_COUNT)
    """Signed path length of the model when it began, by delay [m]."""
    facing: complex = 1.0 + 0.0j
    """Turn by the sensor, as a unit complex number."""
    by_speeds: complex = 0j
    """Net motion by the reported speeds [m]."""
    by_positions: complex = 0j
    """Net motion by the positions [m]."""
    reported: float = 0.0
    """Signed path length [m]."""
    least: float = math.inf
    """Least signed path length of one interval [m]."""
    most: float = -math.inf
    """Greatest signed path length of one interval [m]."""


@dataclass(slots=True, kw_only=True)
class MotionCheckState:
    """What a motion check has learned."""

    model: MotionModelState
    position: LegState
    heading: LegState
    excess: LegState
    """Of positions, until `EXCESS_DISTANCE` was commanded."""
    delay: OwnDelayState
    doubt: Disagreement | None = None
    """The disagreement that has not been disproved yet."""
    confirmed: int = 0
    """Number of legs that have shown motion since the last doubt was disproved."""
    last: float | None = None
    """End of the newest interval [s, monotonic]."""
    window: SpeedWindow = field(default_factory=SpeedWindow)
    earlier: MotionMemory | None = None
    """Of the agent before, until this one has its first interval."""


class MotionCheck:
    """Compares one robot's commands with what its sensor shows."""

    def __init__(self, mission: Mission, robot: str) -> None:
        spec = mission.robots[robot]
        self._period = period = 1.0 / spec.rate
        self.excused = period + mission.collisions.lag
        """Delay of a measurement beyond its age that is no fault [s]: a period, and the wheels' lag."""
        self.model = MotionModel(MAX_COMMAND_LOOP_DELAY + self.excused, spec.longest_command)
        self._has_speeds = spec.localisation == "odometry"
        self._has_heading = self._has_speeds or spec.heading == "measured"
        self._position, self._heading = Leg(POSITION), Leg(HEADING, signed=True)
        self._excess = Leg(POSITION)
        self._delay = OwnDelay(mission.collisions.noise, spec.rate)
        self.state = MotionCheckState(
            model=self.model.state,
            position=self._position.state,
            heading=self._heading.state,
            excess=self._excess.state,
            delay=self._delay.state,
        )

    @property
    def memory(self) -> MotionMemory:
        """What the next agent of the robot must know."""
        model, one = self.model.now, 1.0 + 0.0j
        return MotionMemory(
            self.state.doubt,
            self._position.memory(model.position, model.heading, model.path),
            self._heading.memory(complex(model.turn), one, model.turning),
        )

    def trust(self) -> None:
        """Clear the disagreement: it was disproved."""
        self.state.doubt, self.state.last, self.state.confirmed = None, None, 0
        self.state.earlier = None
        self.state.delay = self._delay.state = OwnDelayState()

    def saw(
        self, moment: float, travel: Travel | None, *, gap: bool = False, age_limit: float = math.inf
    ) -> None:
        """Check a measurement that arrived at `moment` [s, monotonic], and its interval; None if unknown.

        `gap`: the interval is so long that only its two positions count, not what happened in between. A
        measurement may be `age_limit` [s] old.
        """
        self.model.go_to(moment)
        self._check_delay(moment, None if gap else travel, age_limit + self.excused)
        if self.state.doubt is not None:
            return
        models = self.model.delayed()
        last, self.state.last = self.state.last, moment
        if travel is None or last is None:
            self._begin(moment, models)
            self._resume(travel)
            return
        points, turned = positions(models), turns(models)
        remaining, newest = math.exp(-max(0.0, moment - last) / FORGETTING_TIME), self.model.now
        model, half = self.model, 0.5 * self.model.spacing
        self._position.add(travel.displacement, remaining, points, newest.path)
        self._heading.add(complex(travel.turn), remaining, turned, newest.turning)
        self._excess.add(travel.displacement, remaining, points, newest.path)
        if gap or moment - last < 0.5 * self._period:  # the latter: read at once after a pause
            self._excess.excuse(travel.displacement)
        if gap:
            self._position.excuse(travel.displacement)
            self._heading.excuse(complex(travel.turn))
            self._begin_window(moment, models)
        self.state.doubt = self._position.judge(
            moment, points, newest.path, lambda: half * model.fastest.speed, POSITION_FAULTS
        )
        self.state.doubt = self.state.doubt or self._excess.excess(moment, newest.path, MotionFault.CARRIED)
        if self._has_heading and self.state.doubt is None:
            self.state.doubt = self._heading.judge(
                moment, turned, newest.turning, lambda: half * model.fastest.turn_rate, HEADING_FAULTS
            )
        if self._has_speeds and not gap and self.state.doubt is None:
            self.state.doubt = self._contradiction(moment, travel, models)
        if self._position.shows_motion(points, newest.path):
            self._position.begin(moment, points, path_at(models[HALF_DELAY_INDEX]))
            self.state.confirmed += 1
        self._limit_excess(moment, models)
        if self._heading.shows_motion(turned, newest.turning):
            self._heading.begin(moment, turned, turning_at(models[HALF_DELAY_INDEX]))

    def _limit_excess(self, moment: float, models: Sequence[Between]) -> None:
        """Sum up motion anew once `EXCESS_DISTANCE` was commanded."""
        if self.model.now.path - self._excess.state.path_before > EXCESS_DISTANCE:
            self._excess.begin(moment, positions(models), path_at(models[HALF_DELAY_INDEX]))

    def _check_delay(self, moment: float, travel: Travel | None, limit: float) -> None:
        """Doubt measurements that come later than `limit` [s], also where they seem frozen."""
        if travel is None:
            self._delay.interrupt()
            return
        counts, doubt = self._delay.add(moment, travel.displacement, self.model), self.state.doubt
        if counts and (doubt is None or doubt.kind is MotionFault.FROZEN):
            delay = self._delay.judge(limit)
            if delay is not None:
                self.state.doubt = Disagreement(MotionFault.LATE, limit, delay, 0.0)

    def _begin(self, moment: float, models: Sequence[Between]) -> None:
        self._position.begin(moment, positions(models), path_at(models[HALF_DELAY_INDEX]))
        self._heading.begin(moment, turns(models), turning_at(models[HALF_DELAY_INDEX]))
        self._excess.begin(moment, positions(models), path_at(models[HALF_DELAY_INDEX]))
        self._begin_window(moment, models)

    def _resume(self, travel: Travel | None) -> None:
        """Continue the legs of the agent before, unless the way since then is unknown."""
        earlier, self.state.earlier = self.state.earlier, None
        if earlier is not None and travel is not None:
            self._position.resume(earlier.position, travel.displacement)
            self._heading.resume(earlier.heading, complex(travel.turn))

    def _begin_window(self, moment: float, models: Sequence[Between]) -> None:
        self.state.window = SpeedWindow(began=moment, ahead_before=[ahead_at(one) for one in models])

    def _contradiction(self, moment: float, travel: Travel, models: Sequence[Between]) -> Disagreement | None:
        """How odometry's speeds contradict its positions, or the commands."""
        window = self.state.window
        half = rotation(0.5 * travel.turn)
        window.by_speeds += travel.distance * half * window.facing
        window.facing *= half * half
        window.by_positions += travel.displacement
        window.reported += travel.distance
        window.least, window.most = min(window.least, travel.distance), max(window.most, travel.distance)
        by_speeds, by_positions = abs(window.by_speeds), abs(window.by_positions)
        over, most = moment - window.began, max(by_speeds, by_positions)
        if most < SPEED_WINDOW_DISTANCE or over < MIN_SPEED_WINDOW_TIME:
            if over > FORGETTING_TIME:
                self._begin_window(moment, models)
            return None
        went = [ahead_at(one) - before for one, before in zip(models, window.ahead_before, strict=True)]
        opposite = min(-math.copysign(1.0, window.reported) * one for one in went)
        reported, changed = window.reported, window.most - window.least
        self._begin_window(moment, models)
        if opposite > MAX_REVERSED_DISTANCE and abs(reported) > MAX_REVERSED_DISTANCE:
            return Disagreement(MotionFault.SPEEDS, -math.copysign(by_positions, reported), reported, over)
        # a speed is of one moment, a position integrates an interval: half of one is no fault
        if abs(by_speeds - by_positions) > (1.0 - MIN_MOTION_SHARE) * most + 0.5 * changed:
            return Disagreement(MotionFault.SPEEDS, by_positions, by_speeds, over)
        return None
