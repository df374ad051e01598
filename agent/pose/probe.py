"""A small motion that shows whether a robot moves as commanded again; without a clock.

Stand and measure, move a little, stand and measure again, twice. The mean of many measurements before and
after is far more precise than one measurement. A probe that is not seen is repeated later and shorter: waits
double, lengths shrink, so that all probes together stay below `MAX_PROBE_DISTANCE`, however long the fault
lasts. Measurements are averaged until their mean is precise enough for the probe, within limits that grow
with the waits.
A try counts when its motion begins, so that one which is interrupted counts too. The motion must be seen as
soon as measurements may be old, and nothing may move afterwards: a late sensor shows all of it, but later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

from formation.agent.pose.motion_check import MAX_MOTION_RATIO, MIN_MOTION_SHARE, Disagreement
from formation.agent.pose.motion_model import Modelled
from formation.control.controller import Limits
from formation.control.observer import Travel
from formation.control.unicycle import Command
from formation.protocol.status import MotionFault

LENGTH, TURN = 0.015, 0.15
"""Size of the first probe [m; rad]."""
PROBE_LENGTH_RATIO = 0.75
"""Length of each probe as a share of the one before."""
MAX_PROBE_DISTANCE = LENGTH / (1.0 - PROBE_LENGTH_RATIO)
"""Length of all probes together [m]."""
PROBE_SPEED_SHARE = 0.05
"""Speed of a probe as a share of the robot's top speed."""
FIRST_WAIT = 1.0
"""Before the first probe [s]; twice as long before each following one."""
MAX_DOUBLINGS = 12
"""How often the wait doubles, to little more than an hour."""
MIN_AVERAGING_TIME = 0.5
"""Shortest time over which measurements are averaged [s]."""
LEAST_PRECISE_TIME = 2.0
"""Time before which a mean does not count as precise [s]: noise may change more slowly than it shows."""
AVERAGING_SHARE = 0.125
"""Longest time over which measurements are averaged, as a share of the wait before the probe."""
MAX_PROBE_TIME = 4.0
"""Longest duration of a probe [s]: the collision filter may leave it no room."""
MIN_MOVED_SHARE = 0.5
"""Share of a probe that was commanded, below which it had no room."""
SEEN_DEVIATIONS = 4.0
"""Number of standard errors from which a probe counts as seen."""
MAX_LATER_SHARE = 0.2
"""Share of a probe that may be seen while the robot has long been standing again."""
REVIVAL_MOTION = 0.02
"""Motion of the sensor, while the robot stands, that shows it works: probes start afresh [m]."""


TURNS = frozenset((MotionFault.TURN, MotionFault.TURNED))
"""Faults that a turn in place shows."""


class Phase(StrEnum):
    """What the probe is doing."""

    OFF = "off"
    WAITS = "waits"
    BEFORE = "before"
    MOVES = "moves"
    SETTLES = "settles"
    AFTER = "after"
    STANDS = "stands"


@dataclass(slots=True)
class Mean:
    """Mean and scatter of positions [m] and headings [rad], both from where the probing began."""

    count: int = 0
    position: complex = 0j
    heading: float = 0.0
    squares: float = 0.0
    """Sum of squared deviations of the positions [m²]."""
    turn_squares: float = 0.0
    """Sum of squared deviations of the headings [rad²]."""

    def add(self, position: complex, heading: float) -> None:
        """Add a measurement (Welford's update)."""
        self.count += 1
        off, turned = position - self.position, heading - self.heading
        self.position += off / self.count
        self.heading += turned / self.count
        self.squares += (off.conjugate() * (position - self.position)).real
        self.turn_squares += turned * (heading - self.heading)

    def errors(self) -> tuple[float, float]:
        """Standard error of both means, per axis [m; rad]; infinite for fewer than three measurements."""
        if self.count < 3:
            return math.inf, math.inf
        freedom = self.count * (self.count - 1)
        return math.sqrt(0.5 * self.squares / freedom), math.sqrt(self.turn_squares / freedom)


@dataclass(slots=True)
class Sum:
    """Integrals over a probe's motion and the settling after it, of the measurements and of the model."""

    last: tuple[float, complex, float, float, float] | None = None
    """Newest moment [s, monotonic]; position [m], heading [rad], and the model's path [m] and turn [rad]."""
    over: float = 0.0
    """Time [s]."""
    position: complex = 0j
    """[m·s]"""
    heading: float = 0.0
    """[rad·s]"""
    ahead: float = 0.0
    """Of the model's signed path length [m·s]."""
    turn: float = 0.0
    """Of the model's signed turn [rad·s]."""

    def add(self, moment: float, position: complex, heading: float, ahead: float, turn: float) -> None:
        """Add a measurement at `moment` [s, monotonic], and the model then (trapezoids)."""
        if self.last is not None:
            then, was, faced, went, turned = self.last
            half = 0.5 * (moment - then)
            self.over += 2.0 * half
            self.position += half * (was + position)
            self.heading += half * (faced + heading)
            self.ahead += half * (went + ahead)
            self.turn += half * (turned + turn)
        self.last = moment, position, heading, ahead, turn


@dataclass(slots=True, kw_only=True)
class ProbeState:
    """How far the probing is."""

    phase: Phase = Phase.OFF
    tries: int = 0
    """Probes since the robot was last seen to move, from the beginning of their motion on."""
    since: float = 0.0
    """When the phase began [s, monotonic]."""
    at: complex = 0j
    """Motion by the sensor since the probing began [m]."""
    facing: float = 0.0
    """Turn by the sensor since the probing began [rad]."""
    reported: float = 0.0
    """Signed path length by the reported speeds since the measuring before [m]."""
    before: Mean = field(default_factory=Mean)
    """Measurements before the probe."""
    after: Mean = field(default_factory=Mean)
    """Measurements after the probe."""
    stands: Mean = field(default_factory=Mean)
    """Measurements after those, while it still stands."""
    motion: Sum = field(default_factory=Sum)
    """The probe's motion."""
    direction: float = 1.0
    """Sign of the probe."""
    began: tuple[float, float] = 0.0, 0.0
    """Signed path length [m] and turn [rad] of the model when the probe began."""
    expected: tuple[float, float] = 0.0, 0.0
    """Signed path length [m] and turn [rad] of the probe."""
    free: float | None = None
    """Least distance to what was beside the robot when the newest probe began to move [m]; None before."""
    blocked: bool = False
    """Whether the newest probe had no room: the collision filter or the protective zones stopped it."""


class Probe:
    """One robot's probes."""

    def __init__(self, limits: Limits, steps: Command, longest_delay: float) -> None:
        """`steps` is the resolution of commands; the robot follows them within `longest_delay` [s]."""
        self.state = ProbeState()
        self._speed = max(PROBE_SPEED_SHARE * limits.max_speed, steps.speed)
        self._turn_rate = max(PROBE_SPEED_SHARE * limits.max_turn_rate, steps.turn_rate)
        self._settling = longest_delay + 0.2

    @property
    def moves(self) -> bool:
        """Whether the robot is to move now."""
        return self.state.phase is Phase.MOVES

    def rearm(self) -> None:
        """Start with the first probe: the robot was seen to move, or an operator has checked it."""
        if self.state.tries:
            self.state.tries, self.state.phase, self.state.blocked = 0, Phase.OFF, False

    def begin(self) -> None:
        """Start the next wait anew: the robot's motion is doubted from now on."""
        self.state.phase, self.state.blocked = Phase.OFF, False

    def interrupt(self) -> None:
        """End the probe: the robot may not move. A wait goes on; it is over if only measuring was cut off."""
        state = self.state
        if state.phase is Phase.BEFORE:
            state.phase, state.since = Phase.WAITS, float("-inf")
        elif state.phase is not Phase.WAITS:
            state.phase = Phase.OFF

    def saw(self, moment: float, travel: Travel | None, model: Modelled) -> None:
        """Process a measurement that arrived at `moment` [s, monotonic], and the motion since the one before.

        None if that is unknown.
        """
        state = self.state
        if travel is None:
            self.interrupt()
            return
        state.at += travel.displacement
        state.facing += travel.turn
        state.reported += travel.distance
        if state.phase is Phase.BEFORE:
            state.before.add(state.at, state.facing)
        elif state.phase is Phase.AFTER:
            state.after.add(state.at, state.facing)
        elif state.phase is Phase.STANDS:
            state.stands.add(state.at, state.facing)
        if state.phase in {Phase.BEFORE, Phase.MOVES, Phase.SETTLES}:
            if state.phase is Phase.BEFORE:
                state.motion = Sum()
            state.motion.add(moment, state.at, state.facing, model.ahead, model.turn)

    def step(self, moment: float, doubt: Disagreement, model: Modelled, wanted: Command) -> Command:
        """Continue at `moment` [s, monotonic]; return the command, in the law's direction.

        After a probe that had no room the next one goes the other way.
        """
        state = self.state
        over = moment - state.since
        turns = doubt.kind in TURNS
        if state.phase is Phase.OFF:
            self._enter(Phase.WAITS, moment)
        elif state.phase is Phase.WAITS and over >= _wait(state.tries) - MIN_AVERAGING_TIME:
            self._look(moment)
        elif state.phase is Phase.BEFORE and _is_precise(state.before, over, state.tries, turns=turns):
            wish = wanted.turn_rate if turns else wanted.speed
            forward = -1.0 if wish < 0.0 else 1.0
            state.direction = -state.direction if state.blocked else forward
            state.began, state.free = (model.ahead, model.turn), None
            state.tries += 1  # also counts one that is interrupted or seen, until the robot is seen to move
            self._enter(Phase.MOVES, moment)
        elif state.phase is Phase.MOVES:
            done = (
                abs(model.turn - state.began[1]) / TURN
                if turns
                else abs(model.ahead - state.began[0]) / LENGTH
            )
            enough = PROBE_LENGTH_RATIO ** (state.tries - 1)
            if done >= enough or over >= MAX_PROBE_TIME:
                state.blocked = done < MIN_MOVED_SHARE * enough
                state.expected = model.ahead - state.began[0], model.turn - state.began[1]
                self._enter(Phase.SETTLES, moment)
        elif state.phase is Phase.SETTLES and over >= self._settling:
            self._enter(Phase.AFTER, moment)
        elif state.phase is Phase.AFTER and _is_precise(state.after, over, state.tries - 1, turns=turns):
            self._enter(Phase.STANDS, moment)
        if not self.moves:
            return Command(0.0, 0.0)
        if turns:
            return Command(0.0, state.direction * self._turn_rate)
        return Command(state.direction * self._speed, 0.0)

    def kept(self, free: float) -> float:
        """Return the distance that this probe keeps to what is beside it: `free` at its first call [m]."""
        if self.state.free is None:
            self.state.free = free
        return self.state.free

    def verdict(self, moment: float, doubt: Disagreement, limit: float, *, speeds: bool) -> bool | None:
        """Whether the newest probe was seen at most `limit` [s] later; None if undecided.

        `speeds`: they are reported.
        """
        state = self.state
        over, turns = moment - state.since, doubt.kind in TURNS
        if state.phase is not Phase.STANDS or not _is_precise(
            state.stands, over, state.tries - 1, turns=turns
        ):
            return None
        self._enter(Phase.WAITS, moment)
        return self._seen(doubt, speeds=speeds) and self._delay(doubt) <= limit

    def _seen(self, doubt: Disagreement, *, speeds: bool) -> bool:
        state = self.state
        (error, turn_error), (error_after, turn_error_after) = state.before.errors(), state.after.errors()
        if doubt.kind in TURNS:
            expected, unsure = state.expected[1], SEEN_DEVIATIONS * math.hypot(turn_error, turn_error_after)
            later = abs(state.stands.heading - state.after.heading)
            if later > max(MAX_LATER_SHARE * abs(expected), unsure):
                return False
            return _follows(state.after.heading - state.before.heading, expected, unsure)
        most = MAX_MOTION_RATIO if doubt.kind is MotionFault.CARRIED else 1.0 / MIN_MOTION_SHARE
        expected, unsure = state.expected[0], SEEN_DEVIATIONS * math.hypot(error, error_after)
        if abs(state.stands.position - state.after.position) > max(MAX_LATER_SHARE * abs(expected), unsure):
            return False
        moved = abs(state.after.position - state.before.position)
        if speeds and not _follows(state.reported, expected, 0.0):
            return False
        return _follows(math.copysign(moved, expected), expected, unsure, most)

    def _delay(self, doubt: Disagreement) -> float:
        """Mean time from the motion of the model to that of the sensor, in the newest probe [s]."""
        state, motion = self.state, self.state.motion
        if doubt.kind in TURNS:
            seen = state.after.heading - state.before.heading
            shown = (motion.heading - state.before.heading * motion.over) / seen
            return (motion.turn - state.began[1] * motion.over) / state.expected[1] - shown
        moved = state.after.position - state.before.position
        shown = ((motion.position - state.before.position * motion.over) / moved).real
        return (motion.ahead - state.began[0] * motion.over) / state.expected[0] - shown

    def _look(self, moment: float) -> None:
        """Measure where the robot is before a probe."""
        state = self.state
        last, state.before, state.after, state.reported = state.after, Mean(), Mean(), 0.0
        state.stands = Mean()
        if last.count and abs(state.at - last.position) > REVIVAL_MOTION:
            state.tries = 0
        self._enter(Phase.BEFORE, moment)

    def _enter(self, phase: Phase, moment: float) -> None:
        self.state.phase, self.state.since = phase, moment


def _wait(tries: int) -> float:
    """Time before the next probe after so many [s]."""
    return FIRST_WAIT * 2.0 ** min(tries, MAX_DOUBLINGS)


def _is_precise(mean: Mean, over: float, tries: int, *, turns: bool) -> bool:
    """Whether two such means show the probe after so many, or `mean` has taken its longest time [s]."""
    longest = max(MIN_AVERAGING_TIME, AVERAGING_SHARE * _wait(tries))
    if over < min(longest, LEAST_PRECISE_TIME) or over >= longest:
        return over >= longest
    error, turn_error = mean.errors()
    length = PROBE_LENGTH_RATIO**tries * (TURN if turns else LENGTH)
    return SEEN_DEVIATIONS * math.sqrt(2.0) * (turn_error if turns else error) <= MIN_MOTION_SHARE * length


def _follows(seen: float, expected: float, unsure: float, most: float = 1.0 / MIN_MOTION_SHARE) -> bool:
    """Whether `seen` has the direction of `expected`, about its size, and is significant.

    It is at most `most` times as much.
    """
    along = seen * math.copysign(1.0, expected)
    least = max(MIN_MOTION_SHARE * abs(expected), unsure)
    return expected != 0.0 and least <= along <= most * abs(expected) + unsure
