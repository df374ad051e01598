"""Run every agent of a recording again, message by message, in bounded memory.

Each command is judged when all messages that its trace names have passed: they are shortly before it in
the recording, or shortly after. The only clock is that of the recorder, as the messages contain it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from functools import lru_cache

from formation.agent.persistence.trace import BadTraceError, read
from formation.agent.verify.replica import Comparison, MessageBuffer, RecordedCommand, Replica, Title
from formation.mission.model import Mission
from formation.ros2.ros_names import address
from formation.topics import CMD_VEL, TABLE
from formation.wire import Sample

COMMAND_TOLERANCE = 1e-9
"""Greatest difference of commands that count as the same [m/s; rad/s]."""
LEAD_IN_TIME = 6.0
"""Time after a robot's first command in which no command has to be judged [s]: a recording that began
after its agents is followed from the first state in its trace, which comes within five seconds."""
MOST_STRETCHES = 200
"""Most stretches that are listed one by one; the rest are counted together."""
MAX_INPUT_DELAY = 3.0
"""Time after a command in which its inputs may still follow in the recording [s]."""
MAX_MESSAGE_GAP = 1.0
"""Longer gaps between two messages are a clock that was set, or a pause: no message comes late in them
[s]."""
MAX_WAITING = 2000
"""Most commands of one robot that wait for their inputs: three seconds at 200 Hz have 600."""
MOST_PUBLISHERS = 16
"""Most agents of one robot that are distinguished at a time."""
_INPUTS = frozenset(topic for topic in TABLE if topic.agent_input)


@dataclass
class Stretch:
    """Consecutive commands that could not be judged."""

    since: float
    """[s, system clock of the recorder]"""
    until: float
    commands: int
    reason: str


@dataclass
class Verdict:
    """The result for one robot."""

    robot: str
    tolerance: float = COMMAND_TOLERANCE
    """[m/s; rad/s]"""
    commands: int = 0
    """In the recording."""
    lost: int = 0
    """Missing in the recording, by the numbers of those before and after."""
    compared: int = 0
    lead_in: int = 0
    """Commands before the first that was compared, in the first `LEAD_IN_TIME` seconds."""
    exact: int = 0
    """The same to the last bit."""
    differing: int = 0
    """Off by more than the tolerance."""
    most_off: tuple[float, float] = (0.0, 0.0)
    """[m/s; rad/s]"""
    first: Comparison | None = None
    """The first that differs."""
    unjudged: list[Stretch] = field(default_factory=list)
    missions: set[str] = field(default_factory=set)
    """Fingerprints of the recorded agents' missions."""
    _judging: bool = False
    _began: float | None = None

    @property
    def share(self) -> float:
        """Share of its commands that were compared, 0 to 1, without the lead-in; 0 if there are none."""
        counted = self.commands + self.lost - self.lead_in
        return self.compared / counted if counted else 0.0

    def compared_one(self, one: Comparison) -> None:
        """Count a comparison."""
        self._judging = True
        self.commands += 1
        self.compared += 1
        self.exact += one.exact
        speed, turn_rate = one.off
        self.most_off = max(self.most_off[0], speed), max(self.most_off[1], turn_rate)
        if not (speed <= self.tolerance and turn_rate <= self.tolerance):
            self.differing += 1
            self.first = self.first or one

    def passed_over(self, wall: float, reason: str | None) -> None:
        """Count a command that could not be judged; without a `reason` for the reason before."""
        self.commands += 1
        self._began = wall if self._began is None else self._began
        if not self.compared and wall - self._began <= LEAD_IN_TIME:
            self.lead_in += 1
        new = not self.unjudged or self._judging or (reason and reason != self.unjudged[-1].reason)
        self._judging = False
        if new and len(self.unjudged) < MOST_STRETCHES:
            self.unjudged.append(Stretch(wall, wall, 0, reason or "what came before is not known"))
        elif new:
            self.unjudged[-1].reason = "several reasons"
        self.unjudged[-1].until = wall
        self.unjudged[-1].commands += 1


class Verification:
    """Verifies a recording. Pass its messages to `process_sample` in their order, then call `close`."""

    def __init__(
        self, mission: Mission, law: str | None = None, tolerance: float = COMMAND_TOLERANCE
    ) -> None:
        """Run agents with `mission`, and with the law that they were recorded with unless `law` is given.

        `tolerance` [m/s; rad/s] is the greatest difference of commands that count as the same.
        """
        self.verdicts = {robot: Verdict(robot, tolerance) for robot in mission.followers}
        """By robot."""
        self._lines = {
            CMD_VEL.key(robot): _Line(mission, law, verdict) for robot, verdict in self.verdicts.items()
        }
        self._buffer = MessageBuffer()
        self._awaited: dict[str, frozenset[Title]] = {}  # what a line waits for
        self._due: deque[tuple[float, str]] = deque()  # until when
        self._moment, self._wall = 0.0, float("inf")

    def process_sample(self, sample: Sample, wall: float) -> None:
        """Process the next message, recorded at `wall` [s]."""
        self._moment += min(max(wall - self._wall, 0.0), MAX_MESSAGE_GAP)
        self._wall = wall
        if sample.key in self._lines:
            if self._lines[sample.key].add(sample, wall, self._moment + MAX_INPUT_DELAY):
                self._due.append((self._moment + MAX_INPUT_DELAY, sample.key))
                self._proceed(sample.key)
        elif _may_be_received(sample.key):
            title = self._buffer.put(sample, self._moment)
            for key in [key for key, awaited in self._awaited.items() if title in awaited]:
                self._proceed(key)
        while self._due and self._due[0][0] <= self._moment:
            self._proceed(self._due.popleft()[1])

    def close(self) -> None:
        """End the recording."""
        self._moment = float("inf")
        for key in self._lines:
            self._proceed(key)

    def _proceed(self, key: str) -> None:
        """Judge the commands of a robot that are ready, or have waited long enough."""
        awaited = self._lines[key].judge(self._buffer, self._moment)
        self._awaited.pop(key, None)
        if awaited:
            self._awaited[key] = awaited


class _Line:
    """One robot's commands, in the order of recording."""

    def __init__(self, mission: Mission, law: str | None, verdict: Verdict) -> None:
        self._mission, self._law, self._verdict = mission, law, verdict
        self._waiting: deque[tuple[RecordedCommand, float]] = deque()  # and until when
        self._replicas: dict[str, Replica] = {}  # by publisher id
        self._untraced = 0  # commands without a readable trace since the last gap in the numbers

    def add(self, sample: Sample, wall: float, until: float) -> bool:
        """Queue a command to be judged; whether its trace allows that."""
        if sample.attachment is None:
            self._untraced += 1
            self._verdict.passed_over(wall, "no trace of it in the recording")
            return False
        try:
            traced = read(sample.attachment)
        except BadTraceError as bad:
            self._untraced += 1
            self._verdict.passed_over(wall, f"its trace cannot be read: {bad}")
            return False
        self._waiting.append((RecordedCommand(traced, sample.payload, wall), until))
        return True

    def judge(self, buffer: MessageBuffer, moment: float) -> frozenset[Title]:
        """Judge all commands that are ready, or overdue at `moment`; return what the next waits for."""
        while self._waiting:
            command, until = self._waiting[0]
            replica = self._replica(command.traced.publisher_id)
            try:
                missing = frozenset(title for title in replica.needs(command.traced) if title not in buffer)
                if missing and moment < until and len(self._waiting) <= MAX_WAITING:
                    return missing
                self._count_lost(replica.missing(command.traced))
                self._count(command, replica.follow(command, buffer))
            except BadTraceError as bad:
                self._count(command, f"its trace cannot be followed: {bad}")
            self._waiting.popleft()
        return frozenset()

    def _count_lost(self, missing: int) -> None:
        """Count commands that the numbers show to be missing, except those that came without a trace."""
        if missing:
            self._verdict.lost += max(0, missing - self._untraced)
            self._untraced = 0

    def _count(self, command: RecordedCommand, result: Comparison | str | None) -> None:
        if command.traced.agent is not None and len(self._verdict.missions) < MOST_PUBLISHERS:
            self._verdict.missions.add(command.traced.agent.mission)
        if isinstance(result, Comparison):
            self._verdict.compared_one(result)
        else:
            self._verdict.passed_over(command.wall, result)

    def _replica(self, publisher_id: str) -> Replica:
        if publisher_id not in self._replicas:
            if len(self._replicas) == MOST_PUBLISHERS:
                del self._replicas[next(iter(self._replicas))]
            late = (
                "another agent publishes from here on; its beginning is"
                if self._replicas
                else "its agent's beginning is"
            )
            self._replicas[publisher_id] = Replica(
                self._mission, self._verdict.robot, self._law, late=f"{late} not in the recording"
            )
        return self._replicas[publisher_id]


@lru_cache(4096)
def _may_be_received(key: str) -> bool:
    """Whether an agent may subscribe to it."""
    try:
        return address(key).topic in _INPUTS
    except ValueError:
        return False
