"""A watchdog on its robot's side, the only one that it is linked to."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence

from formation.agent.safety.commander import FAREWELL
from formation.agent.watchdog.core import Watchdog
from formation.protocol.status import WatchdogState, WatchdogStatus
from formation.protocol.status_codec import to_json
from formation.ros2.messages import Number, encode
from formation.topics import ALIVE, WATCHDOG
from formation.transport.runtime.loop import PARENT_CHECK_PERIOD, Pauses, Runtime
from formation.wire import Now, Outgoing, Sample

ROUTER_TIMEOUT_SECONDS = 1.0
"""Longest time that `park` waits for the robot's router [s]: an existing one answers in milliseconds."""
_NEWS = {
    WatchdogState.LISTENING: "the robot's router is there: listening for the agent",
    WatchdogState.WATCHING: "watching the agent",
    WatchdogState.BRAKING: "THE AGENT IS SILENT: zero velocity until its signs of life return",
    WatchdogState.PARKING: "no agent drives: parking the robot",
    WatchdogState.DISARMED: "parked: the robot may be driven by hand",
}
_log = logging.getLogger(__name__)


class Side:
    """A watchdog between its agent and its robot."""

    def __init__(self, watchdog: Watchdog, process: Runtime) -> None:
        self._watchdog, self._process = watchdog, process
        self.dropped: Mapping[str, int] = watchdog.dropped

    @property
    def due(self) -> float:
        """When the watchdog needs a step [s, monotonic]."""
        return self._watchdog.due

    def declare(self) -> None:
        """Declare what it publishes and receives. Raises BusError."""
        robot = self._process.robot
        for topic, key in self._watchdog.publications:
            robot.advertise(topic, key)
        for key in self._watchdog.subscriptions:
            robot.subscribe(ALIVE, key)
        robot.answer(WATCHDOG.key(self._watchdog.robot), self._answer)

    def _answer(self, _request: bytes, _received: float) -> bytes:
        """Answer that the watchdog is running, as distinct from other subscribers."""
        watchdog = self._watchdog
        return to_json(WatchdogStatus(robot=watchdog.robot, state=watchdog.state))

    def step(self, now: Now, inbox: Sequence[Sample]) -> Iterable[Outgoing]:
        """Step the watchdog, and log its changes of state."""
        before = self._watchdog.state
        self._watchdog.aware(connected=self._process.robot.connected, now=now)
        outbox = self._watchdog.step(now, inbox)
        after = self._watchdog.state
        if after is not before:
            _log.log(logging.WARNING if after is WatchdogState.BRAKING else logging.INFO, _NEWS[after])
        return outbox

    def halt(self, now: Now, reason: str) -> Iterable[Outgoing]:
        """Return the watchdog's last messages."""
        return self._watchdog.halt(now, reason)

    def send(self, outbox: Iterable[Outgoing]) -> None:
        """Send it to the robot."""
        for out in outbox:
            self._process.robot.publish(out.key, out.payload)


def watch(watchdog: Watchdog, process: Runtime) -> Pauses:
    """Declare, then watch the robot until told to stop."""
    side = Side(watchdog, process)
    side.declare()
    process.ready()
    yield from process.loop(side, side.send)


def park(watchdog: Watchdog, process: Runtime) -> bool:
    """Stop the robot, and send the farewell that its agent did not send; whether the robot received it.

    For use when that agent is known to be dead: the running watchdog then need not brake for it any
    longer.
    """
    robot, alive, farewell = process.robot, ALIVE.key(watchdog.robot), encode(Number(FAREWELL))
    for topic, key in (*watchdog.publications, (ALIVE, alive)):
        robot.advertise(topic, key)
    end = process.clock().mono + ROUTER_TIMEOUT_SECONDS
    while not robot.connected:
        if process.stop or process.clock().mono >= end:
            return False
        process.mailbox.wait(0.01)
    listened, inbox = False, [Sample(alive, farewell, None, process.clock().mono)]
    while watchdog.state is not WatchdogState.DISARMED and not process.stop:
        for out in watchdog.step(process.clock(), inbox):
            robot.publish(out.key, out.payload)
            listened = bool(robot.routed(out.key)) or listened
        inbox = []
        process.mailbox.wait(min(max(watchdog.due - process.clock().mono, 0.0), PARENT_CHECK_PERIOD))
    robot.publish(alive, farewell)
    return listened
