"""Twenty robots and a leader as processes on this machine, and orders by the command line."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

from formation.deploy.cli import main
from formation.mission.file import load
from formation.mission.model import Mission
from tests.support.child import PATIENCE, Child, free_endpoint, started

LEADER = "leader"
STARTING = 120.0
"""Longest time in which several processes start on a busy machine [s]."""
AT_ONCE = 4
"""Processes that are started together."""
HEAD = """\
name = "twenty"
leader = "leader"

[robot]
rate = 10
max_speed = 0.5
max_turn_rate = 1.5

[[route]]
speed = 0.1
heading_deg = 0
"""


class Given(NamedTuple):
    """Result of an order."""

    code: int
    report: dict[str, Any]
    """Output of `--json`."""
    words: str


class Team:
    """The processes, and orders to them."""

    def __init__(self, file: Path, mission: Mission, children: dict[str, Child]) -> None:
        self.file, self.mission, self.children = file, mission, children

    def order(self, *words: str, seconds: float = PATIENCE) -> Given:
        """Give an order as `formation order` does, which waits `seconds` for answers."""
        out, err = io.StringIO(), io.StringIO()
        with redirect_stdout(out), redirect_stderr(err):
            code = main(["order", str(self.file), *words, "--json", "--timeout", f"{seconds:g}"])
        assert out.getvalue(), err.getvalue()
        return Given(code, json.loads(out.getvalue()), err.getvalue())


def mission_text(robots: int = 20, more: str = "") -> str:
    """Return a mission of `robots` in rows of five; each follows the one ahead and the one beside it."""
    names = [f"robot{number}" for number in range(1, robots + 1)]
    ends = iter(free_endpoint, None)
    tables, slots = [f'[robots.{LEADER}]\nendpoint = "{next(ends)}"\nstart = {{ x = 0, y = 0 }}'], []
    for number, name in enumerate(names):
        row, column = divmod(number, 5)
        x, y = -1.0 - row, column - 2.0
        before = names[number - 5] if row else LEADER
        neighbours = [before, names[number - 1]] if column else [before]
        slots.append(f"{name} = [{x}, {y}]")
        tables.append(
            f"[robots.{name}]\nneighbours = {json.dumps(neighbours)}\nstart = {{ x = {x - 0.1}, y = {y} }}\n"
            f'endpoint = "{next(ends)}"\nrobot_endpoint = "{next(ends)}"'
        )
    return "\n\n".join([HEAD, "[shapes.rows]\n" + "\n".join(slots), *tables, more]) + "\n"


@contextmanager
def twenty(folder: Path, robots: int = 20, more: str = "") -> Iterator[Team]:
    """Start all processes; yield them when ready. `more` is appended to the mission file."""
    file = folder / "twenty.toml"
    file.write_text(mission_text(robots, more))
    mission = load(file)
    under = ("--parent", str(os.getpid()), "--log-level", "warning")
    commands: dict[str, tuple[str, ...]] = {"robots": ("formation.agent.simulated", str(file))}
    commands |= {LEADER: ("formation.leader", str(file))}
    commands |= {name: ("formation.leader", str(file), "--standby", name) for name in mission.standbys}
    commands |= {name: ("formation.agent", str(file), "--robot", name) for name in mission.followers}
    with ExitStack() as stack:
        children: dict[str, Child] = {}
        for names in batched(list(commands)):  # if all started together, each would take as long as all
            for name in names:
                children[name] = stack.enter_context(started(*commands[name], *under))
            for name in names:
                children[name].event("ready", STARTING)
        yield Team(file, mission, children)


def batched(names: Sequence[str]) -> Iterator[Sequence[str]]:
    """Yield the names, `AT_ONCE` at a time."""
    return (names[start : start + AT_ONCE] for start in range(0, len(names), AT_ONCE))
