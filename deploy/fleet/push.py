"""`formation deploy push`: send bundles to all robots at once, over ssh; only differing files are sent."""

from __future__ import annotations

import argparse
import stat
import sys
import tarfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import IO, Any, NamedTuple

from formation.deploy.arguments import parser, tell
from formation.deploy.fleet import fleet as fleets
from formation.deploy.fleet.fleet import Bundle, Fleet, digest
from formation.deploy.fleet.push_view import View, size, view_for
from formation.deploy.fleet.remote import LAST_LINES, RemoteError, Robot

EXAMPLES = """\
  formation deploy push field --user ubuntu
  formation deploy push field --only robot2 --host robot2=10.0.0.12
  formation deploy push field --ssh-option Port=2222 --jobs 4

It logs in with a key, never with a password, and installs by way of `sudo -n` unless it logs in as root or
--no-systemd is given. Exit code 0: all robots have it; 1: some have not, for the reasons named.
"""
BLOCK_BYTES = 1 << 16
"""Size of a block [bytes]."""
Files = Mapping[str, tuple[str, int]]
"""Digest and mode of each file, by its path within the bundle."""


class Pushed(NamedTuple):
    """The result for one robot."""

    release: str
    files: int
    """Number of files sent."""
    bytes: int
    installed: bool
    """False if the release was already there and current."""


def main(arguments: Sequence[str]) -> int:
    """Push; return the exit code."""
    options = flags().parse_args(arguments)
    fleet = fleets.read(options, sudo=not options.no_systemd)
    with View() if options.json else view_for(sys.stdout, fleet.robots) as view:
        results = fleets.on_all(fleet, lambda robot: _one(fleet, robot, options, view))
    tell(options, "\n".join(words(fleet, results)), lambda: report(fleet, results))
    return 1 if any(isinstance(result, RemoteError) for result in results.values()) else 0


def push(fleet: Fleet, robot: Robot, flags: Sequence[str], view: View, *, reinstall: bool = False) -> Pushed:
    """Update one robot to its bundle; `flags` goes to its install.sh.

    Raises RemoteError; the old release then still runs unless the last step of installation was reached.
    """
    bundle = fleet.bundles[robot.name]
    view.phase(robot.name, "connecting")
    there = fleet.ssh.call(robot, "look", {})
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
    if same and current and not reinstall:
        return Pushed(bundle.release, 0, 0, installed=False)
    output: list[str] = []

    def line(text: str) -> None:
        output.append(text)
        view.line(robot.name, text)

    view.sending(robot.name, len(missing), total)
    answer = fleet.ssh.call(
        robot,
        "receive",
        {"files": files, "install": ["--prefix", robot.prefix, *flags]},
        feed=partial(send, bundle, files, missing, view),
        line=line,
    )
    if answer["exit"] != 0 or answer["release"] != bundle.release:
        lines = [text for text in output if text.strip() and not text.startswith("formation-answer: ")]
        full = any("No space left on device" in text for text in lines)
        how = f"exit code {answer['exit']}" if answer["exit"] else f"{answer['release']} is current"
        raise RemoteError("disk full" if full else f"install failed ({how})", lines[-LAST_LINES:])
    return Pushed(bundle.release, len(missing), total, installed=True)


def manifest(folder: Path) -> dict[str, tuple[str, int]]:
    """Return digest and mode of every file of a bundle. Files private here stay private."""
    return {
        path.relative_to(folder).as_posix(): (digest(path), stat.S_IMODE(path.stat().st_mode) & 0o755)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def send(bundle: Bundle, files: Files, names: Sequence[str], view: View, stream: IO[bytes]) -> None:
    """Write the named files as a tar stream."""
    with tarfile.open(fileobj=stream, mode="w|", bufsize=BLOCK_BYTES) as archive:
        for name in names:
            path = bundle.folder / name
            entry = tarfile.TarInfo(name)
            entry.size, entry.mode = path.stat().st_size, files[name][1]
            with path.open("rb") as file:
                archive.addfile(entry, _Counted(file, partial(view.sent, bundle.robot)))
    view.phase(bundle.robot, "installing")


def words(fleet: Fleet, results: Mapping[str, Pushed | RemoteError]) -> list[str]:
    """Return the results for people."""
    width = max(map(len, fleet.robots)) + 2
    lines = []
    for name, result in results.items():
        if isinstance(result, RemoteError):
            lines.append(f"  {name:<{width}}FAILED  {result}")
            lines += [f"  {'':<{width}}  | {text}" for text in result.lines]
        elif result.installed:
            sent = f"{result.files} files, {size(result.bytes)} sent" if result.files else "nothing to send"
            lines.append(f"  {name:<{width}}{result.release}  installed; {sent}")
        else:
            lines.append(f"  {name:<{width}}{result.release}  up to date, not touched")
    well = sum(isinstance(result, Pushed) for result in results.values())
    failed = [name for name, result in results.items() if isinstance(result, RemoteError)]
    return [*lines, f"{well} of {len(results)} robots" + (f"; FAILED: {', '.join(failed)}" if failed else "")]


def report(fleet: Fleet, results: Mapping[str, Pushed | RemoteError]) -> dict[str, Any]:
    """Return the results for a script."""
    robots = {}
    for name, result in results.items():
        if isinstance(result, RemoteError):
            robots[name] = {"ok": False, "reason": str(result), "lines": list(result.lines)}
        else:
            robots[name] = {"ok": True, **result._asdict()}
        robots[name]["address"] = fleet.robots[name].address
    return {"ok": all(robot["ok"] for robot in robots.values()), "robots": robots}


class _Counted:
    """A file that reports how much of it has been read."""

    def __init__(self, file: IO[bytes], read: Any) -> None:
        self._file, self._read = file, read

    def read(self, count: int = -1, /) -> bytes:
        block = self._file.read(count)
        self._read(len(block))
        return block


def _one(fleet: Fleet, robot: Robot, options: argparse.Namespace, view: View) -> Pushed:
    flags = ["--no-systemd"] * options.no_systemd + ["--no-restart"] * options.no_restart
    try:
        pushed = push(fleet, robot, flags, view, reinstall=options.reinstall)
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
    return options
