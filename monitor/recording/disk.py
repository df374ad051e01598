"""The thread that writes a recording, so that the monitor never waits for a slow or full disk.

It receives only chunks; another thread forces what it has written to the disk. A refused write is reported,
and tried again later.
"""

from __future__ import annotations

import errno
import logging
import threading
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from itertools import count
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import NamedTuple

from formation.monitor.recording.channels import Channels
from formation.monitor.recording.chunk import Chunk
from formation.monitor.recording.forcing import NOTHING, Forcer, Mark
from formation.monitor.recording.part import Part
from formation.monitor.recording.rotation import Room, Rotation, need_room, part_path

RETRY_DELAY = 10.0
"""Time after a failure until the next try [s]."""
_log = logging.getLogger(__name__)


class Notice(NamedTuple):
    """A message about the recording."""

    level: int
    """As in `logging`."""
    text: str


class Disk:
    """Write one recording, part after part. The public methods are for the watching thread."""

    def __init__(
        self,
        path: Path,
        about: Mapping[str, str],
        channels: Channels,
        rotation: Rotation,
        room: Room,
        *,
        forces: bool = True,
    ) -> None:
        """Begin the first part at once. Raises OSError.

        With `forces`, only what is on the disk itself is safe; without, also what a power cut would take.
        """
        self.failure: str | None = None
        """Why nothing is being recorded now; None if it is."""
        self.paths: tuple[Path, ...] = ()
        """Every part so far."""
        self.lost = 0
        """Number of messages lost for good."""
        self.written = 0
        """Number of chunks processed, written or lost."""
        self.notices: deque[Notice] = deque(maxlen=100)
        self._first, self._about, self._channels = path, about, channels
        self._rotation, self._room = rotation, room
        self._queue: SimpleQueue[Chunk | threading.Event | None] = SimpleQueue()
        self._forcer, self._forces = Forcer(), forces
        self._ended = NOTHING  # the parts before this one
        self._retry = 0.0
        self._begun: float | None = None  # when this part was given its first chunk [s, monotonic]
        self._name = 0  # the number in the newest part's name
        self._part: Part | None = None
        self._begin()
        self._tell(logging.INFO, f"recording into {path}")
        self._thread = threading.Thread(target=self._work, name="recording", daemon=True)
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Return whether the thread still takes chunks."""
        return self._thread.is_alive()

    @property
    def safe(self) -> Mark:
        """Up to where it is on the disk itself, and survives a power cut."""
        return self._forcer.safe

    def put(self, chunk: Chunk) -> None:
        """Queue a chunk for writing."""
        self._queue.put(chunk)

    def catch_up(self, patience: float) -> bool:
        """Wait until all chunks are processed, at most `patience` [s]; whether they are."""
        done = threading.Event()
        self._queue.put(done)
        return done.wait(patience)

    def close(self, patience: float) -> bool:
        """Write the rest and end the file; return False if that takes longer than `patience` [s]."""
        self._queue.put(None)
        self._thread.join(patience)
        return not self._thread.is_alive()

    def _work(self) -> None:
        more = True
        while more:
            batch = self._next()
            more = batch[-1] is not None
            chunks = [one for one in batch if isinstance(one, Chunk)]
            for chunk in chunks:
                self._keep(chunk)
                self.written += 1
            self._force(chunks)
            for one in batch:
                if isinstance(one, threading.Event):
                    one.set()
        self._end()
        self._forcer.close()

    def _next(self) -> list[Chunk | threading.Event | None]:
        """Return everything that waits, at least one thing."""
        batch = [self._queue.get()]
        with suppress(Empty):
            while batch[-1] is not None:
                batch.append(self._queue.get_nowait())
        return batch

    def _keep(self, chunk: Chunk) -> None:
        """Write a chunk to its part: the current or the next one."""
        try:
            if self._part is not None and self._part.is_gone:
                self._lose(self._part)
            if self._part is None:
                self._resume(chunk.handed)
            elif self._is_due(self._part, chunk):
                self._end()
                self._begin()
            self._append(chunk)
        except OSError as error:
            self.lost += chunk.total
            self._fail(error, chunk.handed)
        except Exception as error:  # noqa: BLE001 - one odd chunk must not end the recording
            _log.exception("a chunk cannot be written")
            self.lost += chunk.total
            self._fail(OSError(str(error)), chunk.handed)

    def _is_due(self, part: Part, chunk: Chunk) -> bool:
        """Return whether a chunk belongs to the next part; every part gets at least one."""
        if self._begun is None:
            return False
        return self._rotation.is_due(part.whole_size + len(chunk.raw), chunk.handed - self._begun)

    def _append(self, chunk: Chunk) -> None:
        if self._part is None:  # too early to try again
            self.lost += chunk.total
            return
        try:
            need_room(self._part.path.parent, self._room.stop)
            self._part.append(chunk)
        except OSError as error:
            if error.errno != errno.EFBIG or not self._part.counts:
                raise
            self._end()  # some file systems allow files of 2 or 4 GB at most
            self._begin()
            self._part.append(chunk)
        if self._begun is None:
            self._begun, self.failure = chunk.handed, None
            if len(self.paths) > 1:
                self._tell(logging.INFO, f"recording goes on in {self._part.path}")

    def _begin(self, room: int | None = None) -> None:
        """Begin a part; after a failure `room` must be free for it [bytes]. Raises OSError."""
        previous = self.paths[-1].name if self.paths else ""
        about = {**self._about, "part": str(len(self.paths) + 1), "previous": previous}
        part, name = self._create(about)
        try:
            need_room(part.path.parent, self._room.stop if room is None else room)
            if room is not None:
                part.reserve(self._room.stop)
        except OSError:
            part.discard()
            raise
        self._part, self._name, self._begun = part, name, None
        self.paths = (*self.paths, part.path)

    def _create(self, about: Mapping[str, str]) -> tuple[Part, int]:
        """Create the next part under the next free name; the first part's name is fixed."""
        for name in count(self._name + 1):
            try:
                return Part(part_path(self._first, name), about, self._channels), name
            except FileExistsError:
                if not self.paths:
                    raise
        raise AssertionError

    def _resume(self, now: float) -> None:
        """Go on in a new part if there is none and the time has come."""
        if now >= self._retry:
            self._begin(self._room.resume if self.failure else None)

    def _force(self, chunks: list[Chunk]) -> None:
        """Force what was written to the disk; only then it counts as recorded."""
        if self._part is None:
            self._forcer.confirm(self._ended._replace(number=self.written))
            return
        counts, size = self._ended.counts + self._part.counts, self._ended.size + self._part.size
        mark = Mark(self.written, counts, size)
        if not self._forces:
            self._forcer.confirm(mark)
            return
        try:
            self._forcer.request(self._part, mark)
        except OSError as error:  # unknown what of it was written: new messages go to another part
            self._fail(error, chunks[-1].handed if chunks else 0.0)

    def _end(self) -> None:
        """End this part, whole if possible."""
        if self._part is None:
            return
        part, self._part = self._part, None
        try:
            part.finish()
        except OSError as error:
            if self.failure is None:
                self._tell(
                    logging.WARNING, f"{part.path} has no index, for it cannot be ended: {error.strerror}"
                )
        counts, size = self._ended.counts + part.counts, self._ended.size + part.size
        self._ended = Mark(self.written, counts, size)
        self._forcer.confirm(self._ended)

    def _lose(self, part: Part) -> None:
        """Give up a part with a deleted file: only its messages are lost."""
        self._part = None
        with suppress(OSError):
            part.finish()
        self.lost += part.counts.total()
        self._retry = 0.0
        self._forcer.confirm(self._ended._replace(number=self.written))
        self._tell(logging.ERROR, f"{part.path} was deleted, with the {part.counts.total()} messages in it")

    def _fail(self, error: OSError, now: float) -> None:
        """Close the part with what is whole, and report once that recording pauses."""
        fresh = self.failure is None
        self.failure, self._retry = error.strerror or str(error), now + RETRY_DELAY
        if self._part is not None and self._begun is None and len(self.paths) > 1:
            with suppress(OSError):
                self._part.discard()
            self._part, self._name, self.paths = None, self._name - 1, self.paths[:-1]
        self._end()
        if fresh:
            again = f"it is tried again every {RETRY_DELAY:g} s"
            self._tell(
                logging.ERROR, f"{self.paths[-1]}: nothing is recorded any more: {self.failure}; {again}"
            )

    def _tell(self, level: int, text: str) -> None:
        _log.log(level, "%s", text)
        self.notices.append(Notice(level, text))
