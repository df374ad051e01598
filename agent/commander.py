"""What the robot is told: the command, and beside it a sign of life for the guard that watches this agent."""

from __future__ import annotations

from agent.alive import FAREWELL
from formation.mission import Mission
from formation.quantiser import Quantiser
from formation.ros2.messages import Number, Twist, TwistStamped, encode
from formation.topics import ALIVE, CMD_VEL, Topic, command_topic
from formation.unicycle import Command
from formation.wire import Now, Outgoing

AT_REST = Command(0.0, 0.0)


class Commander:
    """Says commands in the way that one robot takes them."""

    def __init__(self, mission: Mission, robot: str) -> None:
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
        self._began: float | None = None

    def leave(self, now: Now) -> list[Outgoing]:
        """Zero velocity to the robot, and to the guard that no more commands will follow."""
        command, _ = self.say(now, AT_REST)
        return [command, Outgoing(self._alive, encode(Number(FAREWELL)))]

    def say(self, now: Now, wanted: Command) -> list[Outgoing]:
        """`wanted`, which is within limits, to the robot; and that this agent is alive, to its guard."""
        if self._quantiser is not None:
            wanted, self.remainder = self._quantiser.quantise(wanted, self.remainder)
        self.newest = Command(float(wanted.speed), float(wanted.turn_rate))
        self._began = now.mono if self._began is None else self._began
        payload = encode(TwistStamped(now.wall, *self.newest) if self._stamped else Twist(*self.newest))
        return [
            Outgoing(self._cmd_vel, payload),
            Outgoing(self._alive, encode(Number(now.mono - self._began))),
        ]
