"""The files of one agent: what `agent.survival` keeps, written by threads of their own.

The control loop hands something over and goes on; a disk that hangs costs it nothing. What an operator asked
is a whole file at every moment (a new one takes the old one's name), which survives a kill at once, and a
power cut as soon as it has been forced to the disk. The way is of no use after a power cut, so it is merely
written, always over the same place, and the system puts it on the disk now and then.
"""

from __future__ import annotations

import json
import os
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from zlib import crc32

from agent.memory import Json

LONGEST = 64 * 1024
"""What is longer was not kept by an agent [bytes]."""
PATIENCE = 1.0
"""So long `close` waits for a disk [s]."""
_BOOT = Path("/proc/sys/kernel/random/boot_id")


def boot_id() -> str:
    """Names the time since this machine was switched on; empty where nobody knows."""
    try:
        return _BOOT.read_text(encoding="ascii").strip()
    except OSError:
        return ""


class Worker:
    """A thread that does what it was asked for last; what was overtaken is not done."""

    def __init__(self, name: str) -> None:
        self.failure = ""
        """Why the newest could not be done; empty if it could."""
        self._jobs: deque[Callable[[], None] | None] = deque(maxlen=1)
        self._wanted = threading.Semaphore(0)
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def do(self, job: Callable[[], None]) -> None:
        """Have it done, soon."""
        self._jobs.append(job)
        self._wanted.release()

    def close(self, patience: float) -> bool:
        """Do what is still to be done, for at most so long [s]; whether it has all been done."""
        while self._jobs and self._thread.is_alive() and patience > 0.0:
            self._thread.join(0.005)
            patience -= 0.005
        self.do(_end)
        self._thread.join(max(patience, 0.0))
        return not self._thread.is_alive()

    def _work(self) -> None:
        while True:
            self._wanted.acquire()
            job = self._jobs.pop() if self._jobs else None
            if job is _end:
                return
            if job is None:  # overtaken
                continue
            try:
                job()
                self.failure = ""
            except OSError as error:
                self.failure = str(error)


def _end() -> None:
    """The job after which a worker ends."""


class Keeping:
    """Two files in a folder."""

    def __init__(self, folder: Path, robot: str) -> None:
        """The folder is made if there is none. Raises OSError."""
        folder.mkdir(parents=True, exist_ok=True)
        self.stops, self.way = folder / f"{robot}.stops.json", folder / f"{robot}.way"
        self._folder = folder
        self._stopping, self._forcing, self._going = map(Worker, ("stops", "forcing", "way"))
        self._place: int | None = None
        self._written, self._tried = threading.Event(), threading.Event()

    @property
    def failure(self) -> str:
        """Why something cannot be kept just now; empty if all can."""
        return self._stopping.failure or self._forcing.failure or self._going.failure

    def written(self, patience: float) -> bool:
        """Whether the newest stops are written within so long [s]: a kill does not undo them then."""
        self._tried.wait(patience)
        return self._written.is_set()

    def keep_stops(self, stops: Json) -> None:
        """Have it written at once, then forced to the disk."""
        written, tried = self._written, self._tried = threading.Event(), threading.Event()

        def write() -> None:
            try:
                fresh = self.stops.with_suffix(".new")
                fresh.write_text(json.dumps(stops, indent=1, allow_nan=False), encoding="utf-8")
                fresh.replace(self.stops)
                written.set()
            finally:
                tried.set()
            self._forcing.do(self._force)

        self._stopping.do(write)

    def keep_way(self, way: Json) -> None:
        """Have it written."""

        def write() -> None:
            text = json.dumps(way, separators=(",", ":"), allow_nan=False).encode()
            if self._place is None:
                self._place = os.open(self.way, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
            os.pwrite(self._place, b"%08x %s\n" % (crc32(text), text), 0)

        self._going.do(write)

    def read_stops(self) -> bytes | None:
        """What was kept; None for nothing. Raises OSError."""
        return _read(self.stops)

    def read_way(self) -> bytes | None:
        """What was kept; None for nothing. Raises OSError, also for what was written only in part."""
        data = _read(self.way)
        if data is None:
            return None
        checksum, _, text = data.partition(b"\n")[0].partition(b" ")
        if checksum != b"%08x" % crc32(text):
            raise OSError("it was not written to its end")
        return text

    def set_aside_way(self) -> Path | None:
        """Give the way's file another name, so that no agent finds it; None if that cannot be done.

        Nothing more can be kept of the way then.
        """
        self._going.close(PATIENCE)
        aside = self.way.with_suffix(".way.failed")
        try:
            self.way.replace(aside)
        except OSError:
            return None
        return aside

    def close(self) -> None:
        """Write what is still to be written, unless the disk hangs; twice does no harm."""
        self._stopping.close(PATIENCE)
        self._forcing.close(PATIENCE)
        if self._going.close(PATIENCE) and self._place is not None:
            place, self._place = self._place, None
            os.close(place)

    def _force(self) -> None:
        for path in (self.stops, self._folder):
            place = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(place)
            finally:
                os.close(place)


def _read(path: Path) -> bytes | None:
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):  # to open a pipe waits for its other end
            raise OSError(f"{path}: must be a file")
        with path.open("rb") as file:
            data = file.read(LONGEST + 1)
    except FileNotFoundError:
        return None
    if len(data) > LONGEST:
        raise OSError(f"{path}: is longer than anything that an agent keeps")
    return data
