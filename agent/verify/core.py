"""Every agent of a recording lived through once more, message by message, in bounded memory.

Each command is taken up when all that its trace names has passed: the messages lie shortly before it in the
recording, or shortly after. Nothing here looks at a clock but at the recorder's, as the messages have it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from functools import lru_cache

from agent.verify.replica import Replica, Said
from agent.verify.shelf import Shelf, Title
from agent.verify.traced import BadTraceError, read
from agent.verify.verdict import TOLERANCE, Comparison, Verdict
from formation.mission import Mission
from formation.ros2.ros_names import address
from formation.topics import BALLOT, CMD_VEL, ODOM, POSE, POSITION, RELATIVE, SCAN
from formation.wire import Sample

LATE = 3.0
"""So long after a command what it followed from may come into the recording [s]."""
LEAP = 1.0
"""More than this between two messages is a clock that was set, or a pause: nothing comes late in it [s]."""
MAX_WAITING = 2000
"""Commands of one robot that wait for what they followed from: three seconds at 200 Hz have 600."""
MOST_VOICES = 16
"""Agents of one robot that are told apart at a time."""
_HEARD = frozenset({BALLOT, ODOM, POSE, POSITION, RELATIVE, SCAN})


class Verification:
    """What comes of living a recording through once more. Take its messages in their order, then `close`."""

    def __init__(self, mission: Mission, law: str | None = None, tolerance: float = TOLERANCE) -> None:
        """Agents go by `mission`, and by the law that they were recorded with unless `law` says otherwise.

        `tolerance` [m/s; rad/s] is how far off a command may be and still count as the same.
        """
        self.verdicts = {robot: Verdict(robot, tolerance) for robot in mission.followers}
        """By robot."""
        self._lines = {
            CMD_VEL.key(robot): _Line(mission, law, verdict) for robot, verdict in self.verdicts.items()
        }
        self._shelf = Shelf()
        self._awaited: dict[str, frozenset[Title]] = {}  # what a line waits for
        self._due: deque[tuple[float, str]] = deque()  # until when
        self._moment, self._wall = 0.0, float("inf")

    def take(self, sample: Sample, wall: float) -> None:
        """Take the next message, which was recorded at `wall` [s]."""
        self._moment += min(max(wall - self._wall, 0.0), LEAP)
        self._wall = wall
        if sample.key in self._lines:
            if self._lines[sample.key].add(sample, wall, self._moment + LATE):
                self._due.append((self._moment + LATE, sample.key))
                self._proceed(sample.key)
        elif _may_be_heard(sample.key):
            title = self._shelf.put(sample, self._moment)
            for key in [key for key, awaited in self._awaited.items() if title in awaited]:
                self._proceed(key)
        while self._due and self._due[0][0] <= self._moment:
            self._proceed(self._due.popleft()[1])

    def close(self) -> None:
        """There will be no more."""
        self._moment = float("inf")
        for key in self._lines:
            self._proceed(key)

    def _proceed(self, key: str) -> None:
        """Judge the commands of a line that can be, or that have waited long enough."""
        awaited = self._lines[key].judge(self._shelf, self._moment)
        self._awaited.pop(key, None)
        if awaited:
            self._awaited[key] = awaited


class _Line:
    """One robot's commands, in the order of recording."""

    def __init__(self, mission: Mission, law: str | None, verdict: Verdict) -> None:
        self._mission, self._law, self._verdict = mission, law, verdict
        self._waiting: deque[tuple[Said, float]] = deque()  # and until when
        self._replicas: dict[str, Replica] = {}  # by voice

    def add(self, sample: Sample, wall: float, until: float) -> bool:
        """Have a command wait to be judged; whether it can be, for its trace."""
        if sample.attachment is None:
            self._verdict.passed_over(wall, "no trace of it in the recording")
            return False
        try:
            traced = read(sample.attachment)
        except BadTraceError as bad:
            self._verdict.passed_over(wall, f"its trace cannot be read: {bad}")
            return False
        self._waiting.append((Said(traced, sample.payload, wall), until))
        return True

    def judge(self, shelf: Shelf, moment: float) -> frozenset[Title]:
        """Judge all that can be judged, or has waited long enough by `moment`; what the next waits for."""
        while self._waiting:
            said, until = self._waiting[0]
            replica = self._replica(said.traced.voice)
            try:
                missing = frozenset(title for title in replica.needs(said.traced) if title not in shelf)
                if missing and moment < until and len(self._waiting) <= MAX_WAITING:
                    return missing
                self._count(said, replica.follow(said, shelf))
            except BadTraceError as bad:
                self._count(said, f"its trace cannot be followed: {bad}")
            self._waiting.popleft()
        return frozenset()

    def _count(self, said: Said, result: Comparison | str | None) -> None:
        if said.traced.agent is not None and len(self._verdict.missions) < MOST_VOICES:
            self._verdict.missions.add(said.traced.agent.mission)
        if isinstance(result, Comparison):
            self._verdict.compared_one(result)
        else:
            self._verdict.passed_over(said.wall, result)

    def _replica(self, voice: str) -> Replica:
        if voice not in self._replicas:
            if len(self._replicas) == MOST_VOICES:
                del self._replicas[next(iter(self._replicas))]
            late = (
                "another agent speaks from here on, whose beginning is"
                if self._replicas
                else "its agent's beginning is"
            )
            self._replicas[voice] = Replica(
                self._mission, self._verdict.robot, self._law, late=f"{late} not in the recording"
            )
        return self._replicas[voice]


@lru_cache(4096)
def _may_be_heard(key: str) -> bool:
    """Whether an agent may listen to it."""
    try:
        return address(key).topic in _HEARD
    except ValueError:
        return False


def verify(
    mission: Mission,
    messages: Iterable[tuple[Sample, float]],
    law: str | None = None,
    tolerance: float = TOLERANCE,
) -> dict[str, Verdict]:
    """What comes of each robot; `messages` with their times [s, recorder's clock], in recorded order."""
    verification = Verification(mission, law, tolerance)
    for sample, wall in messages:
        verification.take(sample, wall)
    verification.close()
    return verification.verdicts
