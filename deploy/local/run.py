"""`formation run`: run every process of a mission on this machine, watched and recorded."""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path

from formation.agent.simulated import faults
from formation.agent.simulated.flags import NEEDED, add_world_flags, unfit, world_flags
from formation.deploy.arguments import (
    add_json,
    add_mission,
    number,
    parser,
    print_result,
    read_driven,
    text_stream,
)
from formation.deploy.local.launch import Child, Launcher
from formation.deploy.local.outcome import Outcome, ended_well, how_it_ended
from formation.deploy.local.plan import Program, programs
from formation.deploy.local.ports import Ports
from formation.deploy.refusal import Refusal, refuse_os_errors
from formation.deploy.terminal.snapshot import Progress, Snapshot
from formation.deploy.terminal.views import View, view_for
from formation.mission.file import file_of
from formation.mission.model import Mission
from formation.monitor.recording.rotation import new_path
from formation.monitor.web.address import add_page_flags, listening
from formation.transport.runtime.command_line import make_folder

START_TIMEOUT_SECONDS = 30.0
"""Time for the processes to get ready [s]."""
OTHER_PORTS = (
    "Other ports are used, as the usual ones are taken or belong to other machines: order, watch, drive and"
    " follow need these -e as well."
)
REFRESH_PERIOD = 0.25
"""Time between two pictures if no snapshot comes [s]."""
EXAMPLES = """\
  formation run                            the paper's six robots
  formation run turtlebot3_pair --law paper --duration 60    the paper's law; it settles after about 45 s
  formation run my_mission.toml --duration 60 --record today.mcap --json
  formation run --control                  with buttons for orders on the page
  formation run --world mujoco             with wheels that slip, and bodies that bump into each other

The first Ctrl-C stops the robots and then everything else; a second one does not wait for that.
Exit code 0: the formation converged; 1: it did not, or a process failed; 2: nothing was started.
"""


def main(arguments: Sequence[str]) -> int:
    """Run a mission; return the exit code."""
    options = _options().parse_args(arguments)
    mission = read_driven(options.mission, options.law)
    # a process of a folder of bundles would take its certificate, which links on this machine do not have
    source = str(file_of(options.mission)) if Path(options.mission).is_dir() else options.mission
    wrong = unfit(options, mission)
    if wrong is not None:
        raise Refusal(wrong)
    physics = NEEDED if options.world == "mujoco" else ()
    for package in ("rich", "mcap", "starlette", *physics):
        if find_spec(package) is None:
            raise ModuleNotFoundError(f"No module named {package!r}", name=package)
    page_flags = _page_flags(options)
    record = _recording(mission, options.record)
    duration: float = options.duration or mission.duration
    _check_starts(options.fault, mission, duration)
    stream = text_stream(options)
    with ExitStack() as stack:
        ports = stack.enter_context(Ports(mission))
        logs = Path(tempfile.mkdtemp(prefix="formation-"))
        removal = stack.enter_context(ExitStack())
        removal.callback(shutil.rmtree, logs, ignore_errors=True)
        launcher = stack.enter_context(Launcher(logs))
        plan = programs(
            mission,
            source,
            ports.endpoints,
            parent=os.getpid(),
            record=record,
            law=options.law,
            watchdogs=options.watchdogs,
            page=page_flags,
            world=world_flags(options),
        )
        print(_how_to_order(source, ports), file=stream, flush=True)
        progress = Progress(mission, duration, len(plan))
        page = start(launcher, plan)
        if page is not None:
            print(f"Page: {page}", file=stream, flush=True)
        with view_for(stream, table=not (options.json or options.no_table)) as view:
            failed = watch_run(launcher, progress, view)
        if failed is not None:
            removal.pop_all()
            return _print_failed_start(failed)
        outcome = Outcome(mission, launcher.children, progress.elapsed, logs, launcher.interrupted, record)
        if outcome.faults:
            removal.pop_all()
        print_result(options, outcome.words(), outcome.as_json)
        _print_failures(outcome)
        return outcome.exit_code


def start(launcher: Launcher, plan: Sequence[Program]) -> str | None:
    """Start every process, and return the address of the monitor's page; None if it serves none."""
    for program in plan:
        launcher.start(program)
    watch = next((child for child in launcher.children if child.part == "watch"), None)
    deadline = time.monotonic() + START_TIMEOUT_SECONDS
    while watch is not None and not launcher.interrupted and time.monotonic() < deadline:
        if any(child.died for child in launcher.children):
            break
        event = launcher.next_event(REFRESH_PERIOD)
        if event is not None and event.child is watch and event.data["event"] == "ready":
            page = event.data.get("page")
            return page if isinstance(page, str) else None
    return None


def watch_run(launcher: Launcher, progress: Progress, view: View) -> Child | None:
    """Watch the run until its end or a signal, and stop it; return a process that failed to get ready."""
    progress.ready = sum(child.ready for child in launcher.children)
    view.show(progress)
    deadline = time.monotonic() + START_TIMEOUT_SECONDS
    while not launcher.interrupted and progress.ready < progress.processes:
        failed = [child for child in launcher.children if child.died]
        late = [child for child in launcher.children if not child.ready]
        if failed or (late and time.monotonic() > deadline):
            launcher.stop()
            return (failed or late)[0]
        _process_event(launcher, progress, view, REFRESH_PERIOD)
    begin = time.monotonic()
    progress.phase = "running"
    while not launcher.interrupted and progress.left > 0.0:
        _process_event(launcher, progress, view, min(REFRESH_PERIOD, progress.left))
        progress.elapsed = time.monotonic() - begin
    progress.phase = "stopping"
    view.show(progress)
    launcher.stop()
    return None


def _process_event(launcher: Launcher, progress: Progress, view: View, timeout: float) -> None:
    event = launcher.next_event(timeout)
    if event is not None and event.data["event"] == "snapshot":
        progress.add_snapshot(Snapshot.of(event.data))
    progress.ready = sum(child.ready for child in launcher.children)
    for child in launcher.children:
        if child.died and child.name not in progress.dead:
            progress.dead[child.name] = how_it_ended(child)
            progress.dead_robots.update(child.robots)
            if child.part == "watch":
                progress.forget_snapshot()
    view.show(progress)


def _options() -> argparse.ArgumentParser:
    options = parser(
        "run",
        "Start every process of a mission on this machine, watch the formation and record it.",
        EXAMPLES,
    )
    add_mission(options, default="six_robots")
    options.add_argument(
        "--duration",
        type=number(0.0, unit="s", open_below=True),
        metavar="S",
        help="instead of the mission's [s]",
    )
    options.add_argument(
        "--record", type=Path, metavar="FILE", help="the recording, MCAP (default: a new one in recordings/)"
    )
    options.add_argument(
        "--watchdogs",
        action="store_true",
        help="a watchdog beside each robot, as in the field: one process more for each robot",
    )
    add_page_flags(options)
    add_world_flags(options)
    options.add_argument("--no-table", action="store_true", help="plain lines instead of the live table")
    add_json(options)
    return options


def _check_starts(texts: Sequence[str], mission: Mission, duration: float) -> None:
    """Raise Refusal for a fault that would begin after the run, which lasts `duration` [s]."""
    for text in texts:
        if faults.parse(text, mission).since >= duration:
            raise Refusal(
                f"--fault {text!r}: must begin before the run ends, after {duration:g} s (--duration)"
            )


def _page_flags(options: argparse.Namespace) -> list[str]:
    """Return the monitor's flags for the page. Raises Refusal, also if it cannot be served there."""
    if options.no_page and options.control:
        raise Refusal("--control: needs the page; leave out --no-page")
    if options.page:
        with refuse_os_errors(f"--page {options.page}"):
            listening(options.page).close()
    place = ["--page", str(options.page)] if options.page else []
    return [*place, *["--no-page"] * options.no_page, *["--control"] * options.control]


def _recording(mission: Mission, requested: Path | None) -> Path:
    """Return the recording's path: a new file in a writable folder. Raises Refusal."""
    path = requested or new_path(mission.name)
    with refuse_os_errors(f"--record {path}"):
        make_folder(path.parent)
        if path.exists():
            raise Refusal(f"--record {path}: exists already; name a new file")
    return path


def _how_to_order(source: str, ports: Ports) -> str:
    lines = [f"Ctrl-C ends it. From another terminal: formation stop {shlex.quote(source)}"]
    if not ports.as_in_mission:
        lines[0] += "".join(f" -e {end}" for end in ports.endpoints.agents.values())
        lines.append(OTHER_PORTS)
    return "\n".join(lines)


def _print_failed_start(child: Child) -> int:
    late = f"was not ready within {START_TIMEOUT_SECONDS:g} s"
    how = late if child.end_requested else how_it_ended(child)
    print(f"formation: {child.name} {how}; nothing runs", file=sys.stderr)
    for line in child.last_log_lines():
        print(f"  | {line}", file=sys.stderr)
    print(f"  its log: {child.log}", file=sys.stderr)
    return 2 if child.exit == 2 else 1


def _print_failures(outcome: Outcome) -> None:
    for child in outcome.children:
        if not ended_well(child) and child not in outcome.replaced:
            for line in child.last_log_lines():
                print(f"  {child.name} | {line}", file=sys.stderr)
