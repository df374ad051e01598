"""The threads that write a recording, so that the monitor never waits for a slow or full disk.

One receives chunks and writes them: what it has written is safe from a kill. The other forces that to the
disk, where it is safe from a power cut: a slow card takes seconds for that. A refused write is reported, and
tried again later.
"""

from __future__ import annotations

import errno
import logging
import threading
from collections import Counter, deque
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import NamedTuple, TypeVar

from formation.monitor.recording.channels import Channels
from formation.monitor.recording.part import Chunk, Part
from formation.monitor.recording.rotation import FreeSpace, Rotation, part_path, require_free_space
from formation.monitor.recording.scan import MAX_SUMMARY_BYTES

T = TypeVar("T")
MAX_INDEX_BYTES = MAX_SUMMARY_BYTES // 2
"""Size of a part's index from which on another part begins, whatever the flags say [bytes]: one above
`MAX_SUMMARY_BYTES` is not read, and its part counts as damaged. A hundred robots take three hours."""
RETRY_DELAY = 10.0
"""Time after a failure until the next try [s]."""
_log = logging.getLogger(__name__)


class Mark(NamedTuple):
    """Progress of a recording."""

    number: int
    """Number of chunks processed, written or lost."""
    counts: Counter[int]
    """Messages in all parts, by channel."""
    size: int
    """Size of all parts together [bytes]."""


NOTHING = Mark(0, Counter(), 0)


def _wait_for_batch(queue: SimpleQueue[T]) -> list[T]:
    """Wait for an item; return it with all that follow in the queue, up to None, which ends it."""
    batch = [queue.get()]
    with suppress(Empty):
        while batch[-1] is not None:
            batch.append(queue.get_nowait())
    return batch


class Forcer:
    """Force the newest requested part to the disk."""

    def __init__(self) -> None:
        self.safe = NOTHING
        """Up to where everything is on the disk itself."""
        self._error: OSError | None = None
        self._lock = threading.Lock()
        # the newest request includes the earlier ones, as an ended part has been forced
        self._newest: tuple[Part, Mark] | None = None
        self._lost: Part | None = None
        self._wakes, self._ends = threading.Event(), False
        self._thread = threading.Thread(target=self._work, name="forcing", daemon=True)
        self._thread.start()

    def request(self, part: Part, mark: Mark) -> None:
        """Request forcing `part`, after which `mark` is safe. Raises OSError if an earlier one failed."""
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        with self._lock:
            self._newest = part, mark
        self._wakes.set()

    def confirm(self, mark: Mark, part: Part | None = None) -> None:
        """Note that `mark`, which includes `part`, is safe already."""
        with self._lock:
            if mark.number >= self.safe.number and (part is None or part is not self._lost):
                self.safe = mark

    def give_up(self, part: Part, mark: Mark) -> None:
        """Note that `part` is lost, and that without it `mark` is safe."""
        with self._lock:
            self._lost = part
        self.confirm(mark)

    def close(self) -> None:
        """End after all requests are done."""
        self._ends = True
        self._wakes.set()

    def _work(self) -> None:
        while not self._ends or self._newest is not None:
            self._wakes.wait()
            self._wakes.clear()
            with self._lock:
                newest, self._newest = self._newest, None
            if newest is None:
                continue
            part, mark = newest
            try:
                part.sync()
            except OSError as error:
                self._error = error
            else:
                self.confirm(mark, part)


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
        room: FreeSpace,
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
        self.notify(logging.INFO, f"recording into {path}")
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

    def queue_chunk(self, chunk: Chunk) -> None:
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
            batch = _wait_for_batch(self._queue)
            more = batch[-1] is not None
            chunks = [one for one in batch if isinstance(one, Chunk)]
            for chunk in chunks:
                self._write_chunk(chunk)
                self.written += 1
            self._force(chunks)
            for one in batch:
                if isinstance(one, threading.Event):
                    one.set()
        self._end()
        self._forcer.close()

    def _write_chunk(self, chunk: Chunk) -> None:
        """Write a chunk to its part: the current or the next one. Every part gets at least one."""
        try:
            if self._part is not None and self._part.is_gone:
                self._give_up(self._part)
            if self._part is None:
                if chunk.handed >= self._retry:
                    self._begin(self._room.resume if self.failure else None)
            elif self._begun is not None and (
                self._part.summary_size > MAX_INDEX_BYTES
                or self._rotation.is_due(self._part.whole_size + len(chunk.raw), chunk.handed - self._begun)
            ):
                self._end()
                self._begin()
            self._append(chunk)
        except Exception as error:  # noqa: BLE001 - one odd chunk must not end the recording
            if not isinstance(error, OSError):
                _log.exception("a chunk cannot be written")
                error = OSError(str(error))
            self.lost += chunk.total
            self._fail(error, chunk.handed)

    def _append(self, chunk: Chunk) -> None:
        if self._part is None:  # too early to try again
            self.lost += chunk.total
            return
        try:
            require_free_space(self._part.path.parent, self._room.stop)
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
                self.notify(logging.INFO, f"recording continues in {self._part.path}")

    def _begin(self, room: int | None = None) -> None:
        """Begin a part; after a failure `room` must be free for it [bytes]. Raises OSError."""
        previous = self.paths[-1].name if self.paths else ""
        about = {**self._about, "part": str(len(self.paths) + 1), "previous": previous}
        name = self._name + 1
        while True:
            try:
                part = Part(part_path(self._first, name), about, self._channels)
                break
            except FileExistsError:
                if not self.paths:  # the first part's name is fixed
                    raise
                name += 1
        try:
            require_free_space(part.path.parent, self._room.stop if room is None else room)
            if room is not None:
                part.reserve(self._room.stop)
        except OSError:
            part.discard()
            raise
        self._part, self._name, self._begun = part, name, None
        self.paths = (*self.paths, part.path)

    def _force(self, chunks: list[Chunk]) -> None:
        """Force what was written to the disk; only then it counts as recorded."""
        mark = self._mark(self._part)
        if self._part is None or not self._forces:
            self._forcer.confirm(mark)
            return
        try:
            self._forcer.request(self._part, mark)
        except OSError as error:  # unknown how much was written: new messages go to another part
            self._fail(error, chunks[-1].handed if chunks else 0.0)

    def _mark(self, part: Part | None) -> Mark:
        """Return the progress with `part` and those before it."""
        if part is None:
            return self._ended._replace(number=self.written)
        return Mark(self.written, self._ended.counts + part.counts, self._ended.size + part.size)

    def _end(self) -> None:
        if self._part is None:
            return
        part, self._part = self._part, None
        if part.is_gone:
            self._give_up(part)
            return
        mark = self._mark(part)
        try:
            part.sync()
        except OSError as error:
            self._unforced(part, mark, error)
            return
        try:
            part.finish()
        except OSError as error:
            if self.failure is None:
                self.notify(
                    logging.WARNING,
                    f"{part.path}: its index cannot be written: {error.strerror}; see formation recover",
                )
        self._ended = mark
        self._forcer.confirm(mark)

    def _unforced(self, part: Part, mark: Mark, error: OSError) -> None:
        """End a part that cannot be forced to the disk: what of it is not safe yet is lost."""
        with suppress(OSError):
            part.finish()
        self._ended = self._forcer.safe._replace(number=mark.number)
        lost = mark.counts.total() - self._ended.counts.total()
        self.lost += lost
        if self.failure is None:
            self.failure = error.strerror or str(error)
            self.notify(
                logging.ERROR, f"{part.path}: its last {lost} messages may not be on the disk: {self.failure}"
            )

    def _give_up(self, part: Part) -> None:
        """Give up a part with a deleted file: only its messages are lost."""
        self._part = None
        with suppress(OSError):
            part.finish()
        self.lost += part.counts.total()
        self._retry = 0.0
        self._forcer.give_up(part, self._mark(None))
        self.notify(logging.ERROR, f"{part.path} was deleted, with the {part.counts.total()} messages in it")

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
            self.notify(
                logging.ERROR, f"{self.paths[-1]}: nothing is recorded any more: {self.failure}; {again}"
            )

    def notify(self, level: int, text: str) -> None:
        """Log a message about the recording, and leave it as a notice."""
        _log.log(level, "%s", text)
        self.notices.append(Notice(level, text))
