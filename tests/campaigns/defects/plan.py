"""One rehearsal of a defective product."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

MISSIONS = Path(__file__).parent / "missions"


class Told(NamedTuple):
    """What an operator orders, or does to a process or the network."""

    at: float  # [s]
    do: str
    what: dict[str, Any] = {}  # noqa: RUF012 - never changed


class Plan(NamedTuple):
    """A mission, a seed, and what disturbs it."""

    mission: str  # a shipped one, or a file of `MISSIONS` without its ending
    seed: int = 0
    kinds: tuple[str, ...] = ()  # kinds of faults that are drawn; ``all`` for all that are possible
    faults: tuple[str, ...] = ()  # faults as they are typed
    loss: float = 0.0
    delay: float = 0.0
    noise: float = 0.0
    seconds: float = 0.0
    signed: bool = False
    recorded: bool = False  # whether a monitor records it, and the recording is verified
    told: tuple[Told, ...] = ()  # orders of an operator, instead of drawn faults

    @property
    def source(self) -> str:
        """The mission as a command line names it."""
        own = MISSIONS / f"{self.mission}.toml"
        return str(own) if own.exists() else self.mission

    @property
    def words(self) -> str:
        """The plan in short, as on the command line of ``formation rehearse``."""
        words = [self.mission, f"--seed {self.seed}"]
        words += [f"--faults {','.join(self.kinds)}"] if self.kinds else []
        words += [f"--fault {one}" for one in self.faults]
        numbers = {name: getattr(self, name) for name in ("loss", "delay", "noise", "seconds")}
        words += [f"--{name} {value:g}" for name, value in numbers.items() if value]
        words += ["--signed"] * self.signed + ["recorded"] * self.recorded
        return ", ".join([" ".join(words), *(f"{one.do} at {one.at:g} s" for one in self.told)])
