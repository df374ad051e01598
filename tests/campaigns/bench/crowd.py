"""Many robots' publishers: what their agents tell the fleet, as bytes and as often, for a monitor to hear.

python -m tests.campaigns.bench.crowd PLAN

It computes nothing: every message is a template with its stamp, its place and its count put in. What it says
on stdout: ``ready`` when a monitor listens to everything; after a line with a number of seconds on stdin, it
speaks for so long and says how many messages it handed to Zenoh, by key. Like agents it drops what the
network does not take, unless the plan says that it waits.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from typing import Any, NamedTuple

from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import AgentState, AgentStatus, LeaderState, LeaderStatus, RobotLink
from formation.protocol.status_codec import to_message
from formation.ros2.messages import Odometry, Pose, Twist, encode
from formation.topics import CMD_VEL, ODOM, POSITION, STATUS, Topic
from formation.transport.bus import Bus, BusConfig
from formation.transport.runtime.process import say

SHAPE, LEADER = "block", "leader"
SPEED = 0.2
"""Of everybody, along x [m/s]."""
MEMORY = 4000
"""Bytes of an agent's memory, which every hundredth command carries."""
PATIENCE = 60.0
"""For the monitor [s]."""
_STAMP, _PLACE = struct.Struct("<iI"), struct.Struct("<d")


def names(robots: int) -> list[str]:
    """The leader and so many followers."""
    return [LEADER, *(f"robot{i:03}" for i in range(1, robots + 1))]


def slot(number: int) -> complex:
    """Where follower `number` belongs, ten in a row, a metre apart [m]."""
    row, place = divmod(number - 1, 10)
    return complex(-1.0 - row, place - 4.5)


def mission(robots: int, rate: float) -> str:
    """The file of a mission in which every follower measures the two before it."""
    everybody = names(robots)
    lines = ['name = "crowd"', f'leader = "{LEADER}"', "[robot]", "control_point_offset = 0.2"]
    lines += ["max_speed = 1.5", "max_turn_rate = 1.5", f"rate = {rate:g}", f"[shapes.{SHAPE}]"]
    lines += [f"{one} = [{slot(i).real}, {slot(i).imag}]" for i, one in enumerate(everybody) if i]
    lines += [f"[robots.{LEADER}]", "start = { x = 0.0, y = 0.0 }"]
    for i, one in enumerate(everybody[1:], start=1):
        before = ", ".join(f'"{name}"' for name in everybody[max(0, i - 2) : i])
        start = f"{{ x = {slot(i).real}, y = {slot(i).imag}, heading_deg = 0 }}"
        lines += [f"[robots.{one}]", f"neighbours = [{before}]", f"start = {start}"]
    return "\n".join([*lines, "[[route]]", f"speed = {SPEED}", "heading_deg = 0", ""])


class Said(NamedTuple):
    """One message to publish."""

    key: str
    payload: bytes
    attachment: bytes | None = None


class Template:
    """A stamped message whose x is set anew each time."""

    def __init__(self, message: Odometry | Pose) -> None:
        self._bytes = bytearray(encode(message))
        self._at = self._bytes.find(_PLACE.pack(message.position.real))

    def at(self, wall: float, x: float) -> bytes:
        seconds = int(wall)
        _STAMP.pack_into(self._bytes, 4, seconds, int((wall - seconds) * 1e9))
        _PLACE.pack_into(self._bytes, self._at, x)
        return bytes(self._bytes)


class Publisher:
    """What one robot's agent (or the leader) says."""

    def __init__(self, name: str, number: int, rate: float) -> None:
        self._name, self._leads = name, number == 0
        self._offset = 0.0 if self._leads else 0.2
        self._slot = 0j if self._leads else slot(number)
        far = complex(12345.678, self._slot.imag)
        self._odometry = Template(Odometry(0.0, far, 1 + 0j, SPEED, 0.0))
        self._position = Template(Pose(0.0, far, 1 + 0j))
        self._command = encode(Twist(SPEED, 0.01))
        self._count, self._every = 0, max(1, round(rate / 2.0))
        self.number = number

    def topics(self) -> tuple[Topic, ...]:
        return (POSITION, STATUS) if self._leads else (ODOM, CMD_VEL, POSITION, STATUS)

    def period(self, wall: float, since: float) -> Iterator[Said]:
        """What it says in one period, `since` seconds after everybody's start."""
        self._count += 1
        x = self._slot.real + SPEED * since
        decoded = Order(term=1, beat=int(since * 20.0) + 1, mode="run", shape=SHAPE)
        if not self._leads:
            yield Said(ODOM.key(self._name), self._odometry.at(wall, x - self._offset))
            yield Said(CMD_VEL.key(self._name), self._command, self._trace(wall))
        spoken = PositionAttachment(publisher_id=f"{self.number:016x}", count=self._count, order=decoded)
        yield Said(
            POSITION.key(self._name), self._position.at(wall, x - self._offset), json_message.encode(spoken)
        )
        if (self._count + self.number) % self._every == 0:
            yield Said(STATUS.key(self._name), self._status(wall))

    def _trace(self, wall: float) -> bytes:
        """As long as an agent's with two neighbours, and now and then with its memory."""
        step = f"[{wall:.9f},{wall:.9f},[[0,{self._count * 7919 % 2**32},{wall:.9f}]]]"
        padding = f',"state":"{"m" * MEMORY}"' if (self._count + self.number) % 100 == 0 else ""
        about = f'"n":{self._count},"publisher_id":"{self.number:016x}"'
        return f'{{{about},"steps":[{step},{step},{step}]{padding}}}'.encode()

    def _status(self, wall: float) -> bytes:
        if self._leads:
            leads = LeaderStatus(robot=self._name, state=LeaderState.RUN, leads=True, leader=self._name)
            return encode(to_message(leads, wall))
        about: dict[str, Any] = {
            "law": "field", "speed": 0.2, "turn_rate": 0.01, "link": RobotLink.CONNECTED,
            "age": {"odometry": 0.012, "one": 0.031, "other": 0.044},
        }  # fmt: skip
        status = AgentStatus(robot=self._name, state=AgentState.RUN, reason=Reason(Code.RUNNING), **about)
        return encode(to_message(status, wall))


def speak(
    publishers: Sequence[tuple[Bus, Publisher]], rate: float, phase: float, seconds: float
) -> tuple[int, float]:
    """Speak for so long, everybody once a period in turn; how many periods, and the worst delay [s].

    What could not be said in time is said late, not left out.
    """
    start, epoch, worst = time.monotonic(), time.time(), 0.0
    step = 1.0 / (rate * len(publishers))
    turns = round(seconds / step)
    for turn in range(turns):
        due = (turn + phase) * step
        wait = start + due - time.monotonic()
        if wait > 0.002:  # a handful go out together: to wake for each would be the generator's load
            time.sleep(wait)
        worst = max(worst, -wait)
        bus, publisher = publishers[turn % len(publishers)]
        since = time.monotonic() - start
        for result in publisher.period(epoch + since, since):
            bus.publish(result.key, result.payload, result.attachment)
    return turns, worst


def main(plan: dict[str, Any]) -> None:
    """Open a link for each endpoint of the plan, and speak for its robots whenever told to."""
    rate, publishers = plan["rate"], list[tuple[Bus, Publisher]]()
    with ExitStack() as stack:
        for endpoint, robots in plan["robots"].items():
            bus = stack.enter_context(Bus(BusConfig(listen=(endpoint,))))
            for number, name in robots:
                publisher = Publisher(name, number, rate)
                for topic in publisher.topics():
                    bus.advertise(topic, topic.key(name), waits=plan["waits"])
                publishers.append((bus, publisher))
        buses = {id(bus): bus for bus, _ in publishers}.values()
        publishers.sort(key=lambda one: one[1].number)  # so that they take turns on the links
        deadline = time.monotonic() + PATIENCE
        while not all(bus.watched(key) for bus in buses for key in bus.advertised):
            if time.monotonic() > deadline:
                raise SystemExit("no monitor listens to everything")
            time.sleep(0.05)
        say("ready")
        for line in sys.stdin:
            begun = time.monotonic()
            periods, late = speak(publishers, rate, plan["phase"], float(line))
            took = time.monotonic() - begun
            published = {key: count for bus in buses for key, count in bus.published.items()}
            say("spoken", periods=periods, late=late, took=took, published=published)


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
