"""Recorders under load that are killed at random times lose at most a second of messages.

The loss is measured by the clock of the killed process, so a busy machine does not matter.
"""

from __future__ import annotations

import mmap
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from formation.monitor.recording.reader import read
from formation.monitor.recording.recover import recover
from formation.wire import Now, Sample
from tests.support.child import PATIENCE
from tests.support.monitored import EPOCH, command, odometry
from tests.support.recordings import has_end
from tests.unit.monitor.recording.test_recorder import recorder

pytestmark = [pytest.mark.processes, pytest.mark.timeout(300)]
RATE = 1000
"""Messages a second, every second one with an attachment."""
AT_ONCE, ROUNDS = 4, 2
LOSS = 1.0
"""Greatest loss by a kill [s]."""
COUNT, TIME = struct.Struct("<q"), struct.Struct("<d")
MOST = 1_000_000
"""Number of messages for which notes have room."""


class Notes:
    """When a process gave each message to its recorder, in a shared file that outlives a kill."""

    SIZE = COUNT.size + MOST * TIME.size

    def __init__(self, path: Path) -> None:
        with path.open("a+b") as file:
            file.truncate(self.SIZE)
            self._map = mmap.mmap(file.fileno(), self.SIZE)

    def give(self, number: int, when: float) -> None:
        """Note when a message is given; numbers rise from 0 on."""
        TIME.pack_into(self._map, COUNT.size + number * TIME.size, when)
        COUNT.pack_into(self._map, 0, number + 1)

    def given(self) -> int:
        """Return the number of messages so far."""
        count: int = COUNT.unpack_from(self._map)[0]
        return count

    def when(self, number: int) -> float:
        """Return when this message was given [s, monotonic]."""
        time: float = TIME.unpack_from(self._map, COUNT.size + number * TIME.size)[0]
        return time

    def age(self, kept: int, given: int) -> float:
        """Return the age of the oldest missing message when the last was given [s]; 0 if none is missing."""
        return self.when(given - 1) - self.when(kept) if kept < given else 0.0


def main(path: Path, about: Path) -> None:
    """Record `RATE` messages a second until killed, with notes in `about`."""
    notes = Notes(about)
    with recorder(path) as recording:
        start, count = time.monotonic(), 0
        while True:
            now = Now(time.monotonic(), 0.0)
            for number in range(count, int((now.mono - start) * RATE)):
                recording.write(message(number), now.mono + EPOCH)
                notes.give(number, now.mono)
                count = number + 1
            recording.flush(now.mono)
            time.sleep(0.02)


def message(number: int) -> Sample:
    """Return the message with this number, counted from 0."""
    if number % 2:
        return odometry(f"robot{2 + number % 5}", number / RATE)
    return command("robot3", number / RATE, 0.1, number / RATE)._replace(attachment=b'{"n": %d}' % number)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """Make a folder in memory if possible: a kill loses the same there, but busy disks do not matter."""
    memory = Path("/dev/shm")  # noqa: S108 - a folder of its own in there
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(prefix="killed-", dir=memory) as name:
        yield Path(name)


def test_kill_at_random_time_loses_at_most_a_second(folder: Path) -> None:
    choice = random.Random(20)
    losses = [loss for turn in range(ROUNDS) for loss in killed(folder / str(turn), choice)]
    print("lost", sorted(round(loss, 2) for loss in losses))
    assert len(losses) == AT_ONCE * ROUNDS
    assert max(losses) <= LOSS


def killed(folder: Path, choice: random.Random) -> list[float]:
    """Run several recorders and kill each at a random time; return what each lost [s]."""
    folder.mkdir()
    paths = [folder / f"{number}.mcap" for number in range(AT_ONCE)]
    with ExitStack() as stack:
        children = [stack.enter_context(started(path, notes_of(path))) for path in paths]
        moments = {path: choice.uniform(0.7, 3.0) for path in paths}
        for path, child in sorted(zip(paths, children, strict=True), key=lambda pair: moments[pair[0]]):
            wait_until_given(notes_of(path), moments[path] * RATE)
            child.send_signal(signal.SIGKILL)
            child.wait()
    return [lost(path) for path in paths]


@contextmanager
def started(path: Path, about: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Start a process that records `path` with notes in `about`; kill it at the end."""
    where = f"Path({str(path)!r}), Path({str(about)!r})"
    code = f"from pathlib import Path; from {__name__} import main; main({where})"
    with subprocess.Popen([sys.executable, "-c", code], cwd=Path(__file__).parents[3]) as child:
        try:
            yield child
        finally:
            child.kill()


def notes_of(path: Path) -> Path:
    return path.with_suffix(".notes")


def wait_until_given(about: Path, messages: float) -> None:
    """Wait until a recorder has been given this many messages; a busy machine may start it late."""
    deadline = time.monotonic() + 4 * PATIENCE
    while given(about) <= messages:
        assert time.monotonic() < deadline, f"{given(about)} messages, not {messages}"
        time.sleep(0.01)


def given(about: Path) -> int:
    """Return how many messages a recorder has been given."""
    return Notes(about).given() if about.exists() else 0


def lost(path: Path) -> float:
    """Return the age of the oldest missing message when the last was given [s]; 0 if none is missing."""
    notes = Notes(notes_of(path))
    count = notes.given()
    out = path.with_name(f"{path.stem}-recovered.mcap")
    assert not has_end(path)
    assert not recover(path, out).is_whole
    kept = list(read(path).messages())
    assert list(read(out).messages()) == kept
    assert [one.sample[:3] for one in kept] == [message(number)[:3] for number in range(len(kept))]
    assert count > 500
    return notes.age(len(kept), count)
