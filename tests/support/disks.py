"""Small disks of a test's own, and a recorder that is fed faster than time."""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from formation.monitor.recording.recorder import Recorder
from tests.support.child import PATIENCE
from tests.support.monitored import EPOCH, command
from tests.support.needs import path_of


def feed(recording: Recorder, start: float, end: float) -> None:
    """Ten messages a second from `start` to `end` [s]; wait until the disk has dealt with them."""
    for tick in range(round(start * 10), round(end * 10)):
        sample = command("robot2", tick / 10, 0.1, 0.2)._replace(attachment=b'{"n": %d}' % tick)
        recording.write(sample, sample.arrived + EPOCH)
        recording.flush(sample.arrived)
        if tick % 5 == 0:
            settle(recording)
    settle(recording)


def settle(recording: Recorder) -> None:
    """Wait until the disk has dealt with all that was handed to it."""
    deadline = time.monotonic() + PATIENCE
    while recording._disk.written < recording._handed:
        assert time.monotonic() < deadline, "the disk does not come to an end"
        time.sleep(0.001)


def run(program: str, *arguments: str | Path) -> str:
    done = subprocess.run(
        [path_of(program), *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{program}: {done.stderr}"
    return done.stdout.strip()


@contextmanager
def mounted(*arguments: str | Path) -> Iterator[Path]:
    """A folder on which a disk is mounted."""
    with tempfile.TemporaryDirectory(prefix="disk-") as name:
        run("mount", *arguments, name)
        try:
            yield Path(name)
        finally:
            run("umount", "--lazy", name)


@contextmanager
def in_memory(size: int) -> Iterator[Path]:
    """A disk of so many bytes."""
    with mounted("-t", "tmpfs", "-o", f"size={size}", "tmpfs") as folder:
        yield folder


@contextmanager
def in_a_file(image: Path, megabytes: int) -> Iterator[Path]:
    """An ext4 of its own whose blocks are the file `image`; what that holds is what the disk holds."""
    with image.open("wb") as file:
        file.truncate(megabytes * 1_000_000)
    run("mkfs.ext4", "-q", "-F", "-E", "lazy_itable_init=0,lazy_journal_init=0", image)
    with mounted("-o", "loop", image) as folder:
        yield folder
