"""The messages to the robot: the command, and a sign of life for the watchdog of this agent.

The number in `ALIVE` is the time since the agent's start [s]. The last sign of life of an agent that ends
well, after its last zero command, is `FAREWELL`.
"""

from __future__ import annotations

from dataclasses import dataclass

from formation.control.avoidance import Avoidance
from formation.control.pipeline import ControlState, at_rest
from formation.control.ramp import STARTING, Ramp
from formation.control.unicycle import AT_REST, Command
from formation.mission.model import Mission
from formation.ros2.messages import Number, Twist, TwistStamped, encode
from formation.topics import ALIVE, CMD_VEL, Topic, command_topic
from formation.wire import Now, Outgoing

FAREWELL = -1.0
"""Instead of a time: the robot was commanded to stand, and this agent will send no more commands."""


@dataclass(slots=True, kw_only=True)
class CommanderState:
    """The newest command, and what the control pipeline remembers of it."""

    newest: Command = AT_REST
    """The newest command, as it was sent."""
    remainder: Command = AT_REST
    """Difference between the commands so far and what the law wanted, due to rounding."""
    ramp: Ramp = STARTING
    began: float | None = None
    """When the first command was sent [s, monotonic]."""


class Commander:
    """Sends commands in the format that one robot takes."""

    def __init__(self, mission: Mission, robot: str) -> None:
        spec = mission.robots[robot]
        self.state = CommanderState()
        self.steps = Command(spec.speed_step, spec.turn_rate_step)
        """Resolution of the robot's commands; 0 for none."""
        self.topics: tuple[Topic, Topic] = (command_topic(spec.cmd_vel), ALIVE)
        self._stamped = spec.cmd_vel == "twist_stamped"
        self._cmd_vel, self._alive = CMD_VEL.key(robot), ALIVE.key(robot)

    def control_state(self, integral: complex = 0j, avoidance: Avoidance | None = None) -> ControlState:
        """The state of the control pipeline after the newest command, with the given parts."""
        return ControlState(integral, avoidance or Avoidance(), self.state.ramp, self.state.remainder)

    def leave(self, now: Now) -> list[Outgoing]:
        """Send zero velocity to the robot, and a farewell to the watchdog."""
        command, _ = self.rest(now)
        return [command, Outgoing(self._alive, encode(Number(FAREWELL)))]

    def rest(self, now: Now) -> list[Outgoing]:
        """Send zero velocity to the robot, and a sign of life to its watchdog."""
        return self.say(now, AT_REST, at_rest(self.control_state(), now.mono))

    def say(self, now: Now, command: Command, state: ControlState) -> list[Outgoing]:
        """Send a command to the robot, and a sign of life to its watchdog; `state` is the one after it."""
        own = self.state
        own.newest, own.remainder, own.ramp = command, state.remainder, state.ramp
        own.began = now.mono if own.began is None else own.began
        payload = encode(TwistStamped(now.wall, *command) if self._stamped else Twist(*command))
        return [
            Outgoing(self._cmd_vel, payload),
            Outgoing(self._alive, encode(Number(now.mono - own.began))),
        ]
