"""Dead reckoning of the commands: the pose they lead to, now and at several delays in the past.

It uses no sensor, and is the reference of `formation.agent.pose.motion_check`. A robot follows its commands
late, by an unknown delay of up to `longest` [s] (its wheels' lag, the delay of the command, the delay of the
measurement), so every comparison is made for several delays in between.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from formation.control.unicycle import AT_REST, Command, along

DELAY_COUNT = 7
"""Number of delays for which the commands are compared, evenly from none to the longest."""


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

    def __init__(self, longest: float, gap: float, kept: float = 0.0) -> None:
        """Consider delays up to `longest` [s], and keep at least the last `kept` [s].

        A command lasts at most `gap` [s]: then the watchdog has stopped the robot.
        """
        self.longest = longest
        """Longest delay that is considered [s]."""
        self._gap, self._kept = gap, max(longest, kept)
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

    def delayed(self) -> list[Modelled]:
        """The newest state, and the states at each delay before it, newest first."""
        return self.back(self.spacing, DELAY_COUNT)

    def back(self, spacing: float, count: int) -> list[Modelled]:
        """The newest state and those before it, `spacing` [s] apart, newest first, `count` in all."""
        states, number, found = self.state.states, len(self.state.states) - 1, [self.state.states[-1]]
        for step in range(1, count):
            moment = states[-1].moment - step * spacing
            while number > 0 and states[number - 1].moment >= moment:
                number -= 1
            found.append(_between(states[max(number - 1, 0)], states[number], moment))
        return found


def _between(before: Modelled, after: Modelled, moment: float) -> Modelled:
    """State at `moment`, interpolated along the straight line."""
    if moment <= before.moment or before.moment == float("-inf"):
        return before
    share = min(1.0, (moment - before.moment) / (after.moment - before.moment))
    return Modelled(
        moment,
        before.position + share * (after.position - before.position),
        after.heading,
        before.ahead + share * (after.ahead - before.ahead),
        before.turn + share * (after.turn - before.turn),
        before.path + share * (after.path - before.path),
        before.turning + share * (after.turning - before.turning),
    )
