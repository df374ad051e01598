"""A recording of a real run, what its live page showed, and `formation replay` as a real process."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, NamedTuple

import httpx
import pytest

from tests.support.child import PATIENCE
from tests.support.launched import command
from tests.support.looking import PLAIN, looking


class Run(NamedTuple):
    """Results of a run."""

    path: Path
    """Its recording, which no test changes."""
    hello: dict[str, Any]
    frames: list[dict[str, Any]]
    """Frames of its live page."""
    result: dict[str, Any]


def drive(folder: Path, frames_after: int) -> Run:
    """Run six robots until `frames_after` frames after they have settled, with the live page open."""
    arguments = ("run", "six_robots", "--duration", "90", "--record", "run.mcap", "--json")
    with command(*arguments, "--page", "127.0.0.1:0", folder=folder) as process:
        assert process.stderr is not None
        address = after("Page: ", process.stderr)
        frames: list[dict[str, Any]] = []
        left = math.inf
        hello: dict[str, Any] = {}
        # a stream that ends with its server
        with suppress(httpx.RemoteProtocolError), looking(address) as events:
            for received in events:
                if received.kind == "hello":
                    hello = received.data
                elif received.kind == "frame":
                    frames.append(received.data)
                    left -= 1
                    if left == 0:
                        process.send_signal(signal.SIGINT)
                elif received.kind == "event" and received.data["kind"] == "settled":
                    left = frames_after
        out, _ = process.communicate(timeout=90.0)
    assert frames, out
    return Run(folder / "run.mcap", hello, frames, json.loads(out.splitlines()[-1]))


def after(beginning: str, lines: IO[str]) -> str:
    """Return the rest of the next line that begins with `beginning`."""
    for line in lines:
        if line.startswith(beginning):
            return line.removeprefix(beginning).strip()
    raise AssertionError(f"the process ended without printing {beginning!r}")


class Replayed:
    """A process `formation replay`, which is controlled by HTTP."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        assert process.stderr is not None
        self.process = process
        self.address = after("page: ", process.stderr)
        self.log: list[str] = []
        self._reader = threading.Thread(target=self._read, args=(process.stderr,), daemon=True)
        self._reader.start()

    def steer(self, do: str, to: float | None = None) -> httpx.Response:
        body = {"do": do} if to is None else {"do": do, "to": to}
        return httpx.post(f"{self.address}api/replay", json=body, timeout=PATIENCE, verify=PLAIN)

    def steered(self, do: str, to: float | None = None) -> dict[str, Any]:
        answer = self.steer(do, to)
        assert answer.status_code == 200, answer.text
        standing: dict[str, Any] = answer.json()
        return standing

    def picture(self, at: float) -> tuple[dict[str, Any], dict[str, Any]]:
        """Seek to `at` [s] in a paused replay; return the greeting and the frame there."""
        assert self.steered("seek", at)["t"] == pytest.approx(at, abs=0.002)
        hello: dict[str, Any] = {}
        with looking(self.address) as events:
            for received in events:
                if received.kind == "hello":
                    hello = received.data
                elif received.kind == "frame" and received.data["t"] == pytest.approx(at, abs=0.002):
                    return hello, received.data
        raise AssertionError("the stream ended without a frame")

    def result(self, patience: float = PATIENCE) -> dict[str, Any]:
        self.process.wait(patience)
        self._reader.join(PATIENCE)
        assert self.process.stdout is not None
        found: dict[str, Any] = json.loads(self.process.stdout.read().splitlines()[-1])
        return found

    def interrupt(self) -> dict[str, Any]:
        """Send SIGINT; return the result."""
        self.process.send_signal(signal.SIGINT)
        return self.result()

    def _read(self, stream: IO[str]) -> None:
        self.log.extend(stream)


@contextmanager
def replaying(path: Path, *flags: str) -> Iterator[Replayed]:
    """Start a replay of `path` with a page on a free port."""
    arguments = ("replay", str(path), "--json", "--page", "127.0.0.1:0", *flags)
    with command(*arguments, folder=path.parent) as process:
        yield Replayed(process)
