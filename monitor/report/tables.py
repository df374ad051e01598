"""The tables of a run's page: robots, topics, answers, keys."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from formation.monitor.report import words
from formation.monitor.report.gather import Run
from formation.monitor.report.judging import Measured
from formation.monitor.report.latency import Late
from formation.monitor.report.traffic import Key

TERMS = (
    (
        "error of a robot",
        "e_i = Σ_j |z_ij − z*_ij| over its neighbours j; the formation error is the sum over all robots.",
    ),
    ("RMS", "√(mean of e²) over the moments at which the error was published (10 Hz) and known."),
    ("greatest", "the greatest |e| over the same moments."),
    ("settled", "since the settling time: since then the formation error has stayed under the bound."),
    ("final", "the newest that was known; of the formation, only if it was known at the end."),
    (
        "settling time",
        "counts from the first moment with a known error, or the newest order of another shape or route.",
    ),
    ("at its limit", "share of commands with u, or ω, at 99.5 % of the robot's limit or more."),
    ("heading error", "estimated less true heading; the truth only simulated robots tell."),
)
"""Explanations of the words in the tables."""
CLOCKS = (
    "Arrival, on the recorder's clock, less stamp, on the sender's: on one machine that is the delay; between"
    " machines it contains the difference of their clocks, and may even be negative."
)
ANSWERS = (
    "From the stamp of a position (odometry, or external pose) to the arrival of the command that answers"
    " it, as recorded: the way to the agent, its thinking, and the way to the recorder. Clocks"
    " as above."
)


class Table(NamedTuple):
    """Rows of text; the first cell of each is its name."""

    title: str
    heads: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    note: str = ""
    words: bool = False
    """Whether cells are words rather than numbers."""


def robots(run: Run) -> Table:
    """Return errors and saturation of every follower."""
    heads = (
        "robot", "RMS error", "greatest", "RMS, settled", "greatest, settled", "final", "u at its limit",
        "ω at its limit",
    )  # fmt: skip
    rows = []
    for name, robot in run.robots.items():
        cells = [
            name,
            *_measured(robot.error),
            *map(words.share, robot.saturated),
        ]
        rows.append((*cells, *_heading(robot.heading)) if run.truth else tuple(cells))
    everybody = ["formation", *_measured(run.error)][:-1]  # a robot lost before the end leaves it unknown
    everybody += [words.length(run.snapshot.final_error), "", ""]
    rows.append((*everybody, "", "") if run.truth else tuple(everybody))
    if run.true_error.whole.count:
        true = None if run.snapshot.final_error is None else run.true_error.final
        measured = [*_measured(run.true_error)][:-1]
        rows.append(("formation, in truth", *measured, words.length(true), "", "", "", ""))
    return Table(
        "Errors and saturation",
        (*heads, "RMS heading error", "greatest, settled") if run.truth else heads,
        rows,
    )


def topics(run: Run) -> Table:
    """Return the reception of each topic, over all robots."""
    heads = (
        "topic", "messages", "rate of a key", "promised", "missed", "longest silence", "rejected",
        "delay p50", "p99", "greatest",
    )  # fmt: skip
    by_topic: dict[str, list[Key]] = {}
    for key in run.keys:
        by_topic.setdefault(key.topic, []).append(key)
    rows = []
    for topic, keys in by_topic.items():
        received = [key for key in keys if key.count]
        if not received:
            continue
        late = run.late.get(topic, Late(0, None, None, None))
        rows.append(
            (
                topic,
                words.whole(sum(key.count for key in received)),
                _span([key.rate for key in received]),
                _span([key.promised for key in keys]),
                _missed(received),
                _longest(received),
                words.whole(sum(key.rejected for key in keys)),
                *_late(late),
            )
        )
    return Table("By topic", heads, rows, CLOCKS)


def answers(run: Run) -> Table:
    """Return the times from each robot's odometry to its command."""
    heads = ("robot", "commands answered", "p50", "p99", "greatest")
    rows = [(name, words.whole(late.count), *_late(late)) for name, late in run.answers.items()]
    return Table("From odometry to command", heads, rows, ANSWERS)


def keys(run: Run) -> Table:
    """Return all keys."""
    heads = ("key", "messages", "rate", "promised", "missed", "longest silence", "rejected", "clock offset")
    rows = [
        (
            key.key,
            words.whole(key.count),
            words.rate(key.rate),
            words.rate(key.promised),
            words.whole(key.missed) if key.count else words.UNKNOWN,
            _silence(key),
            words.whole(key.rejected),
            words.milliseconds(key.clock),
        )
        for key in run.keys
    ]
    note = (
        "Missed: periods without a message in gaps of up to a second, lost on the way or skipped by the"
        " sender. Clock offset: median of arrival less stamp of the newest messages."
    )
    return Table("Every key of the mission", heads, rows, note)


def rejected(run: Run) -> Table:
    """Return the rejected messages."""
    rows = [(what, words.whole(count)) for what, count in run.snapshot.rejected.items()]
    return Table("Rejected messages", ("key: reason", "messages"), rows)


def _measured(one: Measured) -> Iterator[str]:
    yield words.length(one.whole.rms)
    yield words.length(one.whole.maximum)
    yield words.length(one.after.rms if one.after else None)
    yield words.length(one.after.maximum if one.after else None)
    yield words.length(one.final)


def _heading(one: Measured) -> Iterator[str]:
    yield words.degrees(one.whole.rms)
    yield words.degrees(one.after.maximum if one.after else None)


def _late(late: Late) -> Iterator[str]:
    yield words.milliseconds(late.median)
    yield words.milliseconds(late.p99)
    yield words.milliseconds(late.maximum)


def _span(rates: Sequence[float | None]) -> str:
    """Return one rate, or the slowest, median and fastest if they differ."""
    known = sorted(rate for rate in rates if rate is not None)
    if not known:
        return words.UNKNOWN
    texts = [f"{value:.1f}" for value in (known[0], statistics.median(known), known[-1])]
    return f"{texts[1]} Hz" if texts[0] == texts[2] else f"{texts[0]} to {texts[2]} Hz"


def _missed(received: Sequence[Key]) -> str:
    if not any(key.promised for key in received):
        return words.UNKNOWN
    missed, count = sum(key.missed for key in received), sum(key.count for key in received)
    return "none" if not missed else f"{words.whole(missed)} ({words.share(missed / (missed + count))})"


def _longest(received: Sequence[Key]) -> str:
    gaps = [(key.gap, key) for key in received if key.gap is not None and key.promised]
    if not gaps:
        return words.UNKNOWN
    gap, key = max(gaps, key=lambda both: both[0])
    where = f", {key.robot}" if key.robot else ""
    return f"{words.milliseconds(gap)} at {words.seconds(key.gap_at)}{where}"


def _silence(key: Key) -> str:
    if key.gap is None or not key.promised:
        return words.UNKNOWN
    return f"{words.milliseconds(key.gap)} at {words.seconds(key.gap_at)}"
