"""Run a command on a robot with this machine's OpenSSH client, and explain its failures.

It never prompts: an unknown host key or a password request is a named failure. Connection settings (ports,
jump hosts, keys) are those of ~/.ssh/config and ``--ssh-option``.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.resources import files
from typing import IO, Any, NamedTuple

from formation.deploy.fleet.on_robot import MARK

CONNECT_TIMEOUT = 8
"""Longest time for a connection [s]."""
OPTIONS = (
    "BatchMode=yes",
    f"ConnectTimeout={CONNECT_TIMEOUT}",
    "ServerAliveInterval=5",  # gives up after 15 s if a robot is unplugged during a transfer
    "ServerAliveCountMax=3",
)
SSH_FAILED, NOT_FOUND = 255, 127
LAST_LINES = 6
AS_ROOT = ("sh", "-c", 'if [ "$(id -u)" = 0 ]; then exec "$@"; fi; exec sudo -n -- "$@"', "sh")
Feed = Callable[[IO[bytes]], None]
Line = Callable[[str], None]


class RemoteError(Exception):
    """A robot was not reached, or could not do the request; the text gives the cause."""

    def __init__(self, reason: str, lines: Sequence[str] = ()) -> None:
        """`reason` is a sentence; `lines` is the end of the robot's output."""
        super().__init__(reason)
        self.lines = tuple(lines)


class Robot(NamedTuple):
    """A robot's host, and the paths on it."""

    name: str
    address: str
    prefix: str


class Ssh:
    """Login settings and open connections. `run` may be called in several threads at once."""

    def __init__(self, user: str | None, options: Sequence[str], *, sudo: bool) -> None:
        """With `sudo`, every user but root works through ``sudo -n``."""
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
        """Return the answer of `command` of `formation.deploy.fleet.on_robot`. Raises RemoteError.

        `feed` writes to the command's stdin; `line` gets each line of its output.
        """
        request = json.dumps({"prefix": robot.prefix, **arguments})
        program = (files("formation.deploy.fleet") / "on_robot.py").read_text(encoding="utf-8")
        words = shlex.join([*(AS_ROOT if self._sudo else ()), "python3", "-c", program, command, request])
        code, lines, errors = self._run(robot, words, feed, line or (lambda _: None))
        answer = next((one for one in map(_answer, reversed(lines)) if one is not None), None)
        if answer is None and self._stopped:
            raise RemoteError("interrupted")
        if answer is None:
            lines = [] if code == SSH_FAILED else errors[-LAST_LINES:]
            raise RemoteError(failure_reason(code, errors), lines)
        if "error" in answer:
            raise RemoteError(str(answer["error"]))
        return answer

    def stop(self) -> None:
        """End all running commands, and start no more."""
        self._stopped = True
        for process in tuple(self._open):
            with suppress(ProcessLookupError):
                process.terminate()

    def _run(
        self, robot: Robot, words: str, feed: Feed | None, line: Line
    ) -> tuple[int, list[str], list[str]]:
        """Return exit code, and the lines on stdout and stderr."""
        argv = [*self._login, *self._options, "--", robot.address, words]
        with tempfile.TemporaryFile() as errors:
            try:
                process = subprocess.Popen(
                    argv,
                    stdin=subprocess.DEVNULL if feed is None else subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=errors,
                )
            except FileNotFoundError:
                raise RemoteError("there is no ssh on this machine: install the OpenSSH client") from None
            self._open.add(process)
            if self._stopped:
                process.terminate()
            lines: list[str] = []
            with process:
                assert process.stdout is not None  # noqa: S101 - for the type checker: it was asked for above
                if feed is not None and process.stdin is not None:
                    with suppress(BrokenPipeError):  # the exit code tells why the pipe broke
                        feed(process.stdin)
                    with suppress(BrokenPipeError):
                        process.stdin.close()
                for text in _lines(process.stdout):
                    lines.append(text)
                    line(text)
            self._open.discard(process)
            errors.seek(0)
            return process.returncode, lines, list(_lines(errors))


def failure_reason(code: int, errors: Sequence[str]) -> str:
    """Return why a robot gave no answer."""
    error_text = " ".join(errors)
    for text, reason in KNOWN_ERRORS.items():
        if text in error_text:
            return reason
    last = next((text for text in reversed(errors) if text.strip()), "")
    if code == SSH_FAILED:
        return f"unreachable: {last or 'the connection broke off'}"
    if code == NOT_FOUND:
        return _NO_PYTHON
    return f"no answer (exit code {code}){': ' + last if last else ''}"


_GONE = "unreachable: no route to it; is it on, and in this network?"
_NO_PYTHON = "no Python: python3 was not found on the robot"
_NO_SUDO = "no sudo on the robot: log in as root, with --user root"
_BY_NAME = "--ssh-option IdentityFile=FILE"
KNOWN_ERRORS = {
    "REMOTE HOST IDENTIFICATION HAS CHANGED": "host key changed: another machine has this address, or it was"
    " installed again; in that case remove the old key with ssh-keygen -R ADDRESS",
    "Host key verification failed": "host key unknown: log in once by hand with ssh, and compare it",
    "Permission denied (": f"key refused: put yours there with ssh-copy-id, or try --user, {_BY_NAME}",
    "Too many authentication failures": f"key refused: too many were tried; name one with {_BY_NAME}",
    "Connection refused": "unreachable: connection refused; does sshd run there?",
    "No route to host": _GONE,
    "Network is unreachable": _GONE,
    "Could not resolve hostname": "unreachable: its address is unknown; give it with --host ROBOT=ADDRESS",
    "timed out": "unreachable: no answer in time; is it on, and in this network?",
    "sudo: a password is required": "sudo asks for a password: allow sudo without one, or use --user root",
    "sudo: command not found": _NO_SUDO,
    "sudo: not found": _NO_SUDO,
    "python3: not found": _NO_PYTHON,
    "python3: command not found": _NO_PYTHON,
    "No space left on device": "disk full",
}
"""Messages of ssh, the shell and sudo, and their meaning; the first match counts."""


def _answer(text: str) -> dict[str, Any] | None:
    if not text.startswith(MARK):
        return None
    try:
        answer = json.loads(text.removeprefix(MARK))
    except ValueError:
        return None
    return answer if isinstance(answer, dict) else None


def _lines(stream: IO[bytes]) -> Iterator[str]:
    return (raw.decode(errors="replace").rstrip() for raw in stream)
