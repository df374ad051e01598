"""`formation run` with small scripts in place of its processes."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from formation.deploy import cli
from formation.deploy.local import run
from formation.deploy.local.plan import Program
from formation.deploy.terminal.snapshot import Progress
from formation.deploy.terminal.views import PlainLines
from formation.mission.file import load
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.words import as_json
from formation.wire import Now
from tests.processes.deploy.stubs import program

SEEN = as_json(Metrics(load("turtlebot3_pair")).snapshot(Now(0.0, 0.0))) | {"formation_error": 0.002}
SNAPSHOT = f"say('snapshot', **{SEEN!r});"
AGENT = "until_told(); say('summary', published={'robot1/cmd_vel': 10, 'robot1/odom': 10}); sys.exit(0)"
AT_ROBOT = {"published": {"robot1/odom": 12, "robot1/ground_truth": 12}, "received": {"robot1/cmd_vel": 9}}
ROBOTS = f"until_told(); say('summary', published={{}}, robot={AT_ROBOT!r}); sys.exit(0)"
FOUND: dict[str, Any] = {
    "published": {"formation/error": 5},
    "recorded": {
        "formation/error": 5,
        "robot1/cmd_vel": 10,
        "robot1/odom": 10,
        "robot1/ground_truth": 12,
    },
    "formation_error": 0.002,
    "settling_time": 1.5,
    "settled_at": 1.5,
    "converged": True,
    "recording": "a.mcap",
}


def monitor(**found: Any) -> str:
    return f"until_told({SNAPSHOT!r}); say('summary', **{ {**FOUND, **found}!r}); sys.exit(0)"


class RunResult(NamedTuple):
    code: int
    out: str
    err: str

    @property
    def result(self) -> dict[str, Any]:
        found = json.loads(self.out.splitlines()[-1])
        assert isinstance(found, dict)
        return found


class Runner:
    """Runs `formation run` with the given scripts; its mission is `turtlebot3_pair` by default."""

    def __init__(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        self._folder, self._monkeypatch, self._capsys = folder, monkeypatch, capsys
        monkeypatch.setattr("formation.deploy.local.launch.COASTING_TIME", 0.01)
        monkeypatch.setattr("tempfile.tempdir", str(folder))
        self.requested: dict[str, Any] = {}
        """Keyword arguments that `programs` has received."""
        begun = folder / "begun"
        self.once_begun = f"[time.sleep(0.01) for _ in iter(lambda: os.path.exists({str(begun)!r}), True)]"
        """Code for a script: wait until all processes are ready and the run has begun."""
        self._left = Progress.__dict__["left"]  # the property object
        show = PlainLines.show

        def show_and_mark(view: PlainLines, progress: Progress) -> None:
            if progress.phase == "running":
                begun.touch()
            show(view, progress)

        monkeypatch.setattr(PlainLines, "show", show_and_mark)

    def __call__(
        self,
        *stubs: Program,
        flags: Sequence[str] = ("--json",),
        duration: float = 0.3,
        record: str = "a.mcap",
        mission: str = "turtlebot3_pair",
        until_dead: Collection[str] = (),
    ) -> RunResult:
        """Run for `duration` [s], and until the processes `until_dead` are known to have ended."""

        def left(progress: Progress) -> float:
            time: float = self._left.__get__(progress)
            return time if progress.dead.keys() >= set(until_dead) else max(time, 0.1)

        def programs(*_: object, **requested: Any) -> tuple[Program, ...]:
            self.requested = requested
            return stubs

        self._monkeypatch.setattr(run, "programs", programs)
        self._monkeypatch.setattr(Progress, "left", property(left))
        (self._folder / "begun").unlink(missing_ok=True)
        path = self._folder / "recordings" / record
        line = ["run", mission, "--duration", str(duration), "--record", str(path), *flags]
        return RunResult(cli.main(line), *self._capsys.readouterr())


def good_programs(found: str = monitor()) -> tuple[Program, ...]:
    return (
        program(found, "monitor", "watch"),
        program(ROBOTS, "robots", "body"),
        program(AGENT, "agent robot1", "control")._replace(robots=("robot1",)),
    )
