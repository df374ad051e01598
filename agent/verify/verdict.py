"""The result of running one robot's agent again."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

COMMAND_TOLERANCE = 1e-9
"""Greatest difference of commands that count as the same [m/s; rad/s]."""
LEAD_IN_TIME = 6.0
"""Time after a robot's first command in which no command has to be judged [s]: a recording that began
after its agents is followed from the first state in its trace, which comes within five seconds."""
MOST_STRETCHES = 200
"""Most stretches that are listed one by one; the rest are counted together."""


class PublishedCommand(NamedTuple):
    """A command and its payload."""

    speed: float
    """[m/s]"""
    turn_rate: float
    """[rad/s]"""
    payload: bytes


class Input(NamedTuple):
    """A message that is an input of a command."""

    key: str
    age: float
    """Its age at the time of the command [s]."""


class Comparison(NamedTuple):
    """A recorded command and the one computed from the same inputs."""

    wall: float
    """When it was recorded [s, system clock of the recorder]."""
    number: int
    """Number of the command, by agent."""
    recorded: PublishedCommand | None
    """None if it is no command."""
    computed: PublishedCommand | None
    """None if this agent sends nothing, or fails."""
    decision: str
    """State of the computing agent, and its reason."""
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
        """Their difference [m/s; rad/s]; infinite if one is missing."""
        if self.recorded is None or self.computed is None:
            return float("inf"), float("inf")
        one, other = self.recorded, self.computed
        return abs(one.speed - other.speed), abs(one.turn_rate - other.turn_rate)


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
