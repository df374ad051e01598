"""Many tries on a few fleets side by side: each takes the next try as soon as it is done with one."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from tests.campaigns import parts
from tests.campaigns.document import Found
from tests.campaigns.figures import progress
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.judge import middle
from tests.campaigns.reliability.trial import Lost, Row, Try, attempt

LEAST = ("nearest",)  # figures of which the smallest is the worst
METRES = " [m]"  # ends the name of a figure that is a distance, not a time
HEADER = (
    "what was done | as it should be | in time | error back after | largest command | largest jump | "
    "error then"
)


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


def _middle(name: str, values: Sequence[float]) -> Mapping[str, float] | None:
    sign = -1.0 if name in LEAST else 1.0
    turned = middle([sign * value for value in values])
    return None if turned is None else {key: sign * value for key, value in turned.items()}


def summaries(titles: Mapping[str, str], tries: Sequence[Try]) -> Found:
    """What came of all rows, whose `titles` are by their names."""
    rows = {name: summary(title, [one for one in tries if one.row == name]) for name, title in titles.items()}
    return {"rows": rows, "well": all(not one.wrong for one in tries)}


def section(found: Found) -> str:
    """What came of all rows, for people."""
    every = found["rows"].values()
    return f"{table(every)}\n{failures(every)}"


def table(rows: Iterable[Mapping[str, Any]]) -> str:
    return parts.table(HEADER, map(_row, rows))


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


def _row(row: Mapping[str, Any]) -> str:
    figures = "; ".join(
        f"{name.removesuffix(METRES)} {span(one, 'm' if name in LEAST or name.endswith(METRES) else 's')}"
        for name, one in row["figures"].items()
    )
    settles = span(row["settles"], "s", 1) or ("–" if row["error"] is None else "never")
    error = "–" if row["error"] is None else f"{1000 * row['error']:.1f} mm"
    return (
        f"{row['title']} | {row['well']} of {row['tries']} | {figures or '–'} | {settles} | "
        f"{100 * row['peak']:.0f} % | {100 * row['jump']:.0f} % | {error}"
    )


Maker = Callable[[Path], Fleet]  # makes a fleet whose files are in a folder


def tell(words: str) -> None:
    progress(f"{time.strftime('%H:%M:%S')} {words}")


class Options(NamedTuple):
    """What was asked for on the command line."""

    tries: int = 20
    fields: int = 2  # fleets side by side
    only: tuple[str, ...] = ()  # rows whose names begin like this; all if there is none
    keep: Path | None = None  # where what was said in tries that failed is kept
    minutes: float = 30.0  # of the soak

    def chosen(self, name: str) -> bool:
        return not self.only or name.startswith(self.only)


def campaign(options: Options, maker: Maker, rows: Sequence[Row]) -> tuple[Found, list[Try]]:
    """Try each row once, then each row again: a machine's bad minute hits all alike."""
    chosen = [row for row in rows if options.chosen(row.name)]
    tries = Campaign(maker, chosen * options.tries, options.keep).run(options.fields)
    return summaries({row.name: row.title for row in chosen}, tries), tries


class Campaign:
    """Tries of `rows`, in their order."""

    def __init__(self, maker: Maker, rows: Sequence[Row], keep: Path | None) -> None:
        """With `keep`, what the processes said in tries that failed is kept in that folder."""
        self._maker, self._keep = maker, keep
        self._todo, self._all = deque(rows), len(rows)
        self._done: list[Try] = []
        self._lock, self._over = threading.Lock(), threading.Event()
        self._began = time.monotonic()

    def run(self, fields: int) -> list[Try]:
        """Do them all on so many fleets; what came of them."""
        with ThreadPoolExecutor(fields) as pool:
            workers = [pool.submit(self._work, number) for number in range(min(fields, self._all))]
            try:
                for worker in as_completed(workers):
                    worker.result()
            finally:
                self._over.set()
        return self._done

    def _work(self, number: int) -> None:
        while self._todo and not self._over.is_set():
            with TemporaryDirectory(prefix="reliability-") as folder, self._maker(Path(folder)) as fleet:
                try:
                    fleet.begin()
                except AssertionError:
                    self._save(fleet, "begin")
                    raise
                self._use(fleet, number)

    def _use(self, fleet: Fleet, number: int) -> None:
        """Try on this fleet until nothing is left to do, or it is of no more use."""
        lost = False
        while not self._over.is_set() and not lost:
            try:
                row = self._todo.popleft()
            except IndexError:
                return
            try:
                one = attempt(fleet, row)
            except AssertionError as failure:  # something that was waited for did not come
                one, lost = Try(row.name, [str(failure).splitlines()[0]]), True
            except Lost as loss:
                tell(f"fleet {number} is made anew: {loss}")
                self._todo.append(row)
                self._save(fleet, f"lost-{row.name}")
                return
            with self._lock:
                self._done.append(one)
                done = len(self._done)
            tell(f"{done}/{self._all} {_words(one)}{self._left(done)}")
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
