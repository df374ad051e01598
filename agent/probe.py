"""A small motion that shows whether a robot moves as it is told again; without a clock.

Stand and measure, move a little, stand and measure again. The mean of many measurements before and after
resolves far less than one measurement does. A probe that is not seen is repeated later and shorter: waits
double, lengths shrink, so that all probes together stay below `MAX_WAY`, however long the fault lasts.
"""

from __future__ import annotations

import math
from enum import StrEnum

from agent.motion_check import SHARE, Disagreement, Kind
from agent.motion_model import Modelled
from formation.heading import Travel
from formation.law import Limits
from formation.unicycle import Command

LENGTH, TURN = 0.015, 0.15
"""Of the first probe [m; rad]."""
SHRINKS = 0.75
"""Length of each probe as a share of the one before."""
MAX_WAY = LENGTH / (1.0 - SHRINKS)
"""Way of all probes together [m]."""
SLOWNESS = 0.05
"""Speed of a probe as a share of the robot's top speed."""
FIRST_WAIT = 1.0
"""Before the first probe [s]; twice as long before each following one."""
LONGEST_WAIT = 3600.0
"""[s]"""
LOOK = 0.5
"""Time over which measurements are averaged [s]."""
MOVES_AT_MOST = 4.0
"""After so long a probe ends in any case [s]: the collision filter may leave it no room."""
SIGMA = 4.0
"""A probe is seen from so many standard errors on."""
REVIVED = 0.02
"""A sensor that has moved by more while the robot stood is alive: probes begin anew [m]."""


TURNS = frozenset((Kind.TURN, Kind.TURNED))
"""What a turn in place shows."""


class Phase(StrEnum):
    """What the probe is doing."""

    OFF = "off"
    WAITS = "waits"
    BEFORE = "before"
    MOVES = "moves"
    SETTLES = "settles"
    AFTER = "after"


class Mean:
    """Mean and scatter of positions [m] and headings [rad], both from where the probing began."""

    def __init__(self) -> None:
        self.count = 0
        self.position, self.heading = 0j, 0.0
        self._squares, self._turn_squares = 0.0, 0.0  # sums of squared deviations

    def add(self, position: complex, heading: float) -> None:
        """One more measurement (Welford's update)."""
        self.count += 1
        off, turned = position - self.position, heading - self.heading
        self.position += off / self.count
        self.heading += turned / self.count
        self._squares += (off.conjugate() * (position - self.position)).real
        self._turn_squares += turned * (heading - self.heading)

    def errors(self) -> tuple[float, float]:
        """Standard error of both means, per axis [m; rad]; infinite for fewer than three measurements."""
        if self.count < 3:
            return math.inf, math.inf
        freedom = self.count * (self.count - 1)
        return math.sqrt(0.5 * self._squares / freedom), math.sqrt(self._turn_squares / freedom)


class Probe:
    """One robot's probes."""

    def __init__(self, limits: Limits, steps: Command, longest_delay: float) -> None:
        """`steps` are what the robot cuts commands to; it follows them within `longest_delay` [s]."""
        self.phase = Phase.OFF
        self.tries = 0
        """Probes since the robot was last seen to move."""
        self._speed = max(SLOWNESS * limits.max_speed, steps.speed)
        self._turn_rate = max(SLOWNESS * limits.max_turn_rate, steps.turn_rate)
        self._settling = longest_delay + 0.2
        self._since = 0.0  # when the phase began [s, monotonic]
        self._at, self._facing = 0j, 0.0  # by the sensor since the probing began [m; rad]
        self._reported = 0.0  # signed way by reported speeds since the measuring before [m]
        self._before, self._after = Mean(), Mean()
        self._direction = 1.0
        self._began = 0.0, 0.0  # signed way and turn of the model when the probe began [m; rad]
        self._asked = 0.0, 0.0  # of the probe [m; rad]

    @property
    def moves(self) -> bool:
        """Whether the robot is to move just now."""
        return self.phase is Phase.MOVES

    def rearm(self) -> None:
        """Begin anew with the first probe: the robot was seen to move, or an operator had a look."""
        if self.tries:
            self.tries, self.phase = 0, Phase.OFF

    def interrupt(self) -> None:
        """The robot may not move: begin the wait anew."""
        self.phase = Phase.OFF

    def saw(self, travel: Travel | None) -> None:
        """A measurement arrived; None where it is unknown how the robot came there."""
        if travel is None:
            self.interrupt()
            return
        self._at += travel.displacement
        self._facing += travel.turn
        self._reported += travel.distance
        if self.phase is Phase.BEFORE:
            self._before.add(self._at, self._facing)
        elif self.phase is Phase.AFTER:
            self._after.add(self._at, self._facing)

    def step(self, moment: float, doubt: Disagreement, model: Modelled, wanted: Command) -> Command:
        """Go on at `moment` [s, monotonic]; the command, towards where the law wants to go."""
        over = moment - self._since
        turns = doubt.kind in TURNS
        if self.phase is Phase.OFF:
            self._enter(Phase.WAITS, moment)
        elif self.phase is Phase.WAITS and over >= min(LONGEST_WAIT, FIRST_WAIT * 2.0**self.tries) - LOOK:
            self._look(moment)
        elif self.phase is Phase.BEFORE and over >= LOOK:
            wish = wanted.turn_rate if turns else wanted.speed
            self._direction = -1.0 if wish < 0.0 else 1.0
            self._began = model.ahead, model.turn
            self._enter(Phase.MOVES, moment)
        elif self.phase is Phase.MOVES:
            done = (
                abs(model.turn - self._began[1]) / TURN
                if turns
                else abs(model.ahead - self._began[0]) / LENGTH
            )
            if done >= SHRINKS**self.tries or over >= MOVES_AT_MOST:
                self._asked = model.ahead - self._began[0], model.turn - self._began[1]
                self._enter(Phase.SETTLES, moment)
        elif self.phase is Phase.SETTLES and over >= self._settling:
            self._enter(Phase.AFTER, moment)
        if not self.moves:
            return Command(0.0, 0.0)
        if turns:
            return Command(0.0, self._direction * self._turn_rate)
        return Command(self._direction * self._speed, 0.0)

    def verdict(self, moment: float, doubt: Disagreement, *, speeds: bool) -> bool | None:
        """Whether the newest probe was seen; None while there is no answer. `speeds`: they are reported."""
        if self.phase is not Phase.AFTER or moment - self._since < LOOK:
            return None
        self.tries += 1  # of one that was seen as well, until the robot is seen to move
        self._enter(Phase.WAITS, moment)
        return self._seen(doubt, speeds=speeds)

    def _seen(self, doubt: Disagreement, *, speeds: bool) -> bool:
        (error, turn_error), (error_after, turn_error_after) = self._before.errors(), self._after.errors()
        if doubt.kind in TURNS:
            asked, unsure = self._asked[1], SIGMA * math.hypot(turn_error, turn_error_after)
            return _follows(self._after.heading - self._before.heading, asked, unsure)
        asked, unsure = self._asked[0], SIGMA * math.hypot(error, error_after)
        moved = abs(self._after.position - self._before.position)
        if speeds and not _follows(self._reported, asked, 0.0):
            return False
        return _follows(math.copysign(moved, asked), asked, unsure)

    def _look(self, moment: float) -> None:
        """Measure where the robot is before a probe."""
        last, self._before, self._after, self._reported = self._after, Mean(), Mean(), 0.0
        if last.count and abs(self._at - last.position) > REVIVED:
            self.tries = 0
        self._enter(Phase.BEFORE, moment)

    def _enter(self, phase: Phase, moment: float) -> None:
        self.phase, self._since = phase, moment


def _follows(seen: float, asked: float, unsure: float) -> bool:
    """Whether `seen` is in the direction of `asked`, about as far, and more than chance can make it."""
    along = seen * math.copysign(1.0, asked)
    least = max(SHARE * abs(asked), unsure)
    return asked != 0.0 and least <= along <= abs(asked) / SHARE + unsure
