"""Many tries on a few fleets side by side: each takes the next try as soon as it is done with one."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory
from typing import Protocol

from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.rows import Row
from tests.campaigns.reliability.trial import Lost, Try, attempt

Maker = Callable[[Path], Fleet]
"""Makes a fleet whose files are in a folder."""


class Progress(Protocol):
    """Who is told how it goes."""

    def __call__(self, words: str) -> None:
        """One line."""


def tell(words: str) -> None:
    """A line for people."""
    print(f"{time.strftime('%H:%M:%S')} {words}", file=sys.stderr, flush=True)


class Campaign:
    """All tries of all rows."""

    def __init__(self, maker: Maker, rows: Sequence[Row], tries: int, keep: Path | None = None) -> None:
        """With `keep`, what the processes said in tries that failed is kept in that folder."""
        self._maker, self._keep = maker, keep
        self._todo: SimpleQueue[Row] = SimpleQueue()
        for _ in range(tries):  # each row once, then each row again: a machine's bad minute hits all alike
            for row in rows:
                self._todo.put(row)
        self._all = tries * len(rows)
        self._done: list[Try] = []
        self._lock, self._over = threading.Lock(), threading.Event()
        self._failure: BaseException | None = None
        self._began = time.monotonic()

    def run(self, fields: int, progress: Progress = tell) -> list[Try]:
        """Do them all on so many fleets; what came of them."""
        self._began = time.monotonic()
        threads = [
            threading.Thread(target=self._work, args=(number, progress), daemon=True)
            for number in range(min(fields, self._all))
        ]
        for thread in threads:
            thread.start()
        try:
            while any(thread.is_alive() for thread in threads):
                time.sleep(0.2)
        finally:
            self._over.set()
            for thread in threads:
                thread.join()
        if self._failure is not None:
            raise self._failure
        return self._done

    def _work(self, number: int, progress: Progress) -> None:
        try:
            while not self._over.is_set() and not self._todo.empty():
                with TemporaryDirectory(prefix="reliability-") as folder, self._maker(Path(folder)) as fleet:
                    try:
                        fleet.begin()
                    except AssertionError:
                        self._save(fleet, "begin")
                        raise
                    self._use(fleet, number, progress)
        except BaseException as failure:  # noqa: BLE001 - it is raised where the threads are waited for
            self._failure = failure
            self._over.set()

    def _use(self, fleet: Fleet, number: int, progress: Progress) -> None:
        """Try on this fleet until nothing is left to do, or it is of no more use."""
        lost = False
        while not self._over.is_set() and not lost:
            try:
                row = self._todo.get_nowait()
            except Empty:
                return
            try:
                one = attempt(fleet, row)
            except AssertionError as failure:  # something that was waited for did not come
                one, lost = Try(row.name, [str(failure).splitlines()[0]]), True
            except Lost as loss:
                progress(f"fleet {number} is made anew: {loss}")
                self._todo.put(row)
                self._save(fleet, f"lost-{row.name}")
                return
            with self._lock:
                self._done.append(one)
                done = len(self._done)
            progress(f"{done}/{self._all} {_words(one)}{self._left(done)}")
            if one.wrong:
                self._save(fleet, f"{done}-{row.name}")
            lost = lost or one.settles is None or bool(fleet.lost())

    def _left(self, done: int) -> str:
        left = (time.monotonic() - self._began) / done * (self._all - done)
        return f", {left / 60.0:.0f} min left" if left > 60.0 else ""

    def _save(self, fleet: Fleet, name: str) -> None:
        if self._keep is not None:
            fleet.save(self._keep / name)


def _words(one: Try) -> str:
    figures = "".join(f", {name} {value:.2f} s" for name, value in one.figures.items())
    settles = "" if one.settles is None else f", settles {one.settles:.1f} s"
    wrong = f" — {'; '.join(one.wrong)}" if one.wrong else ""
    motion = f"peak {100 * one.peak:.0f} %, jump {100 * one.jump:.0f} %"
    return f"{one.row}: {motion}{figures}{settles}{wrong}"
