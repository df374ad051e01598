"""`formation watch`: show a table of a running fleet in a terminal. It moves, publishes and records nothing.

The monitor's own core runs in this process, and its messages are not published. So any number of watchers can
run beside the monitor that records.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from typing import Any

from rich.console import Console

from formation.deploy.arguments import add_links, add_mission, as_json, parser, read_mission, text_stream
from formation.deploy.links import no_answer_message
from formation.deploy.refusal import refuse_errors
from formation.deploy.terminal.bar import message_if_slow
from formation.deploy.terminal.snapshot import Progress, Snapshot
from formation.deploy.terminal.table import draw
from formation.deploy.terminal.views import view_for
from formation.mission.file import configuration_of
from formation.mission.model import TAG_CHARS, Mission
from formation.mission.rules import VISITORS
from formation.monitor.core import Monitor
from formation.monitor.metrics import snapshot as metrics
from formation.monitor.metrics.event import ERROR, Event
from formation.monitor.metrics.events import LOST_SILENCE
from formation.monitor.metrics.keys import usual_stage
from formation.monitor.metrics.words import as_json as snapshot_as_json
from formation.monitor.process import MAX_WAITING_MESSAGES, STEP_PERIOD
from formation.protocol.addressed import tags_of
from formation.transport import wiring
from formation.transport.bus import Bus
from formation.transport.bus_config import BusError
from formation.transport.linger import Linger
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBuses
from formation.transport.runtime.flags import bus_config
from formation.transport.runtime.process import Stop, clocks
from formation.transport.runtime.rate import Rate

MONITOR, _ = VISITORS
"""Watching takes the monitor's configuration."""
REFRESH_RATE, JSON_RATE = 4.0, 1.0
"""Rates of the table and of JSON lines [Hz]."""
SILENCE_NOTICE_DELAY = 3.0
"""Time without any message before that is reported [s]: links take up to a second."""
COMPLETE_TIMEOUT_SECONDS = 5.0
"""How long --once waits for a complete picture [s]."""
EXAMPLES = """\
  formation watch six_robots                beside `formation run`, from another terminal
  formation watch field.toml -e tcp/192.168.1.11:7460 -e tcp/192.168.1.12:7460
  formation watch field                     robots with certificates, by the folder of their bundles
  formation watch six_robots --once && echo all run

Ctrl-C ends it. Exit code 0; with --once 0 if every robot runs, and this mission, else 1. 2: it could not be
begun.
"""


class Watcher:
    """Repeated looks at a fleet."""

    def __init__(self, mission: Mission, options: argparse.Namespace, stack: ExitStack) -> None:
        """Link with the fleet until `stack` ends. Raises BusError."""
        implied = not (options.connect or options.config)
        stage = usual_stage(mission) if implied else {}
        self.mission = mission
        self._monitor = Monitor(mission, stage)
        mailbox = Mailbox(MAX_WAITING_MESSAGES)
        links = wiring.of_monitor(wiring.endpoints(mission))
        self._bus = stack.enter_context(Bus(bus_config(options, mission, links, "watch"), mailbox))
        truth = RobotBuses(mission, stage, mailbox, node="formation_watch", awaited=False)
        stack.callback(truth.close)
        for topic, key in self._monitor.truth_topics:
            truth.subscribe(topic, key)
        for key in self._monitor.subscriptions:
            self._bus.subscribe(key)
        self._linger = Linger()
        self._begin = clocks().mono
        self._shown = 0
        self._tags = tags_of(mission)
        self._on_other_mission: frozenset[str] = frozenset()  # when last shown

    @property
    def elapsed(self) -> float:
        """How long it has watched [s]."""
        return clocks().mono - self._begin

    @property
    def has_received(self) -> bool:
        """Whether any message has arrived."""
        return bool(self._bus.received)

    def look(self) -> metrics.Snapshot:
        """Take the messages since the last look; return the current metrics."""
        now = clocks()
        self._monitor.step(now, self._bus.drain())
        self._linger.tend(now.mono)
        return self._monitor.snapshot or self._monitor.metrics.snapshot(now)

    @property
    def on_other_mission(self) -> frozenset[str]:
        """Robots and candidates that run another mission."""
        missions = self._monitor.metrics.missions(clocks())
        return frozenset(name for name, one in missions.items() if one[:TAG_CHARS] not in self._tags)

    def show(self, progress: Progress, snapshot: metrics.Snapshot) -> None:
        """Put the snapshot into `progress`."""
        progress.elapsed = self.elapsed
        before, self._on_other_mission = self._on_other_mission, self.on_other_mission
        if self._on_other_mission - before:
            text = other_mission_message(self.mission, self._on_other_mission)
            progress.events.append(Event(clocks().wall, ERROR, "", "another mission", text))
        if self.has_received:
            news = [one for one in self._monitor.events if one.number > self._shown]
            self._shown = news[-1].number if news else self._shown
            seen = Snapshot.of(snapshot_as_json(snapshot))
            progress.add_snapshot(seen._replace(events=tuple(one.event for one in news)))


def main(arguments: Sequence[str]) -> int:
    """Watch a fleet; return the exit code."""
    options = _options().parse_args(arguments)
    mission = read_mission(options.mission, options.law)
    options.config = options.config or configuration_of(options.mission, MONITOR)
    with ExitStack() as stack:
        stop = stack.enter_context(Stop())
        with refuse_errors(BusError):
            watcher = Watcher(mission, options, stack)
        return _once(watcher, options, stop) if options.once else _watch(watcher, options, stop)


def all_run(snapshot: metrics.Snapshot) -> bool:
    """Return whether every robot reports that it runs, is not read only, and its messages arrive."""
    return all(
        robot.state == "run" and not robot.readonly and robot.age is not None and robot.age <= LOST_SILENCE
        for robot in snapshot.robots.values()
    )


def other_mission_message(mission: Mission, names: Iterable[str]) -> str:
    """Return the message that these robots and candidates run another mission."""
    robots = ", ".join(name for name in dict.fromkeys((*mission.candidates, *mission.names)) if name in names)
    return f"{robots} run another mission than {mission.name}, or another version of it; name theirs"


def _watch(watcher: Watcher, options: argparse.Namespace, stop: Stop) -> int:
    """Watch until told to stop."""
    progress = Progress(watcher.mission, phase="running", note="looking for the robots …")
    refresh = Rate(JSON_RATE if options.json else REFRESH_RATE)
    with view_for(text_stream(options), table=not (options.json or options.no_table)) as view:
        while not stop:
            snapshot = watcher.look()
            if not watcher.has_received and watcher.elapsed > SILENCE_NOTICE_DELAY:
                progress.note = no_answer_message(watcher.mission, options, MONITOR)
            if refresh.tick(clocks().mono):
                watcher.show(progress, snapshot)
                view.show(progress)
                if options.json:
                    print(as_json(_report(watcher, snapshot)), flush=True)
            time.sleep(STEP_PERIOD)
    return 0


def _once(watcher: Watcher, options: argparse.Namespace, stop: Stop) -> int:
    """Show one picture, as soon as it is complete."""
    with message_if_slow(f"looking for the robots, {COMPLETE_TIMEOUT_SECONDS:g} s at most"):
        snapshot = watcher.look()
        while not (stop or _complete(snapshot) or watcher.elapsed > COMPLETE_TIMEOUT_SECONDS):
            time.sleep(STEP_PERIOD)
            snapshot = watcher.look()
    if stop:
        return 130
    progress = Progress(watcher.mission, phase="over")
    watcher.show(progress, snapshot)
    progress.events.clear()  # all values were fresh a moment ago
    if not watcher.has_received:
        print(
            f"{watcher.mission.name}: {no_answer_message(watcher.mission, options, MONITOR)}", file=sys.stderr
        )
    elif not options.json:
        size = shutil.get_terminal_size()
        Console(highlight=False, width=size.columns).print(
            draw(progress, size.columns, max(size.lines, len(watcher.mission.names) + 8))
        )
    if options.json:
        print(as_json(_report(watcher, snapshot)), flush=True)
    if watcher.on_other_mission:
        print(
            f"formation: {other_mission_message(watcher.mission, watcher.on_other_mission)}", file=sys.stderr
        )
    return 0 if all_run(snapshot) and not watcher.on_other_mission else 1


def _complete(snapshot: metrics.Snapshot) -> bool:
    """Return whether everything is known that a healthy fleet publishes."""
    return snapshot.formation_error is not None and all(
        robot.state not in {"unseen", "silent"} and robot.age is not None
        for robot in snapshot.robots.values()
    )


def _report(watcher: Watcher, snapshot: metrics.Snapshot) -> dict[str, Any]:
    other = watcher.on_other_mission
    return {
        "mission": watcher.mission.name,
        "all_run": all_run(snapshot) and not other,
        "other_mission": sorted(other),
        **snapshot_as_json(snapshot),
    }


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
    add_links(options)
    return options
