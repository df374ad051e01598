"""`formation watch`: a table of any running fleet in a terminal. It moves, publishes and records nothing.

The monitor's own core looks, in this process, and what it would publish is left unsaid. So any number of
people can watch beside the monitor that records.
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

from rich.console import Console

from deploy.arguments import add_mission, as_json, parser, read_mission
from deploy.refusal import Refusal
from deploy.terminal.progress import Progress
from deploy.terminal.snapshot import Snapshot
from deploy.terminal.table import draw
from deploy.terminal.views import LiveTable, PlainLines, View, in_a_terminal
from formation.mission import Mission
from formation.rate import Rate
from formation.transport import wiring
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.flags import add_zenoh, bus_config
from formation.transport.linger import Linger
from formation.transport.mailbox import Mailbox
from formation.transport.process import Stop, clocks
from formation.transport.robot_buses import RobotBuses
from monitor.core import Monitor
from monitor.figures import snapshot as figures
from monitor.figures.stage import usual
from monitor.figures.words import as_json as snapshot_as_json
from monitor.loop import CAPACITY, PERIOD

REFRESH, TELL = 4.0, 1.0
"""Of the table, and of JSON lines [Hz]."""
NOBODY = 3.0
"""So long nobody has answered before that is said [s]: links take up to a second."""
COMPLETE = 5.0
"""How long --once waits for a picture that is complete [s]."""
SILENT = 1.0
"""[s] without a position, after which a robot does not count as running."""
EXAMPLES = """\
  formation watch six_robots                beside `formation run`, from another terminal
  formation watch field.toml -e tcp/192.168.1.11:7460 -e tcp/192.168.1.12:7460
  formation watch field.toml -c monitor/zenoh.json5     robots under certificates, with the monitor's
  formation watch six_robots --once && echo all run

Ctrl-C ends it. Exit code 0; with --once 0 if every robot runs, else 1. 2: it could not be begun.
"""


class Watcher:
    """One look at a fleet after the other."""

    def __init__(self, mission: Mission, options: argparse.Namespace, stack: ExitStack) -> None:
        """Link with the fleet until `stack` ends. Raises BusError."""
        implied = not (options.connect or options.config)
        stage = usual(mission) if implied else {}
        self.mission = mission
        self._monitor = Monitor(mission, stage)
        mailbox = Mailbox(CAPACITY)
        self._bus = stack.enter_context(Bus(_config(options, mission), mailbox))
        truth = RobotBuses(mission, stage, mailbox, node="formation_watch", awaited=False)
        stack.callback(truth.close)
        for topic, key in self._monitor.truths:
            truth.subscribe(topic, key)
        for key in self._monitor.subscriptions:
            self._bus.subscribe(key)
        self._linger = Linger()
        self._begin = clocks().mono
        self._told = 0

    @property
    def elapsed(self) -> float:
        """How long it has watched [s]."""
        return clocks().mono - self._begin

    @property
    def heard(self) -> bool:
        """Whether anybody has said anything."""
        return bool(self._bus.received)

    def look(self) -> figures.Snapshot:
        """Take what has arrived since the last look; the figures now."""
        now = clocks()
        self._monitor.step(now, self._bus.drain())
        self._linger.tend(now.mono)
        return self._monitor.snapshot or self._monitor.metrics.snapshot(now)

    def show(self, progress: Progress, snapshot: figures.Snapshot) -> None:
        """Have `progress` tell of it."""
        progress.elapsed = self.elapsed
        if self.heard:
            news = [one for one in self._monitor.events if one.number > self._told]
            self._told = news[-1].number if news else self._told
            seen = Snapshot.of(snapshot_as_json(snapshot))
            progress.see(seen._replace(events=tuple(one.event for one in news)))


def main(arguments: Sequence[str]) -> int:
    """Watch a fleet; the exit code."""
    options = _options().parse_args(arguments)
    mission = read_mission(options.mission, options.law)
    with ExitStack() as stack:
        stop = stack.enter_context(Stop())
        try:
            watcher = Watcher(mission, options, stack)
        except BusError as error:
            raise Refusal(str(error)) from None
        return _once(watcher, options, stop) if options.once else _watch(watcher, options, stop)


def all_run(snapshot: figures.Snapshot) -> bool:
    """Whether every robot says that it runs, and is heard."""
    return all(
        robot.state == "run" and robot.age is not None and robot.age <= SILENT
        for robot in snapshot.robots.values()
    )


def nobody(mission: Mission, options: argparse.Namespace) -> str:
    """What to say, and what to try, when nobody answers."""
    ends = options.connect or list(wiring.endpoints(mission).agents.values())
    where = "" if options.config else f" at {ends[0]}{f' … {ends[-1]}' if len(ends) > 1 else ''}"
    tries = [f"does it run here? formation run {shlex.quote(options.mission)}"]
    if not options.connect:
        tries.append(
            "a run whose usual ports were taken prints its -e flags; a field has those of its robots"
        )
    else:
        tries.append("are these the endpoints of agents and leader, and does a firewall let this machine in?")
    if options.config is None:
        tries.append(
            "robots under certificates show themselves to a monitor's: -c FILE names its configuration"
        )
    else:
        tries.append(
            f"is {options.config} the monitor's, of this team, and not expired? formation doctor says"
        )
    if mission.team:
        tries.append(f"the mission's team is {mission.team!r}: robots of another are not heard")
    return "\n".join([f"nobody answers{where}", *(f"  - {one}" for one in tries)])


def _watch(watcher: Watcher, options: argparse.Namespace, stop: Stop) -> int:
    """Until somebody wants it to end."""
    progress = Progress(watcher.mission, phase="running", note="looking for the robots …")
    refresh = Rate(TELL if options.json else REFRESH)
    with _view(options) as view:
        while not stop:
            snapshot = watcher.look()
            if not watcher.heard and watcher.elapsed > NOBODY:
                progress.note = nobody(watcher.mission, options)
            if refresh.tick(clocks().mono):
                watcher.show(progress, snapshot)
                view.show(progress)
                if options.json:
                    print(as_json(_report(watcher.mission, snapshot)), flush=True)
            time.sleep(PERIOD)
    return 0


def _once(watcher: Watcher, options: argparse.Namespace, stop: Stop) -> int:
    """One picture, as soon as it is complete."""
    snapshot = watcher.look()
    while not (stop or _complete(snapshot) or watcher.elapsed > COMPLETE):
        time.sleep(PERIOD)
        snapshot = watcher.look()
    if stop:
        return 130
    progress = Progress(watcher.mission, phase="over")
    watcher.show(progress, snapshot)
    progress.events.clear()  # all that is there was news a moment ago
    if not watcher.heard:
        print(f"{watcher.mission.name}: {nobody(watcher.mission, options)}", file=sys.stderr)
    elif not options.json:
        size = shutil.get_terminal_size()
        Console(highlight=False, width=size.columns).print(
            draw(progress, size.columns, max(size.lines, len(watcher.mission.names) + 8))
        )
    if options.json:
        print(as_json(_report(watcher.mission, snapshot)), flush=True)
    return 0 if all_run(snapshot) else 1


def _complete(snapshot: figures.Snapshot) -> bool:
    """Whether everything is known that a healthy fleet tells."""
    return snapshot.formation_error is not None and all(
        robot.state not in {"unseen", "silent"} and robot.age is not None
        for robot in snapshot.robots.values()
    )


def _report(mission: Mission, snapshot: figures.Snapshot) -> dict[str, Any]:
    return {"mission": mission.name, "all_run": all_run(snapshot), **snapshot_as_json(snapshot)}


def _view(options: argparse.Namespace) -> View:
    if options.json:
        return PlainLines(sys.stderr)
    return (
        LiveTable(sys.stdout)
        if in_a_terminal(sys.stdout) and not options.no_table
        else PlainLines(sys.stdout)
    )


def _config(options: argparse.Namespace, mission: Mission) -> BusConfig:
    return bus_config(options, mission, wiring.of_monitor(wiring.endpoints(mission)), "watch")


def _options() -> argparse.ArgumentParser:
    options = parser(
        "watch", "Watch a running fleet in the terminal. It moves and records nothing.", EXAMPLES
    )
    add_mission(options)
    options.add_argument("--once", action="store_true", help="show it once; exit code 0 if every robot runs")
    options.add_argument(
        "--json", action="store_true", help="a JSON object a second on stdout, or the one of --once"
    )
    options.add_argument("--no-table", action="store_true", help="plain lines instead of the live table")
    links = options.add_argument_group(
        "links (without -e and endpoints in FILE those that the mission implies)"
    )
    add_zenoh(links, connect="endpoint of an agent or the leader to dial; repeatable")
    return options
