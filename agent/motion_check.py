"""Does the robot move as it is told? Its commands against its sensor, without a clock.

Net displacement counts, not path length: a sensor that trembles around one place shows no motion. A leg is
what was commanded and what was seen since the sensor last showed motion. It is compared for several delays
between command and sensor, and no delay that is possible may explain the difference:

    FROZEN    commanded more than NET_MIN, seen less than SHARE of it; or commanded more than STILL_MIN, and
              every position so far within STILL
    TURN      the same for the heading, where the sensor measures one
    SPEEDS    odometry's own speeds and positions disagree, or its speeds have the wrong sign
    CARRIED   seen more than EXCESS times what was commanded, plus a tolerance
    TURNED    the same for the heading

Noise up to 5 mm (standard deviation), delays up to `MAX_DELAY` plus the robot's lag and one period, and
slip up to half of the way do not add up to a disagreement. A disagreement holds until a probe is seen
(`agent.probe`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

from agent.motion_model import DELAYS, Modelled, MotionModel
from formation.heading import Travel
from formation.mission import Mission
from formation.plane import rotation
from formation.unicycle import Command

MAX_DELAY = 0.15
"""Way of a command to the wheels and of a measurement back that is no fault [s]."""
SHARE = 0.4
"""Share of the commanded motion below which the robot does not move as told."""
EXCESS = 1.5
"""A robot may seem to move so many times as far as it was told."""
MEMORY = 20.0
"""Time constant with which a leg is forgotten [s]: small errors of the model do not add up for ever."""
SPEED_WINDOW = 0.1
"""Odometry's speeds are compared with its positions each time that either has made so much way [m]."""
MIN_SPEED_WINDOW = 0.4
"""… but not sooner than after so long [s]."""
WRONG_SIGN = 0.05
"""Reported way against the commanded direction that is no fault [m]."""


class Kind(StrEnum):
    """What disagrees."""

    FROZEN = "frozen"
    TURN = "turn"
    SPEEDS = "speeds"
    CARRIED = "carried"
    TURNED = "turned"


class Disagreement(NamedTuple):
    """What was expected of a robot, and what was seen."""

    kind: Kind
    expected: float
    """By its commands (SPEEDS: by the positions) [m; TURN and TURNED: rad]."""
    seen: float
    """By its sensor (SPEEDS: by the reported speeds) [the same unit]."""
    over: float
    """Time between [s]."""


class Tolerance(NamedTuple):
    """Of one leg; lengths [m], or angles [rad]."""

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


class Leg:
    """Commanded and seen motion since the sensor last showed motion."""

    def __init__(self, tolerance: Tolerance) -> None:
        self.seen = 0j
        """Net motion [m or rad]."""
        self._tolerance = tolerance
        self._origins = [0j] * DELAYS  # where the model was, by delay, when the leg began
        self._path_before = 0.0  # path of the model then, one longest delay ago
        self._farthest = 0.0
        self._began = float("-inf")

    def begin(self, moment: float, models: Sequence[complex], path_before: float) -> None:
        """Forget what was."""
        self.seen, self._farthest, self._began = 0j, 0.0, moment
        self._origins, self._path_before = list(models), path_before

    def add(self, seen: complex, kept: float, models: Sequence[complex], path: float) -> None:
        """One more interval; all that was before counts only as the share `kept`."""
        self.seen = kept * self.seen + seen
        self._origins = [now + kept * (was - now) for now, was in zip(models, self._origins, strict=True)]
        self._path_before = path + kept * (self._path_before - path)
        self._farthest = max(self._farthest, abs(self.seen))

    def least(self, models: Sequence[complex]) -> float:
        """Commanded net motion, with the delay that makes it least."""
        return min(abs(now - was) for now, was in zip(models, self._origins, strict=True))

    def judge(
        self, moment: float, models: Sequence[complex], path: float, slack: float, kinds: tuple[Kind, Kind]
    ) -> Disagreement | None:
        """What disagrees; `slack` is what the model may be off between two delays.

        `kinds` name too little and too much motion.
        """
        limits, seen, least = self._tolerance, abs(self.seen), self.least(models)
        over = moment - self._began
        still = least > limits.still_min + slack and self._farthest < limits.still
        if still or (least > limits.net_min + slack and seen < SHARE * least):
            return Disagreement(kinds[0], least, seen, over)
        most = path - self._path_before
        if seen > EXCESS * most + limits.carried:
            return Disagreement(kinds[1], most, seen, over)
        return None

    def shows_motion(self, models: Sequence[complex], path: float) -> bool:
        """Whether so much is seen that the leg may end: some, and no more than was commanded."""
        seen = abs(self.seen)
        enough = seen > self._tolerance.moved and seen > SHARE * self.least(models)
        return enough and seen <= EXCESS * (path - self._path_before) + self._tolerance.moved


class MotionCheck:
    """Compares one robot's commands with what its sensor shows."""

    def __init__(self, mission: Mission, robot: str) -> None:
        spec = mission.robots[robot]
        self.doubt: Disagreement | None = None
        """The disagreement that has not been disproved yet."""
        self.confirmed = 0
        """How many legs have shown motion since the doubt before was disproved."""
        period = 1.0 / spec.rate
        self.model = MotionModel(MAX_DELAY + period + mission.collisions.lag, spec.longest_command)
        self._has_speeds = spec.localisation == "odometry"
        self._has_heading = self._has_speeds or spec.heading == "measured"
        self._position, self._heading = Leg(POSITION), Leg(HEADING)
        self._last: float | None = None  # newest interval's end [s, monotonic]
        self._facing = 1.0 + 0.0j  # by the sensor, since the window of speeds began
        self._by_speeds, self._by_positions = 0j, 0j  # net way in it [m]
        self._reported = 0.0  # signed way in it [m]
        self._ahead_before = [0.0] * DELAYS  # of the model when it began [m]
        self._window_began = 0.0  # [s, monotonic]

    def told(self, moment: float, command: Command) -> None:
        """The robot was sent `command` at `moment` [s, monotonic]."""
        self.model.told(moment, command)

    def trust(self) -> None:
        """The disagreement was disproved."""
        self.doubt, self._last, self.confirmed = None, None, 0

    def saw(self, moment: float, travel: Travel | None) -> None:
        """A measurement arrived at `moment` [s, monotonic]: how the robot came there, None if unknown."""
        self.model.go_to(moment)
        if self.doubt is not None:
            return
        models = self.model.delayed()
        last, self._last = self._last, moment
        if travel is None or last is None:
            self._begin(moment, models)
            return
        points, turns = [one.position for one in models], [complex(one.turn) for one in models]
        kept, newest = math.exp(-max(0.0, moment - last) / MEMORY), models[0]
        fastest, spacing = self.model.fastest, self.model.spacing
        self._position.add(travel.displacement, kept, points, newest.path)
        self._heading.add(complex(travel.turn), kept, turns, newest.turning)
        slack, turn_slack = 0.5 * spacing * fastest.speed, 0.5 * spacing * fastest.turn_rate
        self.doubt = self._position.judge(moment, points, newest.path, slack, (Kind.FROZEN, Kind.CARRIED))
        if self._has_heading and self.doubt is None:
            self.doubt = self._heading.judge(
                moment, turns, newest.turning, turn_slack, (Kind.TURN, Kind.TURNED)
            )
        if self._has_speeds and self.doubt is None:
            self.doubt = self._contradiction(moment, travel, models)
        if self._position.shows_motion(points, newest.path):
            self._position.begin(moment, points, models[-1].path)
            self.confirmed += 1
        if self._heading.shows_motion(turns, newest.turning):
            self._heading.begin(moment, turns, models[-1].turning)

    def _begin(self, moment: float, models: Sequence[Modelled]) -> None:
        """Begin all legs here."""
        self._position.begin(moment, [one.position for one in models], models[-1].path)
        self._heading.begin(moment, [complex(one.turn) for one in models], models[-1].turning)
        self._begin_window(moment, models)

    def _begin_window(self, moment: float, models: Sequence[Modelled]) -> None:
        self._facing, self._by_speeds, self._by_positions, self._reported = 1.0 + 0.0j, 0j, 0j, 0.0
        self._ahead_before, self._window_began = [one.ahead for one in models], moment

    def _contradiction(
        self, moment: float, travel: Travel, models: Sequence[Modelled]
    ) -> Disagreement | None:
        """What odometry's speeds say against its positions, or against the commands."""
        half = rotation(0.5 * travel.turn)
        self._by_speeds += travel.distance * half * self._facing
        self._facing *= half * half
        self._by_positions += travel.displacement
        self._reported += travel.distance
        by_speeds, by_positions = abs(self._by_speeds), abs(self._by_positions)
        over, most = moment - self._window_began, max(by_speeds, by_positions)
        if most < SPEED_WINDOW or over < MIN_SPEED_WINDOW:
            if over > MEMORY:
                self._begin_window(moment, models)
            return None
        ahead = [one.ahead - before for one, before in zip(models, self._ahead_before, strict=True)]
        opposite = min(-math.copysign(1.0, self._reported) * one for one in ahead)
        reported = self._reported
        self._begin_window(moment, models)
        if opposite > WRONG_SIGN and abs(reported) > WRONG_SIGN:
            return Disagreement(Kind.SPEEDS, -math.copysign(by_positions, reported), reported, over)
        if abs(by_speeds - by_positions) > (1.0 - SHARE) * most:
            return Disagreement(Kind.SPEEDS, by_positions, by_speeds, over)
        return None
