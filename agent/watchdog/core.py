"""The watchdog: stops a robot if its agent has fallen silent, without a clock, a socket or a log.

A TurtleBot3 keeps its last command for ever, so only the watchdog stops it if its agent dies. An agent
sends `ALIVE` with each command, and a farewell when it ends well (`formation.agent.safety.commander`). A
watchdog sends only zero velocity, until it is certain that no command is left in force:

    state      the watchdog                                 is left when
    listening  is silent, and knows nothing                 an agent's sign of life, or 3 periods
    watching   is silent                                    the agent's farewell, or 3 periods of silence
    braking    sends zero, each period, then each second    the agent's sign of life, or its farewell
    parking    sends zero, each period                      half a second, or the agent's sign of life
    disarmed   is silent: the robot may be driven by hand   the agent's sign of life, or a lost router

A watchdog starts in `listening`. The table below has all transitions.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from enum import StrEnum
from types import MappingProxyType

from formation.agent.safety.commander import FAREWELL
from formation.control.tracker import FRESH_PERIODS
from formation.mission.model import Mission
from formation.protocol.lateness import Quickest, quickest
from formation.protocol.status import WatchdogState
from formation.ros2.messages import Number, Twist, TwistStamped, decode, encode
from formation.topics import ALIVE, CMD_VEL, Topic, command_topic
from formation.transport.runtime.rate import TICK_TOLERANCE
from formation.wire import BadMessage, Now, Outgoing, Sample

PARKING_TIME = 0.5
"""Time for which zero is sent to a robot before it is left alone [s]: a single message may get lost."""
BRAKING_TIME = 5.0
"""Time for which zero is sent each period to a robot with a silent agent [s]; then each `SLOW_PERIOD`."""
SLOW_PERIOD = 1.0
"""[s]"""
MAX_PAUSE = 1.0
"""Delay of a step from which the watchdog was frozen [s]."""
MAX_SIGN_DELAY = 0.5
"""Lateness, compared with the agent's quickest, from which a sign of life is too old to count [s]."""


class Event(StrEnum):
    """What changes the state."""

    CONNECTED = "connected"
    """Linked to the robot's router, maybe again: commands until now are unknown."""
    ALIVE = "alive"
    """The agent has sent a sign of life."""
    FAREWELL = "farewell"
    """The agent has sent its farewell."""
    SILENT = "silent"
    """The agent has sent nothing for 3 periods."""
    PARKED = "parked"
    """Zero has been sent for `PARKING_TIME`."""
    THAWED = "thawed"
    """This process was frozen: commands until now are unknown."""


TABLE: Mapping[tuple[WatchdogState, Event], WatchdogState] = MappingProxyType(
    {
        (WatchdogState.LISTENING, Event.CONNECTED): WatchdogState.LISTENING,
        (WatchdogState.LISTENING, Event.ALIVE): WatchdogState.WATCHING,
        (WatchdogState.LISTENING, Event.FAREWELL): WatchdogState.PARKING,
        # no agent drives now; one that drove before this watchdog started may have left a command in force
        (WatchdogState.LISTENING, Event.SILENT): WatchdogState.PARKING,
        (WatchdogState.WATCHING, Event.CONNECTED): WatchdogState.WATCHING,  # silence is counted on
        (WatchdogState.WATCHING, Event.ALIVE): WatchdogState.WATCHING,
        (WatchdogState.WATCHING, Event.FAREWELL): WatchdogState.PARKING,
        (WatchdogState.WATCHING, Event.SILENT): WatchdogState.BRAKING,
        (WatchdogState.BRAKING, Event.CONNECTED): WatchdogState.BRAKING,
        (WatchdogState.BRAKING, Event.ALIVE): WatchdogState.WATCHING,
        (WatchdogState.BRAKING, Event.FAREWELL): WatchdogState.PARKING,
        (WatchdogState.PARKING, Event.CONNECTED): WatchdogState.PARKING,
        (WatchdogState.PARKING, Event.ALIVE): WatchdogState.WATCHING,
        (WatchdogState.PARKING, Event.FAREWELL): WatchdogState.PARKING,
        (WatchdogState.PARKING, Event.PARKED): WatchdogState.DISARMED,
        (WatchdogState.DISARMED, Event.CONNECTED): WatchdogState.LISTENING,
        (WatchdogState.DISARMED, Event.ALIVE): WatchdogState.WATCHING,
        (WatchdogState.DISARMED, Event.FAREWELL): WatchdogState.PARKING,
        (WatchdogState.LISTENING, Event.THAWED): WatchdogState.LISTENING,
        (WatchdogState.WATCHING, Event.THAWED): WatchdogState.LISTENING,
        (WatchdogState.BRAKING, Event.THAWED): WatchdogState.BRAKING,
        (WatchdogState.PARKING, Event.THAWED): WatchdogState.PARKING,
    }
)
"""The transitions. An event that a state does not have cannot happen there."""


class Watchdog:
    """One robot's watchdog."""

    def __init__(self, mission: Mission, robot: str) -> None:
        """Raises ValueError for a robot that is no follower of the mission: only followers have agents."""
        if robot not in mission.followers:
            followers = ", ".join(mission.followers)
            raise ValueError(f"robot {robot!r}: must be a follower of {mission.name}: {followers}")
        spec = mission.robots[robot]
        self.robot = robot
        self.state = WatchdogState.LISTENING
        self.dropped: Counter[str] = Counter()
        """Messages that were not signs of life, by key."""
        self.limit = FRESH_PERIODS / spec.rate
        """Silence of an agent after which its robot is stopped [s]."""
        self._period = 1.0 / spec.rate
        self._cmd_vel, self._alive = CMD_VEL.key(robot), ALIVE.key(robot)
        self._topic = command_topic(spec.cmd_vel)
        self._connected = False
        self._received = float("inf")  # since when nothing was received [s, monotonic]
        self._since = float("inf")  # when the state was entered, or entered again [s, monotonic]
        self._zero_due = float("inf")  # [s, monotonic]
        self._sign = float("-inf")  # newest sign of life, by the agent's clock [s]
        self._quickest: Quickest | None = None  # its quickest sign of life

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """The agent's signs of life and nothing else.

        Not `cmd_vel`: an agent sees by its subscribers whether its robot still receives commands.
        """
        return (self._alive,)

    @property
    def publications(self) -> tuple[tuple[Topic, str], ...]:
        """Commands, of the type that this robot takes."""
        return ((self._topic, self._cmd_vel),)

    @property
    def due(self) -> float:
        """When a step is needed though nothing arrives [s, monotonic]."""
        match self.state:
            case WatchdogState.LISTENING | WatchdogState.WATCHING:
                return self._received + self.limit
            case WatchdogState.BRAKING | WatchdogState.PARKING:
                return self._zero_due
            case WatchdogState.DISARMED:
                return float("inf")

    def aware(self, *, connected: bool, now: Now) -> None:
        """Store, before a step, whether there is a link to the robot's router."""
        if connected and not self._connected:
            self._happens(Event.CONNECTED, now.mono)
        self._connected = connected

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """Process signs of life; return zero velocity if it is due.

        A watchdog that was frozen starts afresh.
        """
        if now.mono - self.due > MAX_PAUSE:
            self._happens(Event.THAWED, now.mono)
        for sample in inbox:
            try:
                self._happens(self._meaning(sample), min(sample.arrived, now.mono))
            except BadMessage:
                self.dropped[self._alive if sample.key == self._alive else "elsewhere"] += 1
        if self.state in {WatchdogState.LISTENING, WatchdogState.WATCHING} and self._silent(now):
            self._happens(Event.SILENT, now.mono)
        if self.state is WatchdogState.PARKING and now.mono - self._since >= PARKING_TIME - TICK_TOLERANCE:
            self._happens(Event.PARKED, now.mono)
        if (
            self.state not in {WatchdogState.BRAKING, WatchdogState.PARKING}
            or now.mono < self._zero_due - TICK_TOLERANCE
        ):
            return []
        slow = self.state is WatchdogState.BRAKING and now.mono - self._since >= BRAKING_TIME
        self._zero_due = now.mono + (SLOW_PERIOD if slow else self._period)
        return [self._zero(now)]

    def halt(self, now: Now, reason: str) -> list[Outgoing]:  # noqa: ARG002 - a core's signature
        """Return the last messages: zero, unless the agent is healthy or the robot is parked."""
        healthy = self.state is WatchdogState.WATCHING and not self._silent(now)
        return [] if healthy or self.state is WatchdogState.DISARMED else [self._zero(now)]

    def _meaning(self, sample: Sample) -> Event:
        """Return the event of a message. Raises BadMessage."""
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
        """Refuse a sign of life that was delayed. Raises BadMessage."""
        # of an agent that began after the newest sign; a lower number is otherwise a repetition
        began = self.state is not WatchdogState.WATCHING or value <= arrived - self._received
        if self._quickest is None or (value < self._sign and began):
            self._quickest = quickest(value, arrived)
        if (late := self._quickest.lateness(value, arrived)) > MAX_SIGN_DELAY:
            raise BadMessage(f"sign of life {late:.1f} s late, at most {MAX_SIGN_DELAY:g} s")
        self._sign, self._quickest = value, self._quickest.followed_by(value, arrived)

    def _happens(self, event: Event, moment: float) -> None:
        before, self.state = self.state, TABLE[self.state, event]
        if event in {Event.ALIVE, Event.FAREWELL} or self.state is WatchdogState.LISTENING:
            self._received = moment
        if event is not Event.ALIVE or self.state is not before:
            self._since = self._zero_due = moment

    def _silent(self, now: Now) -> bool:
        return now.mono - self._received >= self.limit - TICK_TOLERANCE

    def _zero(self, now: Now) -> Outgoing:
        twist = Twist(0.0, 0.0) if self._topic.type == Twist.ROS_TYPE else TwistStamped(now.wall, 0.0, 0.0)
        return Outgoing(self._cmd_vel, encode(twist))
