#!/usr/bin/env python3
"""Run a command in this checkout's pinned environment, making that environment first if it is missing or old.

    python3 deploy/env.py COMMAND [ARGUMENT ...]    e.g. formation run, pytest, ruff check
    python3 deploy/env.py                           only make the environment

It needs nothing but Python 3.11 or newer on Linux or macOS. The environment holds the versions that
deploy/lock/dev.txt pins, each file checked against its hash, and this checkout itself, editable. pip fetches
them as your own pip configuration says (PIP_* variables, pip.conf).

An environment lives in .venvs/<key>, where the key names everything that it was made from; .venv is a link to
the one in use. So an interrupted installation is never used, and a process that runs while a newer
environment is made keeps its own.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, TextIO

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

ROOT = Path(__file__).resolve().parent.parent
LOCK = ROOT / "deploy" / "lock"
LINK = ROOT / ".venv"
STORE = ROOT / ".venvs"
DONE = "complete"  # marker file of a complete installation
OLDEST = (3, 11)
MAX_ENVIRONMENTS = 3  # kept: the one in use, and older ones in which processes may still run


class SetupError(Exception):
    """The environment cannot be made; the message is for the user."""


def main(arguments: Sequence[str]) -> int:
    """Prepare the environment, then become the command; return only if there is none."""
    if arguments and arguments[0] in {"-h", "--help"}:
        print(__doc__.strip() if __doc__ else "")
        return 0
    try:
        refuse_unfit_system(sys.version_info[:2], os.name)
        environment = ready_environment()
        if not arguments:
            print(f"{LINK} is ready")
            return 0
        exec_command(environment, arguments)
    except (SetupError, OSError) as error:  # an OSError names the file: a full disk, a read-only checkout
        print(f"deploy/env.py: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\ndeploy/env.py: interrupted; the next start begins the installation anew", file=sys.stderr)
        return 130


def refuse_unfit_system(version: tuple[int, ...], system: str) -> None:
    """Raise SetupError if Python is too old or the system is not POSIX."""
    if version < OLDEST:
        found, needed = ".".join(map(str, version)), ".".join(map(str, OLDEST))
        raise SetupError(
            f"Python {found} is too old: start this with Python {needed} or newer, "
            f"e.g. python3.12 deploy/env.py ({sys.executable} was used)"
        )
    if system != "posix":
        raise SetupError("only Linux and macOS are supported: on Windows, use WSL")


def ready_environment() -> Path:
    """Return the path of the complete environment of this checkout as it is now; make it if needed."""
    environment = STORE / key_of(ROOT, sys.version_info[:2], os.uname().machine)
    if not in_use(environment):
        with installation_lock():
            if not in_use(environment):  # another process may have made it while this one waited
                if not complete(environment):
                    make(environment)
                link_environment(LINK, environment)
                remove_old(environment)
    return environment


def key_of(root: Path, version: tuple[int, ...], machine: str) -> str:
    """Return a short key of an environment's inputs: place, Python, machine, metadata, lock, recipe."""
    import tomllib  # noqa: PLC0415  (an older Python lacks it, and must first print that it is too old)

    pyproject = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    metadata = [pyproject["project"], pyproject["build-system"], pyproject["tool"]["hatch"]]
    digest = hashlib.sha256()
    for part in (
        str(root).encode(),  # the scripts in an environment name its absolute path
        f"{machine} {version}".encode(),
        json.dumps(metadata, sort_keys=True).encode(),
        (root / "deploy" / "lock" / "dev.txt").read_bytes(),
        b"1",  # to be raised when the recipe of an environment changes
    ):
        digest.update(hashlib.sha256(part).digest())
    return digest.hexdigest()[:12]


def complete(environment: Path) -> bool:
    """Return whether the installation is complete and its Python exists (an upgrade may remove it)."""
    return (environment / DONE).exists() and os.access(environment / "bin" / "python", os.X_OK)


def in_use(environment: Path) -> bool:
    """Return whether the link names this environment, and it is complete."""
    return LINK.is_symlink() and LINK.resolve() == environment and complete(environment)


def link_environment(link: Path, environment: Path) -> None:
    """Point the link to the environment, atomically."""
    if link.exists() and not link.is_symlink():
        raise SetupError(f"{link} exists and is not a link: move or remove it; a link is made there")
    new = link.with_name(f"{link.name}.{os.getpid()}")
    new.symlink_to(environment.relative_to(link.parent), target_is_directory=True)
    new.replace(link)


def remove_old(current: Path) -> None:
    """Remove environments that are probably no longer used."""
    others = [path for path in STORE.iterdir() if path.is_dir() and path != current]
    others.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    for path in others[MAX_ENVIRONMENTS - 1 :]:
        shutil.rmtree(path, ignore_errors=True)


@contextmanager
def installation_lock() -> Iterator[None]:
    """Let one process at a time install in this checkout; a second one waits, with a message."""
    import fcntl  # noqa: PLC0415  (likewise for a system without it)

    STORE.mkdir(exist_ok=True)
    with (STORE / "lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("waiting for another process that is installing the environment", file=sys.stderr)
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def make(environment: Path) -> None:
    """Install the lock and this checkout into a new environment; raise SetupError on failure."""
    shutil.rmtree(environment, ignore_errors=True)  # left by an interrupted installation
    requirements = LOCK / "dev.txt"
    progress = Progress(len(pins(requirements.read_text(encoding="utf-8"))), sys.stderr)
    progress.start(f"installing the pinned environment into {LINK} (once; the next start is immediate)")
    try:
        pip = new_environment(environment)
        # Wheels only: building from source would fetch tools that no lock pins. The lock needs no resolving.
        fetch = ["install", "--require-hashes", "--only-binary=:all:", "--no-deps", "-r", str(requirements)]
        run_pip([*pip, *fetch], progress)
        run_pip([*pip, "install", "--no-deps", "--no-build-isolation", "--editable", str(ROOT)], progress)
    except BaseException:
        progress.end("installation not finished")
        raise
    (environment / DONE).touch()
    progress.end("installed")


def new_environment(environment: Path) -> list[str]:
    """Make an empty virtual environment; return the command that starts a pip for it."""
    python = str(environment / "bin" / "python")
    if has_module(sys.executable, "ensurepip"):
        run_checked([sys.executable, "-m", "venv", str(environment)])
        return [python, "-m", "pip"]
    other = find_pip()
    if other is None or not has_module(sys.executable, "venv"):
        package = "python{}.{}-venv".format(*sys.version_info)
        raise SetupError(
            f"{sys.executable} cannot make a virtual environment (it has neither ensurepip nor a pip): "
            f"install what is missing, on Debian and Ubuntu with: sudo apt install {package}"
        )
    run_checked([sys.executable, "-m", "venv", "--without-pip", str(environment)])
    return [*other, "--python", python]


def has_module(python: str, name: str) -> bool:
    """Return whether that Python can import the module."""
    return run([python, "-c", f"import {name}"]).returncode == 0


def find_pip() -> list[str] | None:
    """Return a pip that can install into another environment (22.3 or newer), or None."""
    for command in ([sys.executable, "-m", "pip"], ["pip3"], ["pip"]):
        if shutil.which(command[0]) is not None:
            answer = run([*command, "--version"])
            if release(answer.stdout.removeprefix("pip ")) >= (22, 3):
                return command
    return None


def release(text: str) -> tuple[int, ...]:
    """Return the version at the start of a text: "23.0.1 from /usr" -> (23, 0, 1), other text -> ()."""
    found = re.match(r"\d+(\.\d+)*", text)
    return tuple(map(int, found[0].split("."))) if found else ()


def pins(requirements: str) -> set[str]:
    """Return the names of the packages that a lock file pins."""
    return set(re.findall(r"^([\w.-]+)==", requirements, flags=re.MULTILINE))


def own_variables(environ: Mapping[str, str]) -> dict[str, str]:
    """Return the caller's variables without those of other installations, such as a sourced ROS."""
    return {name: value for name, value in environ.items() if name not in {"PYTHONPATH", "PYTHONHOME"}}


def run(command: Sequence[str], cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a program without the variables of other installations; return its output."""
    return subprocess.run(
        command, cwd=cwd, env=own_variables(os.environ), capture_output=True, text=True, check=False
    )


def run_checked(command: Sequence[str], cwd: Path | None = None) -> None:
    """Run a step of the installation; raise SetupError with the end of its output if it fails."""
    done = run(command, cwd)
    if done.returncode != 0:
        raise SetupError(failure(command, [*done.stdout.splitlines(), *done.stderr.splitlines()]))


def run_pip(command: Sequence[str], progress: Progress) -> None:
    """Run pip, showing its output as progress; raise SetupError with the end of it on failure."""
    # The user's configuration decides where pip fetches from, but not that it installs elsewhere than here.
    variables = own_variables(os.environ)
    variables |= {"PYTHONUNBUFFERED": "1", "PIP_USER": "0", "PIP_REQUIRE_HASHES": "0"}
    printed = []
    with subprocess.Popen(
        [*command, "--no-input", "--disable-pip-version-check", "--progress-bar=off"],
        env=variables,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None  # noqa: S101  (for the type checker: it was asked for above)
        for line in process.stdout:
            printed.append(line.rstrip())
            progress.process_line(line)
    if process.returncode != 0:
        raise SetupError(failure(command, printed))


def failure(command: Sequence[str], printed: Sequence[str]) -> str:
    """Return the failed command, with the last lines that it printed."""
    typed = textwrap.shorten(" ".join(command), 200, placeholder=" …")
    return "\n  ".join([f"this failed: {typed}", *printed[-12:]])


class Progress:
    """One line that changes in a terminal; a first and a last line in a log."""

    def __init__(self, packages: int, stream: TextIO) -> None:
        self._packages, self._stream, self._tty = packages, stream, stream.isatty()
        self._collected, self._begin = 0, time.monotonic()

    def start(self, text: str) -> None:
        """Show what begins."""
        print(text, file=self._stream, flush=True)

    def process_line(self, line: str) -> None:
        """Take one line of pip's output."""
        words = line.split()
        if words[:1] == ["Collecting"] and len(words) > 1:
            self._collected += 1
            self._show(f"{min(self._collected, self._packages)}/{self._packages} {words[1].split(';')[0]}")
        elif words[:1] == ["Installing"]:
            self._show(f"unpacking {self._packages} packages")

    def end(self, text: str) -> None:
        """Show the result and the duration."""
        if self._tty:
            print("\r\033[K", end="", file=self._stream)
        print(f"{text} in {time.monotonic() - self._begin:.0f} s", file=self._stream, flush=True)

    def _show(self, text: str) -> None:
        if self._tty:
            elapsed = time.monotonic() - self._begin
            print(f"\r\033[K  {elapsed:3.0f} s  {text[:60]}", end="", file=self._stream, flush=True)


def exec_command(environment: Path, arguments: Sequence[str]) -> NoReturn:
    """Replace this process by a command of the environment; raise SetupError if there is no such command."""
    program = environment / "bin" / arguments[0]
    if "/" in arguments[0] or not os.access(program, os.X_OK):
        raise SetupError(
            f"there is no command {arguments[0]!r} in the environment; there are, among others, "
            "formation, pytest, ruff, mypy, lint-imports and python"
        )
    variables = own_variables(os.environ)
    variables["VIRTUAL_ENV"] = str(environment)
    variables["PATH"] = os.pathsep.join([str(environment / "bin"), variables.get("PATH", os.defpath)])
    os.execve(program, [str(program), *arguments[1:]], variables)  # noqa: S606  (no shell is wanted)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
