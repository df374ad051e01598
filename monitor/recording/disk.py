"""The thread that writes a recording, so that a slow or full disk is never waited for by who watches.

It is given chunks and nothing else; another thread forces to the disk what this one has written. What the
disk refuses is said, and tried again later.
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

from monitor.recording.channels import Channels
from monitor.recording.chunk import Chunk
from monitor.recording.forcing import NOTHING, Forcer, Mark
from monitor.recording.part import Part
from monitor.recording.rotation import Room, Rotation, need_room, part_path

RETRY = 10.0
"""How long after a failure it is tried again [s]."""
_log = logging.getLogger(__name__)


class Notice(NamedTuple):
    """Something to be told about the recording."""

    level: int
    """As in `logging`."""
    text: str


class Disk:
    """Writes one recording, part after part. Everything public is for the thread that watches."""

    def __init__(
        self,
        path: Path,
        about: Mapping[str, str],
        channels: Channels,
        rotation: Rotation,
        room: Room,
    ) -> None:
        """Begin the first part at once. Raises OSError."""
        self.failure: str | None = None
        """Why nothing is recorded just now."""
        self.paths: tuple[Path, ...] = ()
        """Every part so far."""
        self.lost = 0
        """Messages that are not and will not be."""
        self.written = 0
        """Chunks dealt with, in one way or the other."""
        self.notices: deque[Notice] = deque(maxlen=100)
        self._first, self._about, self._channels = path, about, channels
        self._rotation, self._room = rotation, room
        self._queue: SimpleQueue[Chunk | None] = SimpleQueue()
        self._forcer = Forcer()
        self._ended = NOTHING  # the parts before this one
        self._retry = 0.0
        self._begun: float | None = None  # when this part was given its first chunk [s, monotonic]
        self._name = 0  # the number that the newest part's name bears
        self._part: Part | None = None
        self._begin()
        self._tell(logging.INFO, f"recording into {path}")
        self._thread = threading.Thread(target=self._work, name="recording", daemon=True)
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether somebody takes what is put."""
        return self._thread.is_alive()

    @property
    def safe(self) -> Mark:
        """So far it is on the disk itself, and survives a power cut."""
        return self._forcer.safe

    def put(self, chunk: Chunk) -> None:
        """Have a chunk written."""
        self._queue.put(chunk)

    def close(self, patience: float) -> bool:
        """Write what is left and end the file; False if that takes longer than `patience` [s]."""
        self._queue.put(None)
        self._thread.join(patience)
        return not self._thread.is_alive()

    def _work(self) -> None:
        more = True
        while more:
            batch = self._next()
            more = batch[-1] is not None
            chunks = [one for one in batch if one is not None]
            for chunk in chunks:
                self._keep(chunk)
                self.written += 1
            self._force(chunks)
        self._end()
        self._forcer.close()

    def _next(self) -> list[Chunk | None]:
        """Everything that waits, at least one."""
        batch = [self._queue.get()]
        with suppress(Empty):
            while batch[-1] is not None:
                batch.append(self._queue.get_nowait())
        return batch

    def _keep(self, chunk: Chunk) -> None:
        """Write a chunk to where it belongs: this part, or the next one."""
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
        """Whether a chunk belongs to the next part already; every part has one."""
        if self._begun is None:
            return False
        return self._rotation.is_due(part.whole_size + len(chunk.raw), chunk.handed - self._begun)

    def _append(self, chunk: Chunk) -> None:
        if self._part is None:  # it is not time yet to try again
            self.lost += chunk.total
            return
        try:
            need_room(self._part.path.parent, self._room.stop)
            self._part.append(chunk)
        except OSError as error:
            if error.errno != errno.EFBIG or not self._part.counts:
                raise
            self._end()  # some file systems have files of 2 or 4 GB at most
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
        """The next part, under the next name that is free; the first one has no choice."""
        for name in count(self._name + 1):
            try:
                return Part(part_path(self._first, name), about, self._channels), name
            except FileExistsError:
                if not self.paths:
                    raise
        raise AssertionError

    def _resume(self, now: float) -> None:
        """Where there is no part, when it is time: go on in a new one."""
        if now >= self._retry:
            self._begin(self._room.resume if self.failure else None)

    def _force(self, chunks: list[Chunk]) -> None:
        """Have the disk itself hold what was written; only then is it called recorded."""
        if self._part is None:
            self._forcer.confirm(self._ended._replace(number=self.written))
            return
        counts, size = self._ended.counts + self._part.counts, self._ended.size + self._part.size
        try:
            self._forcer.ask(self._part, Mark(self.written, counts, size))
        except OSError as error:  # nobody knows what of it is there: what comes goes elsewhere
            self._fail(error, chunks[-1].handed if chunks else 0.0)

    def _end(self) -> None:
        """End this part, whole if that can be done."""
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
        """Somebody deleted the file: what it held is lost, the rest need not be."""
        self._part = None
        with suppress(OSError):
            part.finish()
        self.lost += part.counts.total()
        self._retry = 0.0
        self._forcer.confirm(self._ended._replace(number=self.written))
        self._tell(logging.ERROR, f"{part.path} was deleted, with the {part.counts.total()} messages in it")

    def _fail(self, error: OSError, now: float) -> None:
        """Leave behind what is whole, and say once that there will be no more for a while."""
        fresh = self.failure is None
        self.failure, self._retry = error.strerror or str(error), now + RETRY
        if self._part is not None and self._begun is None and len(self.paths) > 1:
            with suppress(OSError):
                self._part.discard()
            self._part, self._name, self.paths = None, self._name - 1, self.paths[:-1]
        self._end()
        if fresh:
            again = f"it is tried again every {RETRY:g} s"
            self._tell(
                logging.ERROR, f"{self.paths[-1]}: nothing is recorded any more: {self.failure}; {again}"
            )

    def _tell(self, level: int, text: str) -> None:
        _log.log(level, "%s", text)
        self.notices.append(Notice(level, text))
