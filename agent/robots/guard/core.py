"""The guard: stops a robot whose agent has fallen silent, without a clock, a socket or a log.

A TurtleBot3 keeps its last command for ever, so nothing else stands between a dead agent and a wall. An
agent says `ALIVE` with each command, and takes its leave when it ends well (`agent.alive`). A guard says zero
velocity and nothing else, until it knows that nobody has left a command behind:

    state      the guard                                    is left when
    listening  is silent, and knows nothing                 the agent speaks, or 3 periods have gone by
    watching   is silent                                    the agent takes its leave, or misses 3 periods
    braking    says zero, each period, then each second     the agent speaks again, or takes its leave
    parking    says zero, each period                       half a second has gone by, or the agent speaks
    disarmed   is silent: somebody may drive by hand        the agent speaks, or the router was lost

A guard that starts is listening. The table below has it all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from enum import StrEnum
from types import MappingProxyType

from agent.alive import FAREWELL
from formation.mission import Mission
from formation.neighbour import FRESH_PERIODS
from formation.rate import EARLY
from formation.ros2.messages import Number, Twist, TwistStamped, decode, encode
from formation.topics import ALIVE, CMD_VEL, Topic, command_topic
from formation.wire import BadMessage, Now, Outgoing, Sample

PARKING = 0.5
"""How long zero is said to a robot that is then left alone [s]: a single message may get lost."""
BRAKING = 5.0
"""How long zero is said each period to a robot whose agent fell silent [s]; from then on each `SLOW`."""
SLOW = 1.0
"""[s]"""
MAX_PAUSE = 1.0
"""A guard that steps later than it is due by more than this was frozen [s]."""
MAX_SIGN_DELAY = 0.5
"""A sign of life that comes so much later than the quickest of its agent is too old to count [s]."""


class State(StrEnum):
    """What a guard is doing."""

    LISTENING = "listening"
    """Does not know yet whether an agent drives this robot."""
    WATCHING = "watching"
    """Hears its agent."""
    BRAKING = "braking"
    """Has lost its agent, which may have left any command behind."""
    PARKING = "parking"
    """Makes sure that a robot stands which nobody drives."""
    DISARMED = "disarmed"
    """Has parked the robot."""


class Event(StrEnum):
    """What changes that."""

    CONNECTED = "connected"
    """Hears the robot's router, maybe again: what was said until now is unknown."""
    ALIVE = "alive"
    """The agent has spoken."""
    FAREWELL = "farewell"
    """The agent has taken its leave."""
    SILENT = "silent"
    """The agent has not spoken for 3 periods."""
    PARKED = "parked"
    """Zero has been said for `PARKING`."""
    THAWED = "thawed"
    """This process was frozen: what was said until now is unknown."""


TABLE: Mapping[tuple[State, Event], State] = MappingProxyType(
    {
        (State.LISTENING, Event.CONNECTED): State.LISTENING,
        (State.LISTENING, Event.ALIVE): State.WATCHING,
        (State.LISTENING, Event.FAREWELL): State.PARKING,
        # nobody drives now; whoever did while nobody guarded may have left a command behind
        (State.LISTENING, Event.SILENT): State.PARKING,
        (State.WATCHING, Event.CONNECTED): State.WATCHING,  # silence is counted on
        (State.WATCHING, Event.ALIVE): State.WATCHING,
        (State.WATCHING, Event.FAREWELL): State.PARKING,
        (State.WATCHING, Event.SILENT): State.BRAKING,
        (State.BRAKING, Event.CONNECTED): State.BRAKING,
        (State.BRAKING, Event.ALIVE): State.WATCHING,
        (State.BRAKING, Event.FAREWELL): State.PARKING,
        (State.PARKING, Event.CONNECTED): State.PARKING,
        (State.PARKING, Event.ALIVE): State.WATCHING,
        (State.PARKING, Event.FAREWELL): State.PARKING,
        (State.PARKING, Event.PARKED): State.DISARMED,
        (State.DISARMED, Event.CONNECTED): State.LISTENING,
        (State.DISARMED, Event.ALIVE): State.WATCHING,
        (State.DISARMED, Event.FAREWELL): State.PARKING,
        (State.LISTENING, Event.THAWED): State.LISTENING,
        (State.WATCHING, Event.THAWED): State.LISTENING,
        (State.BRAKING, Event.THAWED): State.BRAKING,
        (State.PARKING, Event.THAWED): State.PARKING,
    }
)
"""What follows on what. An event that a state does not have cannot happen there."""


class Guard:
    """One robot's guard."""

    def __init__(self, mission: Mission, robot: str) -> None:
        """Raises ValueError for a robot that is no follower of the mission: nobody else has an agent."""
        if robot not in mission.followers:
            followers = ", ".join(mission.followers)
            raise ValueError(f"robot {robot!r}: must be a follower of {mission.name}: {followers}")
        spec = mission.robots[robot]
        self.robot = robot
        self.state = State.LISTENING
        self.dropped: Counter[str] = Counter()
        """Messages that were no signs of life, by key."""
        self.limit = FRESH_PERIODS / spec.rate
        """Silence of an agent after which its robot is stopped [s]."""
        self._period = 1.0 / spec.rate
        self._cmd_vel, self._alive = CMD_VEL.key(robot), ALIVE.key(robot)
        self._topic = command_topic(spec.cmd_vel)
        self._connected = False
        self._heard = float("inf")  # since when nothing was heard [s, monotonic]
        self._since = float("inf")  # when the state was entered, or entered again [s, monotonic]
        self._zero_due = float("inf")  # [s, monotonic]
        self._sign = float("-inf")  # newest sign of life, by the agent's clock [s]
        self._ahead = float("-inf")  # most that the agent's clock was ahead of arrival [s]

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """The agent's signs of life and nothing else.

        Not `cmd_vel`: an agent sees by who subscribes to it whether its robot still listens.
        """
        return (self._alive,)

    @property
    def publications(self) -> tuple[tuple[Topic, str], ...]:
        """Commands, of the type that this robot takes."""
        return ((self._topic, self._cmd_vel),)

    @property
    def due(self) -> float:
        """When a step is wanted though nothing arrives [s, monotonic]."""
        match self.state:
            case State.LISTENING | State.WATCHING:
                return self._heard + self.limit
            case State.BRAKING | State.PARKING:
                return self._zero_due
            case State.DISARMED:
                return float("inf")

    def aware(self, *, connected: bool, now: Now) -> None:
        """Learn, before a step, whether there is a link to the robot's router."""
        if connected and not self._connected:
            self._happens(Event.CONNECTED, now.mono)
        self._connected = connected

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """Hear the agent; zero velocity if it must be said now.

        A guard that was frozen begins as one that has just started.
        """
        if now.mono - self.due > MAX_PAUSE:
            self._happens(Event.THAWED, now.mono)
        for sample in inbox:
            try:
                self._happens(self._meaning(sample), min(sample.arrived, now.mono))
            except BadMessage:
                self.dropped[self._alive if sample.key == self._alive else "elsewhere"] += 1
        if self.state in {State.LISTENING, State.WATCHING} and self._silent(now):
            self._happens(Event.SILENT, now.mono)
        if self.state is State.PARKING and now.mono - self._since >= PARKING - EARLY:
            self._happens(Event.PARKED, now.mono)
        if self.state not in {State.BRAKING, State.PARKING} or now.mono < self._zero_due - EARLY:
            return []
        slow = self.state is State.BRAKING and now.mono - self._since >= BRAKING
        self._zero_due = now.mono + (SLOW if slow else self._period)
        return [self._zero(now)]

    def halt(self, now: Now, reason: str) -> list[Outgoing]:  # noqa: ARG002 - a core's signature
        """The last words of a guard that ends: zero, unless it hears a healthy agent or parked the robot."""
        healthy = self.state is State.WATCHING and not self._silent(now)
        return [] if healthy or self.state is State.DISARMED else [self._zero(now)]

    def _meaning(self, sample: Sample) -> Event:
        """What a message is. Raises BadMessage."""
        if sample.key != self._alive:
            raise BadMessage("unknown key")
        value = decode(Number, sample.payload).value
        if value == FAREWELL:
            return Event.FAREWELL
        if value < 0.0:
            raise BadMessage(f"alive for {value:g} s")
        self._check_age(value, sample.arrived)
        return Event.ALIVE

    def _check_age(self, value: float, arrived: float) -> None:
        """Refuse a sign of life that was long on the way. Raises BadMessage."""
        if value < self._sign:  # of an agent that was started anew
            self._ahead = float("-inf")
        self._sign, self._ahead = value, max(self._ahead, value - arrived)
        if (late := self._ahead - (value - arrived)) > MAX_SIGN_DELAY:
            raise BadMessage(f"sign of life {late:.1f} s late, at most {MAX_SIGN_DELAY:g} s")

    def _happens(self, event: Event, moment: float) -> None:
        before, self.state = self.state, TABLE[self.state, event]
        if event in {Event.ALIVE, Event.FAREWELL} or self.state is State.LISTENING:
            self._heard = moment
        if event is not Event.ALIVE or self.state is not before:
            self._since = self._zero_due = moment

    def _silent(self, now: Now) -> bool:
        return now.mono - self._heard >= self.limit - EARLY

    def _zero(self, now: Now) -> Outgoing:
        twist = Twist(0.0, 0.0) if self._topic.type == Twist.ROS_TYPE else TwistStamped(now.wall, 0.0, 0.0)
        return Outgoing(self._cmd_vel, encode(twist))
