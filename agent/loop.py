"""An agent on its two buses: what goes to which side, and in what order.

    what it says     it says on both sides, first on the side that it is for: commands to its robot, before
                     anything else is made or sent; positions and status to the fleet
    what it hears    from its robot it repeats to the fleet, byte for byte and last, so that who watches the
                     fleet sees what the agent saw

On the robot's side positions and status are ROS 2 topics, without the order. `ALIVE` is between an agent and
its guard and stays there; that of another agent of the same robot is heard too. An agent that is
``readonly`` sends its robot neither commands nor signs of life.
What the fleet hears of a command carries its trace (`agent.trace`), made when the robot has long had it.
How it is connected it looks up when all is said, for the next step: no command waits for that.
What is kept for the agent's successor (`agent.legacy`) is written by other threads.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from agent.core import Agent
from agent.keeping import Keeping, boot_id
from agent.legacy import Legacy
from agent.status import Surroundings
from agent.survival import Taken
from agent.trace import Trace
from formation import order
from formation.order import OperatorReply
from formation.ros2.messages import Number, decode
from formation.ros2.ros_names import address
from formation.topics import ALIVE, BALLOT, CMD_VEL, ORDER, POSITION, SCAN, STATUS
from formation.transport.process import Process, clocks
from formation.transport.verifying import Verifier
from formation.wire import BadMessage, Now, Outgoing, Sample

WAITING = frozenset((POSITION, BALLOT))
"""What waits for the robot's next own message: it changes nothing before that, and comes more often."""
REFUSED_PERIOD = 0.5
"""[s]"""
UNKEPT = "cannot be kept just now: a restart may undo it"
"""What an operator reads whose request is obeyed, and is in no file."""
_log = logging.getLogger(__name__)


class Sides:
    """An agent between its robot and the fleet."""

    def __init__(
        self,
        agent: Agent,
        process: Process,
        *,
        readonly: bool,
        legacy: Legacy | None = None,
        verifier: Verifier | None = None,
        clock: Callable[[], Now] = clocks,
    ) -> None:
        self._agent, self._process, self._legacy, self._unkept = agent, process, legacy, ""
        self._check = None if verifier is None else verifier.check
        self._trace, self._warned = Trace(agent), False
        self._command = CMD_VEL.key(agent.robot)
        self._unspoken = frozenset((self._command, ALIVE.key(agent.robot)) if readonly else ())
        """What its robot is not told."""
        self._clock, self._stepped = clock, False
        self._urgent: set[str] = set()  # what is for the robot first
        self._fleet: set[str] = set()  # what the fleet is told as well
        self._heard = frozenset(agent.subscriptions)
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
        """Declare all that is said and heard on both sides. Raises BusError."""
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
        robot.subscribe(ALIVE, self._alive, overheard=True)
        self._look()

    def step(self, now: Now, inbox: Sequence[Sample], *, tells: bool = True) -> Iterator[Outgoing]:
        """Step the agent, with what concerns it, as `send` takes what it says.

        Without `tells` it gives its commands only; how it does, it says with the next step.
        """
        self._stepped, self._inbox = True, inbox
        if now.mono >= self._refused_due:  # to ask costs a look into a pipe
            self._refused_due = now.mono + REFUSED_PERIOD
            self._around = self._around._replace(refused=self._process.bus.refused)
        self._around = around = self._around._replace(rival=any(map(self._of_rival, inbox)))
        self._agent.aware(around)
        heard = [sample for sample in inbox if sample.key in self._heard]
        if self._legacy is not None and (taken := self._legacy.met(now, heard)) is not None:
            self._take(taken)
        commands = self._agent.act(now, heard)
        yield from commands
        if tells:
            if commands:
                os.sched_yield()  # the thread that writes them to the socket may run before reports are made
            yield from self._agent.tell(now)
        self._trace.stepped(now, (around.connected, around.routed, around.rival), heard)
        if self._legacy is not None:
            self._legacy.stepped(now)
            if (unkept := self._legacy.failure) != self._unkept:
                self._unkept = unkept
                _log.error("what an operator asks may not outlive this process: %s", unkept or "it can again")

    def begin(self, now: Now) -> None:
        """Have the agent know what the one before it has left."""
        for taken in self._legacy.found(now) if self._legacy is not None else ():
            self._take(taken)

    def end(self, now: Now) -> None:
        """Leave to the next what it has learned."""
        if self._legacy is not None:
            self._legacy.end(now)

    def failed(self, now: Now) -> None:
        """The agent has failed: what it took over from the one before it may be the cause."""
        if self._legacy is not None and (said := self._legacy.failed(now)):
            _log.error(said)

    def request(self, data: bytes, heard: float) -> bytes:
        """Answer an operator's request, which came at `heard` [s, monotonic].

        What is to be kept of it is, by then, safe from a kill.
        Or the answer says that it is not.
        """
        self._look()  # whether a stop reaches the robot is answered by how it is connected now
        self._agent.aware(self._around)
        reply = self._agent.request(data, heard)
        self._trace.asked(data, heard)
        if self._legacy is not None:
            self._legacy.asked()
            try:
                if self._stepped:  # the robot does not wait for a disk, nor the operator for a report
                    self.send(self.step(self._clock(), (), tells=False))
            finally:
                kept = self._legacy.kept()
            reply = reply if kept else _unkept(reply)
        return reply

    def halt(self, now: Now, reason: str) -> Iterable[Outgoing]:
        """The agent's last words."""
        self._trace.halted(now)
        return self._agent.halt(now, reason)

    def send(self, outbox: Iterable[Outgoing]) -> None:
        """Send what is for the robot at once; when all is made, the rest, and then to the other side.

        What goes out together wakes the thread that sends it once, and not again for each. Then repeat what
        the last step heard from the robot.
        """
        bus, robot, said = self._process.bus, self._process.robot, list[Outgoing]()
        for out in outbox:
            said.append(out)
            if out.key in self._urgent and out.key not in self._unspoken:
                robot.publish(out.key, out.payload)
        traces = iter([self._traced() for out in said if out.key == self._command])
        for out in said:
            if out.key not in self._urgent:
                bus.publish(out.key, out.payload, out.attachment)
        for out in said:
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
        """See how the robot is connected."""
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
        if taken.memory:
            self._trace.recalled(taken.memory)
        if taken.news:
            _log.warning(taken.news)

    def _traced(self) -> bytes | None:
        """The trace of the newest command; that there can be none is said once."""
        trace = self._trace.attachment()
        if self._trace.failures and not self._warned:
            self._warned = True
            _log.warning("a recording of this run cannot be verified everywhere: %s", self._trace.failure)
        return trace


def _unkept(reply: bytes) -> bytes:
    """The same answer; who obeys says that it may not do so after a restart."""
    said = order.decode(OperatorReply, reply)
    return order.encode(said.model_copy(update={"reason": UNKEPT})) if said.ok else reply


def drive(
    agent: Agent,
    process: Process,
    *,
    readonly: bool,
    state: Keeping | None = None,
    verifier: Verifier | None = None,
) -> None:
    """Declare, wait for whoever watches, then drive the robot until told to stop.

    `state` is where the agent finds what the one before it has left, and leaves what it has learned;
    `verifier` tells which orders count, where there are certificates.
    """
    legacy = None if state is None else Legacy(agent, state, boot_id())
    sides = Sides(agent, process, readonly=readonly, legacy=legacy, verifier=verifier)
    sides.begin(clocks())
    sides.declare()
    process.bus.answer(ORDER.key(agent.robot), sides.request)
    process.ready(STATUS.key(agent.robot))
    try:
        process.run(sides, sides.send)
    except Exception:
        sides.failed(clocks())
        raise
    finally:
        sides.end(clocks())
