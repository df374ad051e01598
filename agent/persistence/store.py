"""The files of one agent: the data of `formation.agent.persistence.restore`, written by separate threads.

The control loop passes data on and continues; a slow disk does not delay it. The file of stops is complete
at every moment (a new file is renamed over the old one), so it survives a kill at once, and a power cut as
soon as it has been forced to the disk. The saved state is of no use after a power cut, so it is only written,
always to the same file, and the system flushes it now and then.
"""

from __future__ import annotations

import errno
import json
import os
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from zlib import crc32

from formation.agent.persistence.state import Json
from formation.transport.runtime.clock import suspended

STATE_FILE_BYTES = 16 * 1024
"""Space that is reserved for saved state [bytes]; it takes a third of that at most, as a rule."""
MAX_FILE_BYTES = 64 * 1024
"""Greatest size of a file that an agent wrote [bytes]."""
CLOSE_TIMEOUT_SECONDS = 1.0
"""Longest time that `close` waits for a disk [s]."""
_BOOT = Path("/proc/sys/kernel/random/boot_id")


def boot_id() -> str:
    """Id of the time since this machine was switched on, or woke for the last time; empty if unknown."""
    try:
        boot = _BOOT.read_text(encoding="ascii").strip()
    except OSError:
        return ""
    return f"{boot} {slept}" if boot and (slept := suspended()) else boot


def state_line(state: Json) -> bytes:
    """Encode a saved state as the line that its file begins with, which has a checksum."""
    text = json.dumps(state, separators=(",", ":"), allow_nan=False).encode()
    return b"%08x %s\n" % (crc32(text), text)


def state_in(data: bytes) -> bytes:
    """Return the saved state in a file's `data`. Raises OSError if the line is incomplete."""
    checksum, _, text = data.partition(b"\n")[0].partition(b" ")
    if checksum != b"%08x" % crc32(text):
        raise OSError("it was not written to its end")
    return text


class Worker:
    """A thread that runs the newest job; jobs that were replaced before they began do not run."""

    def __init__(self, name: str) -> None:
        self.failure = ""
        """Why the newest job failed; empty if it did not."""
        self._jobs: deque[Callable[[], None] | None] = deque(maxlen=1)
        self._wanted = threading.Semaphore(0)
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def do(self, job: Callable[[], None]) -> None:
        """Run `job` soon."""
        self._jobs.append(job)
        self._wanted.release()

    def close(self, patience: float) -> bool:
        """Finish the remaining job, for at most this time [s]; whether it is done."""
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
            if job is None:  # replaced
                continue
            try:
                job()
                self.failure = ""
            except OSError as error:
                self.failure = str(error)


def _end() -> None:
    """The job after which a worker ends."""


class Store:
    """Two files in a folder."""

    def __init__(self, folder: Path, robot: str) -> None:
        """Create the folder if it is missing. Raises OSError."""
        folder.mkdir(parents=True, exist_ok=True)
        self.stops, self.state = folder / f"{robot}.stops.json", folder / f"{robot}.state"
        self._folder = folder
        self._stopping, self._forcing, self._saving = map(Worker, ("stops", "forcing", "state"))
        self._state_file: int | None = None
        self._written, self._tried = threading.Event(), threading.Event()

    @property
    def failure(self) -> str:
        """Why something cannot be written now; empty if all can."""
        return self._stopping.failure or self._forcing.failure or self._saving.failure

    @property
    def stops_failed(self) -> bool:
        """Whether the newest stops could not be written."""
        return self._tried.is_set() and not self._written.is_set()

    def written(self, patience: float) -> bool:
        """Whether the newest stops are written within this time [s], and so survive a kill."""
        self._tried.wait(patience)
        return self._written.is_set()

    def write_stops(self, stops: Json) -> None:
        """Write the stops at once, then force them to the disk."""
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

    def write_state(self, state: Json) -> None:
        """Write the saved state."""

        def write() -> None:
            line = state_line(state)
            if self._state_file is None:
                self._state_file = _reserved(self.state, STATE_FILE_BYTES)
            if os.pwrite(self._state_file, line, 0) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.state))

        self._saving.do(write)

    def read_stops(self) -> bytes | None:
        """Return the stored stops; None if there are none. Raises OSError."""
        return _read(self.stops)

    def read_state(self) -> bytes | None:
        """Return the saved state; None if there is none. Raises OSError, also if it is incomplete."""
        data = _read(self.state)
        return None if data is None else state_in(data)

    def set_state_aside(self) -> Path | None:
        """Rename the saved state, so that no agent finds it; None if that fails.

        No more state can be saved then.
        """
        self._saving.close(CLOSE_TIMEOUT_SECONDS)
        failed = self.state.with_suffix(".state.failed")
        try:
            self.state.replace(failed)
        except OSError:
            return None
        return failed

    def close(self) -> None:
        """Write what remains, unless the disk hangs; a second call has no effect."""
        self._stopping.close(CLOSE_TIMEOUT_SECONDS)
        self._forcing.close(CLOSE_TIMEOUT_SECONDS)
        if self._saving.close(CLOSE_TIMEOUT_SECONDS) and self._state_file is not None:
            place, self._state_file = self._state_file, None
            os.close(place)

    def _force(self) -> None:
        for path in (self.stops, self._folder):
            place = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(place)
            finally:
                os.close(place)


def _reserved(path: Path, size: int) -> int:
    """Open a file, with space for so many bytes: a full disk must not cut a line. Raises OSError."""
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        os.posix_fallocate(file, 0, size)
    except OSError as error:
        if error.errno not in {errno.EOPNOTSUPP, errno.EINVAL}:  # a file system that cannot reserve any
            os.close(file)
            raise
    return file


def _read(path: Path) -> bytes | None:
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):  # opening a pipe waits for its other end
            raise OSError(f"{path}: must be a file")
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except FileNotFoundError:
        return None
    if len(data) > MAX_FILE_BYTES:
        raise OSError(f"{path}: is longer than anything that an agent keeps")
    return data
