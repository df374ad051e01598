"""The command lines of everybody in the scene: the agent, its two yardsticks, and their surroundings."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import psutil

from formation.agent.core import Agent
from formation.mission.file import load
from formation.protocol import json_message
from formation.ros2.messages import Twist, decode, encode
from formation.ros2.ros_names import address
from formation.topics import ALIVE, CMD_VEL, ODOM, POSITION, STATUS, Topic
from formation.transport.bus import Bus, BusConfig
from formation.transport.runtime.rate import Rate
from formation.transport.session import settings_of
from formation.wire import Now, Outgoing, Sample
from tests.campaigns.bench import edge
from tests.campaigns.bench.processes import ready_to_start
from tests.support.child import free_endpoint

PATIENCE = 30.0
"""For what takes a fraction of a second on an idle machine [s]."""
RUN_UP, TURN = 0.1, 0.4
"""How long a subject is asked as fast as it goes before that counts, and how long it counts [s]."""
LOST = 1.0
"""An answer that has not come by then never will [s]."""


class Exchange(NamedTuple):
    """One odometry and its command [s, monotonic]."""

    sent: float
    answered: float


@dataclass
class Subject:
    """A process under the stopwatch, the robot it drives, and what the two said to each other."""

    name: str
    robot: str
    argv: list[str]
    process: psutil.Popen | None = None
    started: float = 0.0
    """[s, monotonic]"""
    first: float = 0.0
    """When its first command came [s, monotonic]."""
    moving: float = 0.0
    """When its first command came that is not to stand still."""
    waiting: float | None = None
    """Since when a command is awaited."""
    exchanges: list[Exchange] = field(default_factory=list)
    counted: int = 0
    """How many of these are kept when the others are taken back."""
    lost: int = 0

    def start(self) -> None:
        """Start the stopwatch and the process."""
        ready_to_start()
        self.started = time.monotonic()
        self.process = psutil.Popen(self.argv, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)

    def end(self) -> None:
        """Ask the process to end; kill it if it does not."""
        if self.process is None or self.has_ended:
            return
        self.process.terminate()
        try:
            self.process.wait(PATIENCE)
        except psutil.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process = None

    @property
    def pid(self) -> int:
        """Of its process."""
        assert self.process is not None
        return self.process.pid

    @property
    def has_ended(self) -> bool:
        """Whether its process is gone though it was not ended."""
        return self.process is not None and self.process.poll() is not None

    def has_moved(self) -> bool:
        """Whether it has ever sent a command that is not to stand still."""
        return self.moving > 0.0

    def forget(self) -> None:
        """Begin to count."""
        self.exchanges, self.counted, self.lost = [], 0, 0

    def ask(self, bus: Bus, payload: bytes) -> None:
        """Send it its odometry, unless it is up and the command for the last one is still to come."""
        now = time.monotonic()
        if self.has_moved() and self.waiting is not None and now - self.waiting < LOST:
            return
        self.lost += self.waiting is not None
        self.waiting = time.monotonic()
        bus.publish(ODOM.key(self.robot), payload)

    def process_sample(self, sample: Sample) -> None:
        """One of its commands."""
        self.first = self.first or sample.arrived
        if not self.moving and decode(Twist, sample.payload).speed != 0.0:
            self.moving = sample.arrived
        if self.waiting is not None:
            self.exchanges.append(Exchange(self.waiting, sample.arrived))
            self.waiting = None


class Robots:
    """The robots of all subjects, a fraction of a period after each other."""

    def __init__(self, bus: Bus, subjects: Sequence[Subject], origin: float, rate: float) -> None:
        """`origin` is the scene's beginning [s, monotonic], `rate` that of each one's odometry [Hz]."""
        self._bus, self._origin, self._subjects = bus, origin, subjects
        self._rate = Rate(rate * len(subjects))

    def drive(self, until: Callable[[], object], limit: float = PATIENCE) -> None:
        """Send odometry to those that were started, until the condition holds.

        Raises RuntimeError if that takes longer than `limit` [s], or if a subject ends.
        """
        end = time.monotonic() + limit
        while not until():
            ended = [subject.name for subject in self._subjects if subject.has_ended]
            if ended:
                raise RuntimeError(f"{' and '.join(ended)} ended")
            if time.monotonic() > end:
                requested = " and ".join(subject.name for subject in self._subjects if subject.process)
                raise RuntimeError(f"not so within {limit} s: {requested}")
            time.sleep(max(0.0, self._rate.due - time.monotonic()))
            if self._rate.tick(time.monotonic()):
                self._take()
                subject = self._subjects[self._rate.ticks % len(self._subjects)]
                if subject.process is not None:
                    subject.ask(self._bus, self._odometry())

    def drive_for(self, seconds: float) -> None:
        """Send odometry for so long."""
        end = time.monotonic() + seconds
        self.drive(lambda: time.monotonic() >= end, seconds + PATIENCE)

    def race(self, seconds: float) -> dict[str, float]:
        """Have each subject in turn answer as fast as it goes, `seconds` in all; how many answers a second.

        None is asked while it is another's turn, which the agent takes for silence: what it says before it
        is in formation control again does not count.
        """
        raced = dict.fromkeys((subject.name for subject in self._subjects), 0.0)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for subject in self._subjects:
                if subject.has_ended:
                    raise RuntimeError(f"{subject.name} ended")
                self._chase(subject, RUN_UP)
                del subject.exchanges[subject.counted :]
                begun = time.monotonic()
                self._chase(subject, TURN)
                subject.counted = len(subject.exchanges)
                raced[subject.name] += time.monotonic() - begun
        return {subject.name: len(subject.exchanges) / raced[subject.name] for subject in self._subjects}

    def _chase(self, subject: Subject, seconds: float) -> None:
        """The next odometry upon each command, for so long."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            subject.ask(self._bus, self._odometry())
            deadline = time.monotonic() + LOST
            while subject.waiting is not None and (left := deadline - time.monotonic()) > 0.0:
                self._bus.wait(left)
                self._take()

    def _take(self) -> None:
        for sample in self._bus.drain():
            for subject in self._subjects:
                if sample.key == CMD_VEL.key(subject.robot):
                    subject.process_sample(sample)

    def _odometry(self) -> bytes:
        return encode(edge.odometry(time.monotonic() - self._origin, time.time()))


ROBOTS = {"agent": edge.FOLLOWER, "copy": "copy", "echo": "echo"}
"""In whose name each subject speaks."""


class Scene:
    """All processes of the benchmark but the subjects."""

    def __init__(self, folder: Path, rate: float) -> None:
        """`rate` [Hz] is everybody's."""
        self.folder, self.rate, self.origin = folder, rate, time.monotonic()
        self.robot, leader, neighbour, agent, copy = (free_endpoint() for _ in range(5))
        self.mission = folder / "edge.toml"
        self.mission.write_text(edge.mission(rate))
        self._neighbours = {edge.LEADER: leader, edge.NEIGHBOUR: neighbour}
        self._listen = {"agent": agent, "copy": copy}
        self._outbox = _one_step(self.mission, rate)

    def surroundings(self) -> list[str]:
        """Command line of the neighbours and the monitor."""
        monitored = {
            endpoint: [t.key(ROBOTS[who]) for t in (ODOM, CMD_VEL, POSITION, STATUS)]
            for who, endpoint in self._listen.items()
        }
        plan = json.dumps([self.origin, self.rate, self._neighbours, monitored, load(self.mission).tag])
        return [sys.executable, "-m", "tests.campaigns.bench.edge", plan]

    def subjects(self, number: int) -> list[Subject]:
        """Agent, copy and echo; which starts first depends on the number of the round."""
        argv = {"agent": self.agent, "copy": self.copy, "echo": self.echo}
        every = [Subject(name, robot, argv[name]()) for name, robot in ROBOTS.items()]
        return every[number % 3 :] + every[: number % 3]

    def agent(self) -> list[str]:
        """Command line of the agent."""
        return [sys.executable, "-P", "-m", "formation.agent", *self._agent_arguments()]

    def profiled_agent(self, file: Path) -> list[str]:
        """Command line of the agent with stopwatches."""
        profiled = ["-m", "tests.campaigns.bench.profiled_agent", str(file)]
        return [sys.executable, *profiled, *self._agent_arguments()]

    def copy(self) -> list[str]:
        """Command line of the script that does with Zenoh what the agent does."""
        status = [out for out in self._outbox if out.key == STATUS.key(edge.FOLLOWER)]
        fleet = BusConfig(listen=(self._listen["copy"],), connect=tuple(self._neighbours.values()))
        receives = [POSITION.key(robot) for robot in self._neighbours]
        return self._bare("copy", [out for out in self._outbox if out not in status], status, receives, fleet)

    def echo(self) -> list[str]:
        """Command line of the echo."""
        return self._bare("echo", [out for out in self._outbox if out.key == CMD_VEL.key(edge.FOLLOWER)])

    def _agent_arguments(self) -> list[str]:
        dialled = [word for to in self._neighbours.values() for word in ("-e", to)]
        return [
            str(self.mission), "--robot", edge.FOLLOWER, "--log-level", "warning",
            "--robot-connect", self.robot, "-l", self._listen["agent"], *dialled,
        ]  # fmt: skip

    def _bare(
        self,
        who: str,
        answers: Sequence[Outgoing],
        beside: Sequence[Outgoing] = (),
        receives: Sequence[str] = (),
        fleet: BusConfig | None = None,
    ) -> list[str]:
        robot, sides = ROBOTS[who], {"robot": BusConfig(mode="client", connect=(self.robot,))}
        if fleet is not None:
            sides["fleet"] = fleet
        rows = {
            "answers": _rows(robot, answers),
            "repeats": [_row("fleet", ODOM, robot)],
            "beside": _rows(robot, beside),
        }
        plan = {
            "sides": {side: json.loads(str(settings_of(config))) for side, config in sides.items()},
            "answer_to": ODOM.key(robot),
            "hears": receives,
            "period": 0.5,
            **{name: [row for row in some if row["side"] in sides] for name, some in rows.items()},
        }
        return [sys.executable, str(Path(__file__).with_name("bare.py")), json.dumps(plan)]


def _one_step(mission_file: Path, rate: float) -> list[Outgoing]:
    """What an agent in formation control says in one step: command, sign of life, position, status."""
    mission = load(mission_file)
    agent = Agent(mission, edge.FOLLOWER)
    term, outbox = time.time_ns(), list[Outgoing]()
    began = Now(time.monotonic(), time.time())
    for count, beat in enumerate((1000, 1001)):  # the first alone proves no leader alive
        elapsed = count / rate
        now = Now(began.mono + elapsed, began.wall + elapsed)
        attachment = json_message.encode(edge.attachment("bench", beat, mission.tag, term))
        inbox = [
            Sample(POSITION.key(robot), encode(edge.position(robot, elapsed, now.wall)), attachment, now.mono)
            for robot in (edge.LEADER, edge.NEIGHBOUR)
        ]
        odometry = Sample(ODOM.key(edge.FOLLOWER), encode(edge.odometry(elapsed, now.wall)), None, now.mono)
        outbox = list(agent.step(now, [*inbox, odometry]))
    return outbox


def _rows(robot: str, outbox: Sequence[Outgoing]) -> list[dict[str, Any]]:
    """An agent's messages as `bare` wants them, in another robot's name, ordered as an agent sends them."""
    topics = [(address(out.key).topic, out) for out in outbox]
    first = [_row(topic.side, topic, robot, out) for topic, out in topics]
    other = {"robot": "fleet", "fleet": "robot"}
    return first + [_row(other[topic.side], topic, robot, out) for topic, out in topics if topic != ALIVE]


def _row(side: str, topic: Topic, robot: str, out: Outgoing | None = None) -> dict[str, Any]:
    assert topic.qos is not None
    attachment = out.attachment if out and side == "fleet" else None  # ROS has none on the robot's side
    return {
        "side": side,
        "key": topic.key(robot),
        "priority": topic.qos.priority,
        "express": topic.qos.express,
        "payload": (out.payload if out else b"").hex(),
        "attachment": (attachment or b"").hex(),
    }
