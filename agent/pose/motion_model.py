"""Dead reckoning of the commands, and how late the sensor shows what was commanded; without a clock.

The model uses no sensor, and is the reference of `formation.agent.pose.motion_check`. A robot follows its
commands late, by an unknown delay of up to `longest` [s] (its wheels' lag, the delay of the command, the
delay of the measurement), so every comparison is made for several delays in between.

`OwnDelay` estimates that delay, whatever stamps say: a driver that stamps on publication hides how old its
measurements are, but speeds that vary appear in the positions after the delay. Over a few seconds, the
distance between two positions `WINDOW_TIME` apart is fitted by that of the dead reckoning, for every delay on
a grid, with a factor for slip. Where no delay up to the limit fits, and a longer one does, measurements are
late. Steady motion fits every delay, and proves nothing.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from formation.control.unicycle import AT_REST, Command, along

DELAY_COUNT = 7
"""Number of delays for which the commands are compared, evenly from none to the longest."""
SPACING = 0.05
"""Time between two delays on the grid [s]."""
GRID_COUNT = 25
"""Number of delays on the grid, from none on."""
WINDOW_STEPS = 8
WINDOW_TIME = WINDOW_STEPS * SPACING
"""Time between the two positions of each fitted distance [s]."""
LOOKBACK_COUNT = GRID_COUNT + WINDOW_STEPS
"""Number of states of the dead reckoning that are needed, `SPACING` apart."""
KEPT_TIME = LOOKBACK_COUNT * SPACING
"""Time over which the dead reckoning is needed [s]."""
FADING_TIME = 5.0
"""Time constant with which earlier distances are forgotten [s]."""
FIT_RATIO = 4.0
"""The best delay beyond the limit fits so many times better than the best one within it."""
MIN_MISFIT = 0.02
"""Root mean square by which delays within the limit must miss [m]."""
NOISE_DEVIATIONS = 2.0
"""The same in standard deviations of stated noise."""
MIN_FIT = 0.8
"""Share of the variation that a delay must explain to count as seen."""
MIN_COUNT = 8.0
"""Number of distances from which on they are judged."""


class Held(NamedTuple):
    """A command, or measured speeds, that last from a moment on [s, monotonic] until the next."""

    since: float
    command: Command


def forget(history: deque[Held], before: float) -> None:
    """Drop what ended before then [s, monotonic]."""
    while len(history) > 1 and history[1].since < before:
        history.popleft()


def spans(history: deque[Held], begin: float, end: float) -> Iterator[tuple[float, Command]]:
    """Yield durations [s] and what held, from `end` back to `begin` [s, monotonic]."""
    for since, command in reversed(history):
        if end <= begin:
            return
        time = end - max(since, begin)
        if time > 0.0:
            yield time, command
        end = min(end, since)


class Modelled(NamedTuple):
    """State of the dead reckoning at one moment; all values count from when the agent started."""

    moment: float
    """[s, monotonic]"""
    position: complex
    """[m; frame of the first heading]"""
    heading: complex
    """Unit complex [same frame]."""
    ahead: float
    """Signed path length [m]."""
    turn: float
    """Signed turn [rad]."""
    path: float
    """Path length [m]."""
    turning: float
    """Sum of the turn's absolute value [rad]."""


START = Modelled(float("-inf"), 0j, 1.0 + 0.0j, 0.0, 0.0, 0.0, 0.0)


@dataclass(slots=True, kw_only=True)
class MotionModelState:
    """The newest command, and where the commands have led to."""

    command: Command = AT_REST
    states: deque[Modelled] = field(default_factory=lambda: deque([START]))
    """Over the time that is kept, oldest first; never empty."""


class MotionModel:
    """Dead reckoning of one robot's recent commands."""

    def __init__(self, longest: float, gap: float) -> None:
        """Consider delays up to `longest` [s].

        A command lasts at most `gap` [s]: then the watchdog has stopped the robot.
        """
        self.longest = longest
        """Longest delay that is considered [s]."""
        self._gap, self._kept = gap, max(longest, KEPT_TIME)
        self.state = MotionModelState()

    @property
    def now(self) -> Modelled:
        """The newest state."""
        return self.state.states[-1]

    @property
    def spacing(self) -> float:
        """Time between two of the delays [s]."""
        return self.longest / (DELAY_COUNT - 1)

    @property
    def fastest(self) -> Command:
        """Largest mean speed and turn rate between neighbouring states within `longest` (absolute values)."""
        speed, turn_rate, after = abs(self.state.command.speed), abs(self.state.command.turn_rate), None
        for one in reversed(self.state.states):
            if after is not None:
                if 0.0 < (over := after.moment - one.moment) < self._gap:
                    speed = max(speed, (after.path - one.path) / over)
                    turn_rate = max(turn_rate, (after.turning - one.turning) / over)
                if one.moment <= self.now.moment - self.longest:
                    break
            after = one
        return Command(speed, turn_rate)

    def commanded(self, moment: float, command: Command) -> None:
        """Record that the robot was sent `command` at `moment` [s, monotonic]."""
        self.go_to(moment)
        self.state.command = command

    def go_to(self, moment: float) -> None:
        """Carry the model on to `moment` [s, monotonic]; it never goes back."""
        last = self.state.states[-1]
        if moment <= last.moment:
            return
        over = min(moment - last.moment, self._gap)
        distance, turn = self.state.command.speed * over, self.state.command.turn_rate * over
        position, heading = along(last.position, last.heading, distance, turn)
        self.state.states.append(
            Modelled(
                moment,
                position,
                heading / abs(heading),
                last.ahead + distance,
                last.turn + turn,
                last.path + abs(distance),
                last.turning + abs(turn),
            )
        )
        while len(self.state.states) > 1 and self.state.states[1].moment <= moment - self._kept:
            self.state.states.popleft()

    def delayed(self) -> list[Between]:
        """The newest state, and the states at each delay before it, newest first."""
        return self.back(self.spacing, DELAY_COUNT)

    def back(self, spacing: float, count: int) -> list[Between]:
        """The newest state and those before it, `spacing` [s] apart, newest first, `count` in all."""
        earlier = reversed(self.state.states)
        newest = after = next(earlier)
        before = next(earlier, after)
        begin, end = before.moment, after.moment
        found: list[Between] = [(newest, newest, 0.0)]
        for step in range(1, count):
            moment = newest.moment - step * spacing
            while begin >= moment and before is not after:
                after, end = before, begin
                before = next(earlier, after)
                begin = before.moment
            stood = moment <= begin or begin == -math.inf
            share = 0.0 if stood else min(1.0, (moment - begin) / (end - begin))
            found.append((before, after, share))
        return found


Between = tuple[Modelled, Modelled, float]
"""A moment between two states, and its place between them, from 0 to 1: the dead reckoning is interpolated
along the straight line. A plain tuple, because each measurement makes dozens of them."""


def ahead_at(moment: Between) -> float:
    """Return the signed path length [m]."""
    before, after, share = moment
    return before.ahead + share * (after.ahead - before.ahead)


def path_at(moment: Between) -> float:
    """Return the path length [m]."""
    before, after, share = moment
    return before.path + share * (after.path - before.path)


def turning_at(moment: Between) -> float:
    """Return the sum of the turn's absolute value [rad]."""
    before, after, share = moment
    return before.turning + share * (after.turning - before.turning)


def positions(moments: Sequence[Between]) -> list[complex]:
    """Return the positions [m; frame of the first heading]."""
    return [one.position + share * (after.position - one.position) for one, after, share in moments]


def turns(moments: Sequence[Between]) -> list[complex]:
    """Return the signed turns [rad], as numbers without an imaginary part."""
    return [complex(one.turn + share * (after.turn - one.turn)) for one, after, share in moments]


@dataclass(slots=True, kw_only=True)
class OwnDelayState:
    """Sums of distances, which fade, and the newest positions."""

    seen: deque[tuple[float, complex]] = field(default_factory=deque)
    """When positions arrived [s, monotonic], and the positions from where the first was [m], oldest first."""
    skipped: int = 0
    """Number of positions since the last that counted."""
    count: float = 0.0
    """Number of distances."""
    squares: float = 0.0
    """Sum of the squared distances seen [m²]."""
    model_squares: list[float] = field(default_factory=lambda: [0.0] * GRID_COUNT)
    """Sum of the modelled ones, by delay [m²]."""
    products: list[float] = field(default_factory=lambda: [0.0] * GRID_COUNT)
    """Sum of the products of both, by delay [m²]."""


class OwnDelay:
    """Estimates the delay of one robot's measurements."""

    def __init__(self, noise: float, rate: float) -> None:
        """Positions have `noise` [m] (standard deviation per axis), and come at `rate` [Hz]."""
        self.state = OwnDelayState()
        self._misfit = math.hypot(MIN_MISFIT, NOISE_DEVIATIONS * noise)
        self._stride = max(1, math.floor(rate * SPACING))

    def interrupt(self) -> None:
        """Begin the path that was seen anew; what was learned from it stays."""
        self.state.seen.clear()

    def add(self, moment: float, moved: complex, model: MotionModel) -> bool:
        """Add a measurement at `moment` [s, monotonic], `moved` [m] from the one before.

        Whether to `judge` now: of measurements that come faster than `SPACING` not each one counts. `model`
        has the commands until then.
        """
        state = self.state
        before = state.seen[-1] if state.seen else (moment, 0j)
        state.seen.append((moment, before[1] + moved))
        while len(state.seen) > 2 and state.seen[1][0] <= moment - WINDOW_TIME:
            state.seen.popleft()
        oldest, next_one = state.seen[0], state.seen[min(1, len(state.seen) - 1)]
        state.skipped += 1
        if state.skipped < self._stride:
            return False
        state.skipped = 0
        if oldest[0] > moment - WINDOW_TIME:
            return True
        share = (moment - WINDOW_TIME - oldest[0]) / (next_one[0] - oldest[0])
        start = oldest[1] + share * (next_one[1] - oldest[1])
        since = state.seen[max(-len(state.seen), -1 - self._stride)][0]
        points = positions(model.back(SPACING, LOOKBACK_COUNT))
        self._learn(abs(state.seen[-1][1] - start), points, math.exp((since - moment) / FADING_TIME))
        return True

    def _learn(self, seen: float, points: Sequence[complex], kept: float) -> None:
        state = self.state
        state.count, state.squares = kept * state.count + 1.0, kept * state.squares + seen * seen
        commanded = [abs(now - before) for now, before in zip(points, points[WINDOW_STEPS:], strict=False)]
        state.model_squares[:] = [
            kept * total + one * one for total, one in zip(state.model_squares, commanded, strict=True)
        ]
        state.products[:] = [
            kept * total + one * seen for total, one in zip(state.products, commanded, strict=True)
        ]

    def misfits(self) -> Iterator[float]:
        """Yield the mean square that is left by each delay [m²]."""
        state = self.state
        for square, product in zip(state.model_squares, state.products, strict=True):
            explained = product * product / square if square > 0.0 else 0.0
            yield max(0.0, state.squares - explained) / state.count

    def judge(self, limit: float) -> float | None:
        """Delay of the measurements [s], if it explains them and none up to `limit` [s] does; else None."""
        state = self.state
        if state.count < MIN_COUNT:
            return None
        allowed = math.floor(min(limit, KEPT_TIME) / SPACING + 0.5) + 1
        if allowed >= GRID_COUNT:
            return None
        misfits: list[float] = []
        for misfit in self.misfits():
            if len(misfits) < allowed and misfit < self._misfit**2:
                return None  # as a rule at once: the shortest delays fit
            misfits.append(misfit)
        within, beyond = min(misfits[:allowed]), min(misfits[allowed:])
        if within < FIT_RATIO * beyond:
            return None
        if beyond > (1.0 - MIN_FIT) * state.squares / state.count:
            return None
        return SPACING * misfits.index(beyond)
