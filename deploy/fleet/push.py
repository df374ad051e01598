"""`formation deploy push` sends bundles to all robots at once, over ssh; `rollback` goes one release back.

Only differing files are sent.
"""

from __future__ import annotations

import argparse
import stat
import sys
import tarfile
import threading
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import IO, Any, NamedTuple, Self, TextIO, TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from formation.deploy.arguments import parser, print_result
from formation.deploy.fleet import fleet as fleets
from formation.deploy.fleet.fleet import Bundle, Fleet
from formation.deploy.fleet.remote import LAST_LINES, RemoteError, Robot
from formation.deploy.fleet.wheels import digest
from formation.deploy.refusal import Refusal
from formation.monitor.report.words import size

EXAMPLES = """\
  formation deploy push field --user ubuntu
  formation deploy push field --only robot2 --host robot2=10.0.0.12
  formation deploy push field --ssh-option Port=2222 --jobs 4

It logs in with a key, never with a password, and installs by way of `sudo -n` unless it logs in as root or
--no-systemd is given. Exit code 0: all robots have it; 1: some have not, for the reasons named.
"""
ROLLBACK_EXAMPLES = """\
  formation deploy rollback field
  formation deploy rollback field --only robot2 --user ubuntu

It goes one release back, and not further. To go forward again, push.
Exit code 0: all robots have gone back; 1: some have not, for the reasons named.
"""
BLOCK_BYTES = 1 << 16
"""Size of a block [bytes]."""
Files = Mapping[str, tuple[str, int]]
"""Digest and mode of each file, by its path within the bundle."""
T = TypeVar("T")


class Pushed(NamedTuple):
    """The result for one robot."""

    release: str
    files: int
    """Number of files sent."""
    bytes: int
    installed: bool
    """False if the release was already there and current."""
    restored: tuple[str, ...] = ()
    """Files of the release that had been changed on the robot."""
    replaced: str | None = None
    """Release that was current before; None if there was none, or the same."""
    newer: str | None = None
    """When the replaced release was made, if that was after this one; None else."""


class ProgressLines:
    """Shows the progress of a push in lines; called from many threads; a context manager."""

    def __init__(self, stream: TextIO | None = None) -> None:
        """Without a `stream`, show nothing."""
        self._stream = stream
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def phase(self, robot: str, phase: str) -> None:
        """Show a robot's phase: `connecting`, `comparing` or `installing`."""
        if phase == "installing":
            self._say(robot, phase)

    def sending(self, robot: str, files: int, total: int) -> None:
        """Show how many files and bytes are to be sent [bytes]."""
        self._say(robot, f"sending {files} files, {size(total)}")

    def sent(self, robot: str, count: int) -> None:
        """Add to the bytes sent [bytes]."""

    def line(self, robot: str, text: str) -> None:
        """Show a line of the installation."""

    def end(self, robot: str, text: str, *, well: bool) -> None:  # noqa: ARG002 - for `_ProgressBars`
        """Show that a robot is done."""
        self._say(robot, text)

    def _say(self, robot: str, text: str) -> None:
        if self._stream is not None:
            with self._lock:
                print(f"{robot}: {text}", file=self._stream, flush=True)


class _ProgressBars(ProgressLines):
    """A bar for each robot, in a terminal. It is removed at the end: the result is in words."""

    def __init__(self, stream: TextIO, robots: Iterable[str]) -> None:
        super().__init__()
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            TimeElapsedColumn(),
            TextColumn("{task.fields[phase]}", style="dim"),
            console=Console(file=stream, highlight=False),
            transient=True,
        )
        self._tasks: dict[str, TaskID] = {
            robot: self._progress.add_task(robot, total=None, phase="waiting") for robot in robots
        }

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def phase(self, robot: str, phase: str) -> None:
        self._progress.update(self._tasks[robot], phase=phase)

    def sending(self, robot: str, files: int, total: int) -> None:
        self._progress.update(self._tasks[robot], total=total, phase=f"sending {files} files, {size(total)}")

    def sent(self, robot: str, count: int) -> None:
        self._progress.advance(self._tasks[robot], count)

    def line(self, robot: str, text: str) -> None:
        if text.strip():
            shown = text.strip()[:40].replace("[", r"\[")  # else rich would take it for a style
            self._progress.update(self._tasks[robot], phase=shown)

    def end(self, robot: str, text: str, *, well: bool) -> None:
        task = self._tasks[robot]
        self._progress.update(task, total=1, completed=1 if well else 0, phase=text[:40])
        self._progress.stop_task(task)


def main(arguments: Sequence[str]) -> int:
    """Push; return the exit code."""
    options = flags().parse_args(arguments)
    fleet = fleets.read(options, sudo=not options.no_systemd)
    refuse_unfit(fleet, datetime.now(UTC))
    lines_shown = ProgressLines(None if options.json else sys.stdout)
    bars = sys.stdout.isatty() and not options.json
    with _ProgressBars(sys.stdout, fleet.robots) if bars else lines_shown as view:
        results = fleets.on_all(fleet, lambda robot: _push_one(fleet, robot, options, view))
    failed = [name for name, result in results.items() if isinstance(result, RemoteError)]
    now = datetime.now(UTC).timestamp()
    expiries = {name: fleets.expiry(bundle.version, now) for name, bundle in fleet.bundles.items()}
    lines = [f"{name}: {text}" for name, text in expiries.items() if text]
    lines += _words(results, _pushed, failed)
    print_result(options, "\n".join(lines), lambda: _report(fleet, results, expiries))
    return 1 if failed else 0


def refuse_unfit(fleet: Fleet, now: datetime) -> None:
    """Raise Refusal for a bundle with an expired certificate, or with a mission edited since its making."""
    for name, bundle in fleet.bundles.items():
        until = bundle.version.get("certificate_until")
        if until is not None and datetime.fromisoformat(until) <= now:
            raise Refusal(
                f"{bundle.folder}: the certificate of {name} has expired on {until}, and no robot would link"
                f" with it: {fleets.RENEW}"
            )
        if bundle.version.get("mission_sha256", bundle.mission_sha256) != bundle.mission_sha256:
            raise Refusal(
                f"{bundle.folder / 'mission.toml'}: was changed after the bundles were made, for {name} only:"
                " change the mission that they are made from, and make them again"
            )


def rollback(arguments: Sequence[str]) -> int:
    """Go back to the release before the last; return the exit code."""
    options = parser("deploy rollback", "Go back to the release before the last.", ROLLBACK_EXAMPLES)
    fleets.add_flags(options)
    fleets.add_no_restart(options)
    options.add_argument(
        "--no-systemd", action="store_true", help="only links, no units; then sudo is not used"
    )
    chosen = options.parse_args(arguments)
    fleet = fleets.read(chosen, sudo=not chosen.no_systemd)
    restart = not (chosen.no_restart or chosen.no_systemd)
    now = datetime.now(UTC).timestamp()
    results = fleets.on_all(
        fleet,
        lambda robot: fleet.ssh.call(
            robot, "rollback", {"restart": restart, "robot": robot.name, "now": now}
        ),
    )
    robots = {
        name: {"ok": False, "reason": str(result)}
        if isinstance(result, RemoteError)
        else {"ok": not result["restart"], **result}
        for name, result in results.items()
    }
    failed = [name for name, robot in robots.items() if not robot["ok"]]
    print_result(
        chosen,
        "\n".join(_words(results, _rolled_back, failed)),
        lambda: {"ok": not failed, "robots": robots},
    )
    return 1 if failed else 0


def push(
    fleet: Fleet,
    robot: Robot,
    flags: Sequence[str],
    view: ProgressLines,
    *,
    reinstall: bool = False,
    rename: bool = False,
) -> Pushed:
    """Update one robot to its bundle; `flags` goes to its install.sh.

    With `rename` the machine may have been another robot. Raises RemoteError; the old release then still
    runs unless the last step of installation was reached.
    """
    bundle = fleet.bundles[robot.name]
    view.phase(robot.name, "connecting")
    identity = {"robot": robot.name, "rename": rename}
    there = fleet.ssh.call(robot, "look", identity)
    view.phase(robot.name, "comparing")
    files = manifest(bundle.folder)
    missing = [name for name, facts in files.items() if there["files"].get(name, [None])[0] != facts[0]]
    total = sum((bundle.folder / name).stat().st_size for name in missing)
    if total > there["free"]:
        raise RemoteError(
            f"disk full: {size(total)} to send, {size(there['free'])} free under {robot.prefix}"
        )
    same = {name: list(facts) for name, facts in files.items()} == there["files"]
    current = there["release"] == there["installed"] == bundle.release
    restored = bundle.differing(robot.prefix, there["configuration"]) if current else ()
    if same and current and not restored and not reinstall:
        return Pushed(bundle.release, 0, 0, installed=False)
    output: list[str] = []

    def line(text: str) -> None:
        output.append(text)
        view.line(robot.name, text)

    view.sending(robot.name, len(missing), total)
    answer = fleet.ssh.call(
        robot,
        "receive",
        {"files": files, "install": ["--prefix", robot.prefix, *flags], **identity},
        feed=partial(send, bundle, files, missing, view),
        line=line,
    )
    if answer["exit"] != 0 or answer["release"] != bundle.release:
        lines = [text for text in output if text.strip() and not text.startswith("formation-answer: ")]
        full = any("No space left on device" in text for text in lines)
        how = f"exit code {answer['exit']}" if answer["exit"] else f"{answer['release']} is current"
        raise RemoteError("disk full" if full else f"install failed ({how})", lines[-LAST_LINES:])
    if differing := bundle.differing(robot.prefix, answer["configuration"]):
        raise RemoteError(f"installed, but {', '.join(differing)} on the robot is not as in the bundle")
    before, made = (there["release"], there["made"]) if there["release"] != bundle.release else (None, None)
    newer = made if made and str(made) > str(bundle.version.get("made", made)) else None
    return Pushed(bundle.release, len(missing), total, True, restored, before, newer)


def manifest(folder: Path) -> dict[str, tuple[str, int]]:
    """Return digest and mode of every file of a bundle. Files private here stay private."""
    return {
        path.relative_to(folder).as_posix(): (digest(path), stat.S_IMODE(path.stat().st_mode) & 0o755)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def send(bundle: Bundle, files: Files, names: Sequence[str], view: ProgressLines, stream: IO[bytes]) -> None:
    """Write the named files as a tar stream."""
    with tarfile.open(fileobj=stream, mode="w|", bufsize=BLOCK_BYTES) as archive:
        for name in names:
            path = bundle.folder / name
            entry = tarfile.TarInfo(name)
            entry.size, entry.mode = path.stat().st_size, files[name][1]
            with path.open("rb") as file:
                archive.addfile(entry, _Counted(file, partial(view.sent, bundle.robot)))
    view.phase(bundle.robot, "installing")


def _words(
    results: Mapping[str, T | RemoteError], lines_of: Callable[[T], Sequence[str]], failed: Collection[str]
) -> list[str]:
    """Return the results for people: `lines_of` each that was reached, and the robots that `failed`."""
    width = max(map(len, results)) + 2
    lines = []
    for name, result in results.items():
        if isinstance(result, RemoteError):
            of_robot = [f"FAILED  {result}", *(f"  | {text}" for text in result.lines)]
        else:
            of_robot = list(lines_of(result))
        lines.append(f"  {name:<{width}}{of_robot[0]}")
        lines += [f"  {'':<{width}}{text}" for text in of_robot[1:]]
    well = f"{len(results) - len(failed)} of {len(results)} robots"
    return [*lines, well + (f"; FAILED: {', '.join(failed)}" if failed else "")]


def _pushed(result: Pushed) -> Sequence[str]:
    if not result.installed:
        return (f"{result.release}  up to date, not touched",)
    sent = f"{result.files} files, {size(result.bytes)} sent" if result.files else "nothing to send"
    restored = f"; restored {', '.join(result.restored)}, changed there" if result.restored else ""
    was = f" (was {result.replaced})" if result.replaced else ""
    lines = [f"{result.release}  installed{was}; {sent}{restored}"]
    if result.newer:
        lines.append(f"  NOTE: the replaced release is newer, made {result.newer}; is this the right folder?")
    return lines


def _rolled_back(result: Mapping[str, Any]) -> Sequence[str]:
    trouble = result["restart"]
    lines = [f"{result['left']} -> {result['release']}"]
    return [*lines, f"  but its units did not start: {trouble}"] if trouble else lines


def _report(
    fleet: Fleet, results: Mapping[str, Pushed | RemoteError], warnings: Mapping[str, str]
) -> dict[str, Any]:
    robots = {}
    for name, result in results.items():
        if isinstance(result, RemoteError):
            robots[name] = {"ok": False, "reason": str(result), "lines": list(result.lines)}
        else:
            robots[name] = {"ok": True, **result._asdict()}
        robots[name] |= {"address": fleet.robots[name].address, "warning": warnings[name]}
    return {"ok": all(robot["ok"] for robot in robots.values()), "robots": robots}


class _Counted:
    """A file that reports how much of it has been read."""

    def __init__(self, file: IO[bytes], read: Any) -> None:
        self._file, self._read = file, read

    def read(self, count: int = -1, /) -> bytes:
        block = self._file.read(count)
        self._read(len(block))
        return block


def _push_one(fleet: Fleet, robot: Robot, options: argparse.Namespace, view: ProgressLines) -> Pushed:
    flags = ["--no-systemd"] * options.no_systemd + ["--no-restart"] * options.no_restart
    try:
        pushed = push(fleet, robot, flags, view, reinstall=options.reinstall, rename=options.rename)
    except RemoteError as error:
        view.end(robot.name, f"failed: {error}", well=False)
        raise
    view.end(robot.name, "installed" if pushed.installed else "up to date", well=True)
    return pushed


def flags() -> argparse.ArgumentParser:
    """Return the flags of the command."""
    options = parser("deploy push", "Put the bundles onto their robots and install them.", EXAMPLES)
    fleets.add_flags(options)
    fleets.add_no_restart(options)
    options.add_argument(
        "--no-systemd", action="store_true", help="only files, no units; then sudo is not used either"
    )
    options.add_argument(
        "--reinstall", action="store_true", help="run the installation even where nothing differs"
    )
    options.add_argument(
        "--rename",
        action="store_true",
        help="also where another robot is installed: the machine gets this robot's name and place",
    )
    return options
