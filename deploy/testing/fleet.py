"""What both fleets for tests have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import Self

from formation.control.laws import why_unusable
from formation.mission.file import load, parse
from formation.mission.model import Mission
from formation.monitor.metrics.settling import DWELL_TIME


class DrivenFleet(ABC):
    """A fleet that a test drives, as a context manager."""

    mission: Mission

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run_until_settled(self, within: float = 60.0) -> float:
        """Run until the error stays under the mission's bound; return the time that this took [s].

        Raises AssertionError after `within` seconds.
        """
        began = since = self._time()
        while self._time() < since + DWELL_TIME:
            self._step()
            since = since if self.error() <= self.mission.settled else self._time()
            if since > began + within:
                states = "; ".join(f"{name}: {self.state(name)}" for name in self.mission.followers)
                bound = f"bound {self.mission.settled:g} m{self._origin()}"
                raise AssertionError(
                    f"not settled within {within:g} s: error {self.error():.3f} m, {bound}; {states}"
                )
        return since - began

    @abstractmethod
    def error(self) -> float:
        """Return the formation error, summed over all edges [m]; NaN if unknown."""

    @abstractmethod
    def state(self, robot: str) -> str:
        """Return the state of a follower's agent, such as ``run`` or ``hold``."""

    @abstractmethod
    def close(self) -> None:
        """End all processes."""

    @abstractmethod
    def _time(self) -> float:
        """Return the time by which the fleet runs [s]."""

    @abstractmethod
    def _step(self) -> None:
        """Let it run a little."""

    def _origin(self) -> str:
        """Return what a message adds so that the run can be repeated."""
        return ""


def mission_of(mission: str | Path, law: str | None = None) -> Mission:
    """Return the mission in a file, of a name, or in a text, under `law`. Raises MissionError, ValueError."""
    found = parse(str(mission)) if "\n" in str(mission) else load(mission)
    if (why := why_unusable(law or found.law.kind)) is not None:
        raise ValueError(why)
    return found if law is None else found.under(law)


def check_name(name: str, legal: Iterable[str]) -> None:
    """Raise ValueError for a name that is none of `legal`."""
    if name not in (known := list(legal)):
        raise ValueError(f"{name!r}: must be one of {', '.join(known)}")


def group(names: Iterable[str], legal: Iterable[str]) -> list[str]:
    """Return a group of robots and candidates, which may be the name of one. Raises ValueError."""
    known = list(legal)
    for name in (found := several(names)):
        check_name(name, known)
    return found


def several(texts: Iterable[str]) -> list[str]:
    """Return `texts` as a list; one text is a list of one, not of its letters."""
    return [texts] if isinstance(texts, str) else list(texts)
