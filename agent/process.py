"""An agent on its two buses: what goes to which side, and in what order.

    publishes    to both sides, first to the side that needs it: commands to its robot, before all else is
                 made or sent; positions and status to the fleet
    receives     its robot's messages, which it repeats to the fleet, byte for byte and last, so that the
                 monitor sees what the agent saw

On the robot's side positions and status are ROS 2 topics, without the order. `ALIVE` is between an agent
and its watchdog and stays there; that of another agent of the same robot is received too. An agent that is
``readonly`` sends its robot neither commands nor signs of life. A command to the fleet carries its trace
(`formation.agent.persistence.trace`), made long after the robot has received it. The state of the links is
read after everything is sent, for the next step, so that no command waits for it. Saved state
(`formation.agent.persistence.restore`) is written by other threads.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence

from formation.agent.core import Agent
from formation.agent.persistence.persistence import Persistence
from formation.agent.persistence.restore import Taken
from formation.agent.persistence.trace import Link, Trace
from formation.agent.status import Surroundings
from formation.protocol import json_message
from formation.protocol.request import OperatorReply
from formation.ros2.messages import Number, decode
from formation.ros2.ros_names import address
from formation.topics import ALIVE, BALLOT, CMD_VEL, ORDER, POSITION, SCAN, STATUS
from formation.transport.runtime.loop import Pauses, Runtime
from formation.transport.security.verifying import Verifier
from formation.wire import BadMessage, Now, Outgoing, Sample

WAITING = frozenset((POSITION, BALLOT))
"""Keys that wait for the robot's next own message: before that they change nothing, and they come more
often."""
REFUSED_PERIOD = 0.5
"""[s]"""
UNSAVED = "cannot be saved just now: a restart may undo it"
"""Added to the reply if a request is obeyed but not saved."""
_log = logging.getLogger(__name__)


class Sides:
    """An agent between its robot and the fleet."""

    def __init__(
        self,
        agent: Agent,
        process: Runtime,
        *,
        persistence: Persistence | None = None,
        verifier: Verifier | None = None,
    ) -> None:
        self._agent, self._process, self._persistence, self._unsaved = agent, process, persistence, ""
        self._check = None if verifier is None else verifier.check
        self._trace, self._warned = Trace(agent), False
        self._command = CMD_VEL.key(agent.robot)
        self._withheld = frozenset((self._command, ALIVE.key(agent.robot)) if agent.readonly else ())
        """Keys that are not sent to its robot."""
        self._stepped = False
        self._urgent: set[str] = set()  # keys that are sent to the robot first
        self._fleet: set[str] = set()  # keys that are sent to the fleet too
        self._received = frozenset(agent.subscriptions)
        self._alive = ALIVE.key(agent.robot)
        self._repeated: set[str] = set()
        self._inbox: Sequence[Sample] = ()
        self._around = Surroundings()
        self._refused_due = float("-inf")  # [s, monotonic]
        self.dropped: Mapping[str, int] = agent.dropped

    @property
    def due(self) -> float:
        """When the agent wants a step [s, monotonic]."""
        return self._agent.due

    def declare(self) -> None:
        """Declare all keys that are published and received on both sides. Raises BusError."""
        bus, robot = self._process.bus, self._process.robot
        for topic, key in self._agent.publications:
            robot.advertise(topic, key)
            if topic.side == "robot":
                self._urgent.add(key)
            if topic.name != ALIVE.name:
                bus.advertise(topic, key)
                self._fleet.add(key)
        for key in dict.fromkeys((*self._agent.subscriptions, SCAN.key(self._agent.robot))):
            topic = address(key).topic
            if topic.side == "robot":
                robot.subscribe(topic, key)
                bus.advertise(topic, key)
                self._repeated.add(key)
            else:
                bus.subscribe(key, wakes=topic not in WAITING, check=self._check)
        robot.subscribe(ALIVE, self._alive, from_others=True)
        self._look()

    def step(self, now: Now, inbox: Sequence[Sample], *, tells: bool = True) -> Iterator[Outgoing]:
        """Step the agent with its messages, while `send` takes the result.

        Without `tells` it returns its commands only; the status follows in the next step.
        """
        self._stepped, self._inbox = True, inbox
        if now.mono >= self._refused_due:  # reading it takes a system call
            self._refused_due = now.mono + REFUSED_PERIOD
            self._around = self._around._replace(refused=self._process.bus.refused)
        self._around = around = self._around._replace(rival=any(map(self._of_rival, inbox)))
        self._agent.aware(around)
        received = [sample for sample in inbox if sample.key in self._received]
        if self._persistence is not None and (taken := self._persistence.met(now, received)) is not None:
            self._take(taken)
        commands = self._agent.act(now, received)
        yield from commands
        if tells:
            if commands:
                self._process.let_threads_run()  # the commands may reach the socket before reports are made
            yield from self._agent.tell(now)
        self._trace.stepped(now, Link(around.connected, around.routed, around.rival), received)
        if self._persistence is not None:
            self._persistence.stepped(now)
            if (unsaved := self._persistence.failure) != self._unsaved:
                self._unsaved = unsaved
                _log.error(
                    "what an operator asks may not outlive this process: %s", unsaved or "it can again"
                )

    def begin(self, now: Now) -> None:
        """Restore what the agent before it has saved."""
        for taken in self._persistence.found(now) if self._persistence is not None else ():
            self._take(taken)

    def end(self, now: Now) -> None:
        """Save the state for the next agent."""
        if self._persistence is not None:
            self._persistence.end(now)

    def failed(self, now: Now) -> None:
        """Handle a failed agent: the state that it restored may be the cause."""
        if self._persistence is not None and (failure := self._persistence.failed(now)):
            _log.error(failure)

    def request(self, data: bytes, received: float) -> bytes:
        """Answer an operator's request received at `received` [s, monotonic].

        When it is answered, its effect is saved and survives a kill, or the answer says that it is not saved.
        """
        self._look()  # the answer to a stop needs the present state of the links
        self._agent.aware(self._around)
        reply = self._agent.request(data, received)
        self._trace.requested(data, received)
        if self._persistence is not None:
            self._persistence.requested()
            try:
                if self._stepped:  # the robot does not wait for a disk, nor the operator for a report
                    self.send(self.step(self._process.clock(), (), tells=False))
            finally:
                saved = self._persistence.saved()
            reply = reply if saved else _unsaved(reply)
        return reply

    def halt(self, now: Now, reason: str) -> Iterable[Outgoing]:
        """Return the agent's last messages."""
        self._trace.halted(now)
        return self._agent.halt(now, reason)

    def send(self, outbox: Iterable[Outgoing]) -> None:
        """Send the robot's messages at once; when all are made, the rest, and then to the other side.

        What is sent together wakes the sending thread only once. Then repeat what the last step received
        from the robot.
        """
        bus, robot, outgoing = self._process.bus, self._process.robot, list[Outgoing]()
        for out in outbox:
            outgoing.append(out)
            if out.key in self._urgent and out.key not in self._withheld:
                robot.publish(out.key, out.payload)
        traces = iter([self._traced() for out in outgoing if out.key == self._command])
        for out in outgoing:
            if out.key not in self._urgent:
                bus.publish(out.key, out.payload, out.attachment)
        for out in outgoing:
            if out.key not in self._urgent:
                robot.publish(out.key, out.payload)
            elif out.key in self._fleet:
                bus.publish(out.key, out.payload, next(traces) if out.key == self._command else None)
        inbox, self._inbox = self._inbox, ()
        for sample in inbox:
            if sample.key in self._repeated:
                bus.publish(sample.key, sample.payload)
        self._look()

    def _look(self) -> None:
        """Read how the robot is connected."""
        routed = self._process.robot.routed(self._command)  # None while not connected
        connected, before = routed is not None, self._around
        if (connected, routed) != (before.connected, before.routed):
            self._around = before._replace(connected=connected, routed=routed)

    def _of_rival(self, sample: Sample) -> bool:
        """Whether it is a sign of life of another agent of this robot, and not a farewell."""
        if sample.key != self._alive:
            return False
        try:
            return decode(Number, sample.payload).value >= 0.0
        except BadMessage:
            return False

    def _take(self, taken: Taken) -> None:
        if taken.restored is not None:
            self._trace.restored(taken.restored)
        if taken.news:
            _log.warning(taken.news)

    def _traced(self) -> bytes | None:
        """The trace of the newest command; a failure is logged once."""
        trace = self._trace.attachment()
        if self._trace.failures and not self._warned:
            self._warned = True
            _log.warning("a recording of this run cannot be verified everywhere: %s", self._trace.failure)
        return trace


def _unsaved(reply: bytes) -> bytes:
    """Return the same answer, with a warning that a restart may undo it."""
    decoded = json_message.decode(OperatorReply, reply)
    return json_message.encode(decoded.model_copy(update={"reason": UNSAVED})) if decoded.ok else reply


def drive(
    agent: Agent,
    process: Runtime,
    *,
    persistence: Persistence | None = None,
    verifier: Verifier | None = None,
) -> Pauses:
    """Declare, wait for a monitor if requested, then drive the robot until told to stop.

    `persistence` has the saved state of the agent before it and of this one; `verifier` decides which orders
    count, where there are certificates.
    """
    sides = Sides(agent, process, persistence=persistence, verifier=verifier)
    sides.begin(process.clock())
    sides.declare()
    process.bus.answer(ORDER.key(agent.robot), sides.request)
    process.ready(STATUS.key(agent.robot))
    try:
        yield from process.loop(sides, sides.send)
    except Exception:
        sides.failed(process.clock())
        raise
    finally:
        sides.end(process.clock())
