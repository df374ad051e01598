"""What the robot is told: the command, and beside it a sign of life for the guard that watches this agent."""

from __future__ import annotations

from collections.abc import Callable

from agent.alive import FAREWELL
from formation.mission import Mission
from formation.neighbour import FRESH_PERIODS
from formation.quantiser import Quantiser, quantise
from formation.ros2.messages import Number, Twist, TwistStamped, encode
from formation.slew import slewed
from formation.topics import ALIVE, CMD_VEL, Topic, command_topic
from formation.unicycle import Command
from formation.wire import Now, Outgoing

AT_REST = Command(0.0, 0.0)
LONGEST = 2.0
"""Of a longer time between two commands, in periods of control, the rest does not count for the ramp."""
MOST = 0.45
"""Nor does what would let one command be further than this share of a limit from the one before."""
GENTLE = 6.0
"""Who was silent for so long that the guard may have stopped the robot keeps within `MOST` for so many
periods: the guard's zero may still be on its way."""
HALF = 0.5
"""The first of these may be this share of a limit from the one before: it may have to go down."""


class Commander:
    """Says commands in the way that one robot takes them."""

    def __init__(self, mission: Mission, robot: str, law: str = "field") -> None:
        """The printed law is said as it is, without a ramp: its integral would swing against it."""
        spec = mission.robots[robot]
        self.newest = AT_REST
        """The newest command, as it was sent."""
        self.remainder = AT_REST
        """What the commands so far owe to what the law wanted."""
        self.steps = Command(spec.speed_step, spec.turn_rate_step)
        """The robot cuts commands to multiples of these; 0 for none."""
        self.topics: tuple[Topic, Topic] = (command_topic(spec.cmd_vel), ALIVE)
        self._stamped = spec.cmd_vel == "twist_stamped"
        self._cmd_vel, self._alive = CMD_VEL.key(robot), ALIVE.key(robot)
        self._quantiser = Quantiser.of(self.steps, spec.limits)
        self._limits, self._ramp = spec.limits, spec.ramp if law == "field" else 0.0
        self._longest = min(LONGEST / spec.rate, MOST * self._ramp)
        self._ramped = AT_REST  # the newest command before it was quantised,
        self._said = float("-inf")  # and when it was said [s, monotonic]
        self._gentle_until = float("-inf")  # [s, monotonic]
        self._guarded = FRESH_PERIODS / spec.rate  # after so long a silence the guard stops the robot [s]
        self._period = 1.0 / spec.rate
        self._began: float | None = None

    def leave(self, now: Now) -> list[Outgoing]:
        """Zero velocity to the robot, and to the guard that no more commands will follow."""
        command, _ = self.say(now, AT_REST)
        return [command, Outgoing(self._alive, encode(Number(FAREWELL)))]

    def say(
        self, now: Now, wanted: Command, brake: Callable[[Command], Command] | None = None
    ) -> list[Outgoing]:
        """`wanted`, which is within limits, to the robot, or as near as the ramp allows; zero is zero.

        What `brake` makes of that waits for no ramp. And that this agent is alive, to its guard.
        """
        if self._ramp > 0.0:
            wanted = self._ramping(now, wanted)
        if brake is not None:
            wanted = brake(wanted)
        self._ramped, self._said = wanted, now.mono
        if self._quantiser is not None:
            wanted, self.remainder = quantise(self._quantiser, wanted, self.remainder)
        self.newest = wanted
        self._began = now.mono if self._began is None else self._began
        payload = encode(TwistStamped(now.wall, *self.newest) if self._stamped else Twist(*self.newest))
        return [
            Outgoing(self._cmd_vel, payload),
            Outgoing(self._alive, encode(Number(now.mono - self._began))),
        ]

    def _ramping(self, now: Now, wanted: Command) -> Command:
        """As near to `wanted` as it may be after the command before."""
        if wanted == AT_REST:
            return wanted
        silence = now.mono - self._said
        share = min(silence, self._longest) / self._ramp
        if silence > self._guarded:
            self._gentle_until = now.mono + GENTLE * self._period
            share = share if self._ramped == AT_REST else HALF
        if now.mono <= self._gentle_until:
            wanted = slewed(AT_REST, wanted, self._limits, MOST)
        return slewed(self._ramped, wanted, self._limits, share)
