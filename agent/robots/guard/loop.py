"""A guard on its robot's side, which is the only one that it is on."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence

from agent.alive import FAREWELL
from agent.robots.guard.core import Guard, State
from formation.guarding import GuardReply
from formation.guarding import encode as encode_reply
from formation.ros2.messages import Number, encode
from formation.topics import ALIVE, GUARD
from formation.transport.process import WATCH, Process, clocks
from formation.wire import Now, Outgoing, Sample

REACH = 1.0
"""How long `park` waits for the robot's router [s]: one that is there answers in milliseconds."""
_NEWS = {
    State.LISTENING: "the robot's router is there: listening for the agent",
    State.WATCHING: "watching the agent",
    State.BRAKING: "THE AGENT IS SILENT: zero velocity until it speaks again",
    State.PARKING: "no agent drives: parking the robot",
    State.DISARMED: "parked: the robot may be driven by hand",
}
_log = logging.getLogger(__name__)


class Side:
    """A guard between its agent and its robot."""

    def __init__(self, guard: Guard, process: Process) -> None:
        self._guard, self._process = guard, process
        self.dropped: Mapping[str, int] = guard.dropped

    @property
    def due(self) -> float:
        """When the guard wants a step [s, monotonic]."""
        return self._guard.due

    def declare(self) -> None:
        """Declare what it says and hears. Raises BusError."""
        robot = self._process.robot
        for topic, key in self._guard.publications:
            robot.advertise(topic, key)
        for key in self._guard.subscriptions:
            robot.subscribe(ALIVE, key)
        robot.answer(GUARD.key(self._guard.robot), self._answer)

    def _answer(self, _request: bytes, _heard: float) -> bytes:
        """That it is there, whoever else may listen to the agent."""
        guard = self._guard
        return encode_reply(GuardReply(robot=guard.robot, state=guard.state.value))

    def step(self, now: Now, inbox: Sequence[Sample]) -> Iterable[Outgoing]:
        """Step the guard, and log what becomes of it."""
        before = self._guard.state
        self._guard.aware(connected=self._process.robot.connected, now=now)
        outbox = self._guard.step(now, inbox)
        after = self._guard.state
        if after is not before:
            _log.log(logging.WARNING if after is State.BRAKING else logging.INFO, _NEWS[after])
        return outbox

    def halt(self, now: Now, reason: str) -> Iterable[Outgoing]:
        """The guard's last words."""
        return self._guard.halt(now, reason)

    def send(self, outbox: Iterable[Outgoing]) -> None:
        """Send it to the robot."""
        for out in outbox:
            self._process.robot.publish(out.key, out.payload)


def watch(guard: Guard, process: Process) -> None:
    """Declare, then guard the robot until told to stop."""
    side = Side(guard, process)
    side.declare()
    process.ready()
    process.run(side, side.send)


def park(guard: Guard, process: Process) -> bool:
    """Have the robot stand, and take the leave that its agent did not take; whether the robot listened.

    For when that agent is known to be gone: the guard on watch need not brake for it any longer.
    """
    robot, alive, farewell = process.robot, ALIVE.key(guard.robot), encode(Number(FAREWELL))
    for topic, key in (*guard.publications, (ALIVE, alive)):
        robot.advertise(topic, key)
    end = clocks().mono + REACH
    while not robot.connected:
        if process.stop or clocks().mono >= end:
            return False
        process.mailbox.wait(0.01)
    listened, inbox = False, [Sample(alive, farewell, None, clocks().mono)]
    while guard.state is not State.DISARMED and not process.stop:
        for out in guard.step(clocks(), inbox):
            robot.publish(out.key, out.payload)
            listened = bool(robot.routed(out.key)) or listened
        inbox = []
        process.mailbox.wait(min(max(guard.due - clocks().mono, 0.0), WATCH))
    robot.publish(alive, farewell)
    return listened
