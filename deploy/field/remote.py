"""A command on a robot, by the OpenSSH client of this machine; and what its failure means.

It never asks: a host whose key is unknown or a robot that wants a password is a failure with a name. Who
connects how (ports, jump hosts, keys) is what ~/.ssh/config says, and ``--ssh-option``.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.resources import files
from typing import IO, Any, NamedTuple

from deploy.field.on_robot import MARK

CONNECT_TIMEOUT = 8
"""[s]"""
OPTIONS = (
    "BatchMode=yes",
    f"ConnectTimeout={CONNECT_TIMEOUT}",
    "ServerAliveInterval=5",  # a robot that is unplugged while it is sent to is given up after 15 s
    "ServerAliveCountMax=3",
)
SSH_FAILED, NOT_FOUND = 255, 127
LAST_LINES = 6
AS_ROOT = ("sh", "-c", 'if [ "$(id -u)" = 0 ]; then exec "$@"; fi; exec sudo -n -- "$@"', "sh")
Feed = Callable[[IO[bytes]], None]
Line = Callable[[str], None]


class RemoteError(Exception):
    """A robot that was not reached, or that could not do what it was asked; the text says why."""

    def __init__(self, reason: str, lines: Sequence[str] = ()) -> None:
        """`reason` is a sentence; `lines` is the end of what the robot said."""
        super().__init__(reason)
        self.lines = tuple(lines)


class Robot(NamedTuple):
    """Where a robot is and where things are on it."""

    name: str
    address: str
    prefix: str


class Ssh:
    """How to log in, and the connections that are open. `run` may be called in several threads at once."""

    def __init__(self, user: str | None, options: Sequence[str], *, sudo: bool) -> None:
        """`sudo` has everybody but root do things by way of ``sudo -n``."""
        self._login = ("ssh", *(["-l", user] if user else []))
        self._options = tuple(word for option in (*options, *OPTIONS) for word in ("-o", option))
        self._sudo = sudo
        self._open: set[subprocess.Popen[bytes]] = set()
        self._stopped = False

    def call(
        self,
        robot: Robot,
        command: str,
        arguments: Mapping[str, Any],
        *,
        feed: Feed | None = None,
        line: Line | None = None,
    ) -> dict[str, Any]:
        """The answer of `command` of `deploy.field.on_robot`. Raises RemoteError.

        `feed` writes what the command reads on its stdin; `line` hears each line that it says.
        """
        asked = json.dumps({"prefix": robot.prefix, **arguments})
        words = shlex.join([*(AS_ROOT if self._sudo else ()), "python3", "-c", _text(), command, asked])
        code, lines, errors = self._run(robot, words, feed, line or (lambda _: None))
        answer = next((said for said in map(_answer, reversed(lines)) if said is not None), None)
        if answer is None and self._stopped:
            raise RemoteError("interrupted")
        if answer is None:
            raise RemoteError(why(code, errors), [] if code == SSH_FAILED else errors[-LAST_LINES:])
        if "error" in answer:
            raise RemoteError(str(answer["error"]))
        return answer

    def stop(self) -> None:
        """End all that is under way, and begin nothing more."""
        self._stopped = True
        for process in tuple(self._open):
            with suppress(ProcessLookupError):
                process.terminate()

    def _run(
        self, robot: Robot, words: str, feed: Feed | None, line: Line
    ) -> tuple[int, list[str], list[str]]:
        """Exit code, and the lines on stdout and stderr."""
        argv = [*self._login, *self._options, "--", robot.address, words]
        try:
            process = subprocess.Popen(
                argv,
                stdin=subprocess.DEVNULL if feed is None else subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
            )
        except FileNotFoundError:
            raise RemoteError("there is no ssh on this machine: install the OpenSSH client") from None
        self._open.add(process)
        if self._stopped:
            process.terminate()
        errors: list[str] = []
        with process:
            assert process.stdout is not None  # noqa: S101 - for the type checker: they were asked for above
            assert process.stderr is not None  # noqa: S101
            hearing = threading.Thread(
                target=errors.extend, args=(_lines(process.stderr),), name="ssh-errors", daemon=True
            )
            hearing.start()
            if feed is not None and process.stdin is not None:
                with suppress(BrokenPipeError):  # why nobody reads it, the exit code says
                    feed(process.stdin)
                with suppress(BrokenPipeError):
                    process.stdin.close()
            lines: list[str] = []
            for text in _lines(process.stdout):
                lines.append(text)
                line(text)
            hearing.join()
            code = process.wait()
        self._open.discard(process)
        return code, lines, errors


def why(code: int, errors: Sequence[str]) -> str:
    """What it means that a robot gave no answer."""
    said = " ".join(errors)
    for sign, reason in SIGNS.items():
        if sign in said:
            return reason
    last = next((text for text in reversed(errors) if text.strip()), "")
    if code == SSH_FAILED:
        return f"unreachable: {last or 'the connection broke off'}"
    if code == NOT_FOUND:
        return "no Python: python3 was not found on the robot"
    return f"no answer (exit code {code}){': ' + last if last else ''}"


_GONE = "unreachable: no route to it; is it on, and in this network?"
_NO_PYTHON = "no Python: python3 was not found on the robot"
_NO_SUDO = "no sudo on the robot: log in as root, with --user root"
_BY_NAME = "--ssh-option IdentityFile=FILE"
SIGNS = {
    "REMOTE HOST IDENTIFICATION HAS CHANGED": "host key changed: it is not the machine that it was, or it was"
    " set up anew; then remove the old key with ssh-keygen -R ADDRESS",
    "Host key verification failed": "host key unknown: log in once by hand with ssh, and compare it",
    "Permission denied (": f"key refused: put yours there with ssh-copy-id, or try --user, {_BY_NAME}",
    "Too many authentication failures": f"key refused: too many were tried; name one with {_BY_NAME}",
    "Connection refused": "unreachable: connection refused; does sshd run there?",
    "No route to host": _GONE,
    "Network is unreachable": _GONE,
    "Could not resolve hostname": "unreachable: nobody knows its address; give it with --host ROBOT=ADDRESS",
    "timed out": "unreachable: no answer in time; is it on, and in this network?",
    "sudo: a password is required": "sudo asks for a password: let it go without one, or use --user root",
    "sudo: command not found": _NO_SUDO,
    "sudo: not found": _NO_SUDO,
    "python3: not found": _NO_PYTHON,
    "python3: command not found": _NO_PYTHON,
    "No space left on device": "disk full",
}
"""What ssh, the shell and sudo say, and what that means; the first one found counts."""


def _answer(text: str) -> dict[str, Any] | None:
    if not text.startswith(MARK):
        return None
    try:
        said = json.loads(text.removeprefix(MARK))
    except ValueError:
        return None
    return said if isinstance(said, dict) else None


def _lines(stream: IO[bytes]) -> Iterator[str]:
    return (raw.decode(errors="replace").rstrip() for raw in stream)


def _text() -> str:
    return (files("deploy.field") / "on_robot.py").read_text(encoding="utf-8")
