"""The pytest plugin: fixtures that make fleets and end them after the test."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import pytest

if TYPE_CHECKING:
    from formation.deploy.testing.processes import ProcessFleet
    from formation.deploy.testing.rehearsed import RehearsedFleet


class MakeRehearsed(Protocol):
    """What the fixture `rehearsed_fleet` gives."""

    def __call__(self, mission: str | Path, **options: Any) -> RehearsedFleet:
        """Start a `RehearsedFleet` with its `options`."""


class MakeProcesses(Protocol):
    """What the fixture `process_fleet` gives."""

    def __call__(self, mission: str | Path, **options: Any) -> ProcessFleet:
        """Start a `ProcessFleet` with its `options`; all its processes are ready."""


# Imported in the fixtures: this file is loaded by every pytest on a machine that has the package.
@pytest.fixture
def rehearsed_fleet() -> Iterator[MakeRehearsed]:
    """Make fleets of all processes of a mission, in memory on a virtual clock."""
    from formation.deploy.testing.rehearsed import RehearsedFleet  # noqa: PLC0415

    with ExitStack() as fleets:

        def make(mission: str | Path, **options: Any) -> RehearsedFleet:
            return fleets.enter_context(RehearsedFleet(mission, **options))

        yield make


@pytest.fixture
def process_fleet(tmp_path: Path) -> Iterator[MakeProcesses]:
    """Make fleets of real processes on this machine, with logs and recordings in `tmp_path`."""
    from formation.deploy.testing.processes import ProcessFleet  # noqa: PLC0415

    with ExitStack() as fleets:
        made: list[ProcessFleet] = []

        def make(mission: str | Path, **options: Any) -> ProcessFleet:
            options.setdefault("folder", tmp_path / f"fleet{len(made)}")
            made.append(fleets.enter_context(ProcessFleet(mission, **options)))
            return made[-1]

        yield make
