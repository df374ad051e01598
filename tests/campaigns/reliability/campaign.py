"""Many tries on a few fleets side by side: each takes the next try as soon as it is done with one."""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, Protocol

from tests.campaigns.document import Found
from tests.campaigns.figures import markdown
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.judge import middle
from tests.campaigns.reliability.trial import Lost, Row, Try, attempt

LEAST = ("nearest",)
"""Figures of which the smallest is the worst."""
METRES = " [m]"
"""Ends the name of a figure that is a distance, not a time."""
HEADER = (
    "what was done", "as it should be", "in time", "error back after", "largest command", "largest jump",
    "error then",
)  # fmt: skip


def summary(title: str, tries: Sequence[Try]) -> dict[str, Any]:
    names = sorted({name for one in tries for name in one.figures})
    figures = {name: [one.figures[name] for one in tries if name in one.figures] for name in names}
    return {
        "title": title,
        "tries": len(tries),
        "well": sum(not one.wrong for one in tries),
        "wrong": dict(Counter(word for one in tries for word in one.wrong)),
        "figures": {name: _middle(name, values) for name, values in figures.items()},
        "settles": middle([one.settles for one in tries if one.settles is not None]),
        "peak": max((one.peak for one in tries), default=0.0),
        "jump": max((one.jump for one in tries), default=0.0),
        "zeros": sum(one.zeros for one in tries),
        "error": max((one.error for one in tries if one.error is not None), default=None),
    }


def table(rows: Iterable[Mapping[str, Any]]) -> str:
    return markdown(HEADER, [_row(row) for row in rows])


def failures(rows: Iterable[Mapping[str, Any]]) -> str:
    lines = [
        f"- {row['title']}: {what} ({times} of {row['tries']})"
        for row in rows
        for what, times in row["wrong"].items()
    ]
    return "\n".join(["Not as it should be:", "", *lines, ""]) if lines else ""


def span(figure: Mapping[str, float] | None, unit: str, digits: int = 2, scale: float = 1.0) -> str:
    """Median, and in brackets the worst."""
    if figure is None:
        return ""
    return f"{figure['median'] * scale:.{digits}f} ({figure['worst'] * scale:.{digits}f}) {unit}"


def _row(row: Mapping[str, Any]) -> tuple[str, ...]:
    figures = "; ".join(f"{_plain(name)} {span(one, _unit(name))}" for name, one in row["figures"].items())
    return (
        row["title"],
        f"{row['well']} of {row['tries']}",
        figures or "–",
        span(row["settles"], "s", 1) or ("–" if row["error"] is None else "never"),
        f"{100 * row['peak']:.0f} %",
        f"{100 * row['jump']:.0f} %",
        "–" if row["error"] is None else f"{1000 * row['error']:.1f} mm",
    )


def _unit(name: str) -> str:
    return "m" if name in LEAST or name.endswith(METRES) else "s"


def _plain(name: str) -> str:
    return name.removesuffix(METRES)


def _middle(name: str, values: Sequence[float]) -> Mapping[str, float] | None:
    if name not in LEAST:
        return middle(values)
    turned = middle([-value for value in values])
    return None if turned is None else {key: -value for key, value in turned.items()}


Maker = Callable[[Path], Fleet]
"""Makes a fleet whose files are in a folder."""


class Progress(Protocol):
    """Who is told how it goes."""

    def __call__(self, words: str) -> None:
        """One line."""


def tell(words: str) -> None:
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


class Options(NamedTuple):
    """What was asked for on the command line."""

    tries: int = 20
    fields: int = 2
    """Fleets side by side."""
    only: tuple[str, ...] = ()
    """Rows whose names begin like this; all if there is none."""
    keep: Path | None = None
    """Where what was said in tries that failed is kept."""
    minutes: float = 30.0
    """Of the soak."""

    def chosen(self, name: str) -> bool:
        return not self.only or any(name.startswith(one) for one in self.only)


class Part(Protocol):
    """A module of this folder."""

    TITLE: str
    ABOUT: str
    """What was done, in sentences."""

    def run(self, options: Options) -> Found:
        """Do it; what was found, with ``well`` for whether all was as it should be."""

    def section(self, found: Found) -> str:
        """Tables for people."""

    def seconds(self, options: Options) -> float:
        """It takes about so long [s]."""

    def names(self) -> Sequence[str]:
        """Its rows."""


def campaign(options: Options, maker: Maker, rows: Sequence[Row]) -> tuple[Found, list[Try]]:
    chosen = [row for row in rows if options.chosen(row.name)]
    if not chosen:
        return {"rows": {}, "well": True}, []
    tries = Campaign(maker, chosen, options.tries, options.keep).run(options.fields)
    found = {row.name: summary(row.title, [one for one in tries if one.row == row.name]) for row in chosen}
    return {"rows": found, "well": all(not one.wrong for one in tries)}, tries
