"""What came of living one robot's run through once more."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

TOLERANCE = 1e-9
"""Up to this commands are the same [m/s; rad/s]."""
LEAD_IN = 6.0
"""A recording that begins after its agents is followed from the first memory in it on, which comes within
five seconds. So long after a robot's first command nothing has to be judged [s]."""
MOST_STRETCHES = 200
"""So many stretches are told one by one, the rest together."""


class Told(NamedTuple):
    """A command, and the bytes that say it."""

    speed: float
    """[m/s]"""
    turn_rate: float
    """[rad/s]"""
    payload: bytes


class Input(NamedTuple):
    """A message that a command followed from."""

    key: str
    age: float
    """How long before the command it had come [s]."""


class Comparison(NamedTuple):
    """A recorded command beside the one that is computed from the same inputs."""

    wall: float
    """When it was recorded [s, system clock of the recorder]."""
    number: int
    """Which command of its agent."""
    recorded: Told | None
    """None for what is no command."""
    computed: Told | None
    """None where this agent says nothing, or fails."""
    decision: str
    """What the computing agent is doing, and why."""
    inputs: tuple[Input, ...]
    """Since the command before."""

    @property
    def exact(self) -> bool:
        """Whether they are the same to the last bit."""
        return (
            self.recorded is not None
            and self.computed is not None
            and self.recorded.payload == self.computed.payload
        )

    @property
    def off(self) -> tuple[float, float]:
        """By how much they differ [m/s; rad/s]; infinite where one is missing."""
        if self.recorded is None or self.computed is None:
            return float("inf"), float("inf")
        one, other = self.recorded, self.computed
        return abs(one.speed - other.speed), abs(one.turn_rate - other.turn_rate)


@dataclass
class Stretch:
    """Commands in a row that could not be judged."""

    since: float
    """[s, system clock of the recorder]"""
    until: float
    commands: int
    reason: str


@dataclass
class Verdict:
    """On one robot."""

    robot: str
    tolerance: float = TOLERANCE
    """[m/s; rad/s]"""
    commands: int = 0
    """In the recording."""
    compared: int = 0
    lead_in: int = 0
    """Commands before the first that was compared, in the first `LEAD_IN` seconds."""
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
    """Fingerprints of what the recorded agents drove by."""
    _judging: bool = False
    _began: float | None = None

    @property
    def share(self) -> float:
        """Share of its commands that was compared, 0 to 1, without the lead-in; 1 where there are none."""
        counted = self.commands - self.lead_in
        return self.compared / counted if counted else float(not self.commands)

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
        """Count a command that could not be judged; without a `reason` for that of the one before."""
        self.commands += 1
        self._began = wall if self._began is None else self._began
        if not self.compared and wall - self._began <= LEAD_IN:
            self.lead_in += 1
        new = not self.unjudged or self._judging or (reason and reason != self.unjudged[-1].reason)
        self._judging = False
        if new and len(self.unjudged) < MOST_STRETCHES:
            self.unjudged.append(Stretch(wall, wall, 0, reason or "what came before is not known"))
        elif new:
            self.unjudged[-1].reason = "several reasons"
        self.unjudged[-1].until = wall
        self.unjudged[-1].commands += 1
