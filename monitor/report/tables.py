"""The tables of a run's page: robots, topics, answers, keys, and what happened."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from typing import NamedTuple

from formation.monitor.metrics.events import ordered_in_words
from formation.monitor.metrics.words import CORRECTION_SHOWN
from formation.monitor.report import words
from formation.monitor.report.gather import Run
from formation.monitor.report.leader_terms import overlaps
from formation.monitor.report.story import LOST_STATE, STATES
from formation.monitor.report.thin import Measured
from formation.monitor.report.traffic import Delays, Key

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
    ("heading error", "estimated less true heading; known only of simulated robots."),
)
"""Explanations of the words in the tables."""
CLOCKS = (
    "Arrival, on the recorder's clock, less stamp, on the sender's: on one machine that is the delay; between"
    " machines it contains the difference of their clocks, and may even be negative."
)
ANSWERS = (
    "From the stamp of a position (odometry, or external pose) to the arrival of the command computed from"
    " it, as recorded: transmission to the agent, computation, and transmission to the recorder. Clocks"
    " as above."
)
ORDERS = "With another shape or route settling begins again: the settling time counts from the newest."
LEADERS = (
    "By the terms of the orders and the publisher ids, as they arrived; whether two led at once is"
    " judged by the leaders' own stamps."
)
ACTIVITIES = (
    "By their statuses, as received by the monitor. Lost: silent for a second. Unavailable: it did"
    " not follow, and the robots that measure it continued without it. Avoiding: the collision filter"
    " turned or slowed it, or its protective zone slowed it. Blocked: that zone stopped it. Deadlocks: it"
    " could not move, and took another way for a while. Without sight: it had to see its neighbours,"
    " and did not. Odometry off by: the largest correction by its scans."
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
        "ω at its limit", *(("RMS heading error", "greatest, settled") if run.truth else ()),
    )  # fmt: skip
    rows = []
    for name, robot in run.robots.items():
        heading = words.degrees(robot.heading.whole.rms), words.degrees(robot.heading.after.maximum)
        shares = map(words.share, robot.saturated)
        rows.append((name, *_measured(robot.error), *shares, *(heading if run.truth else ())))
    blank = ("",) * (len(heads) - 6)
    final, true = run.snapshot.final_error, run.true_error.final
    # a robot lost before the end leaves it unknown
    rows.append(("formation", *_measured(run.error)[:-1], words.length(final), *blank))
    if run.true_error.whole.count:
        last = words.length(None if final is None else true)
        rows.append(("formation, in truth", *_measured(run.true_error)[:-1], last, *blank))
    return Table("Errors and saturation", heads, rows)


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
        delays = run.delays.get(topic, Delays(0, None, None, None))
        rows.append(
            (
                topic,
                words.whole(sum(key.count for key in received)),
                _span([key.rate for key in received]),
                _span([key.promised for key in keys]),
                _missed(received),
                _longest(received),
                words.whole(sum(key.rejected for key in keys)),
                *_delays(delays),
            )
        )
    return Table("By topic", heads, rows, CLOCKS)


def answers(run: Run) -> Table:
    """Return the times from each robot's odometry to its command."""
    heads = ("robot", "commands answered", "p50", "p99", "greatest")
    rows = [(name, words.whole(delays.count), *_delays(delays)) for name, delays in run.answers.items()]
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


def _measured(one: Measured) -> list[str]:
    values = one.whole.rms, one.whole.maximum, one.after.rms, one.after.maximum, one.final
    return [words.length(value) for value in values]


def _delays(delays: Delays) -> list[str]:
    return [words.milliseconds(value) for value in (delays.median, delays.p99, delays.maximum)]


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
    key = max(received, key=lambda one: (one.gap or 0.0) if one.promised else -1.0)
    silence = _silence(key)
    return f"{silence}, {key.robot}" if key.robot and silence != words.UNKNOWN else silence


def _silence(key: Key) -> str:
    if key.gap is None or not key.promised:
        return words.UNKNOWN
    return f"{words.milliseconds(key.gap)} at {words.seconds(key.gap_at)}"


def orders(run: Run) -> Table:
    """Return the leader's orders, with their times."""
    several = len({order.leads for order in run.story.orders}) > 1
    heads = ("time", "mode", "shape", "leader") if several else ("time", "mode", "shape")
    rows = [
        (words.seconds(one.at - run.start), one.mode, ordered_in_words(one.motion), one.leads or "unknown")[
            : len(heads)
        ]
        for one in run.story.orders
    ]
    return Table("The leader's orders", heads, rows, ORDERS, words=True)


def leader_terms(run: Run) -> Table:
    """Return the leader terms; empty if the leader had no standbys and was never replaced."""
    rows = []
    both = {id(one) for pair in overlaps(run.leader_terms) for one in pair[:2]}
    for number, one in enumerate(run.leader_terms):
        before = run.leader_terms[number - 1].received.end if number else math.nan
        rows.append(
            (
                one.name or "unknown",
                words.seconds(one.received.begin - run.start),
                words.seconds(one.received.end - run.start),
                words.lasting(one.received.begin - before),
                words.whole(one.positions),
                words.whole(one.ballots),
                "no: two led at once" if id(one) in both else "yes",
            )
        )
    heads = ("leader", "from", "to", "no leader before, for", "positions", "ballots", "alone")
    return Table("Leaders", heads, rows if run.mission.standbys or len(rows) > 1 else [], LEADERS)


def activities(run: Run) -> Table:
    """Return followers' times by activity."""
    heads = (
        "robot", "ran", "held", "stopped", "waited", "lost", "unavailable", "avoiding",
        "blocked", "deadlocks", "with fallback neighbours", "without sight", "odometry off by",
        "restarted",
    )  # fmt: skip
    rows = []
    for name, one in run.activities.items():
        times = [one.seconds.get(state, 0.0) for state in (*STATES, LOST_STATE)]
        times += [one.avoiding, one.blocked, one.fallback, one.unseeing]
        *lasting, avoiding, blocked, fallback, blind = (words.lasting(time) if time else "" for time in times)
        drift = f"{one.correction:.2f} m" if one.correction > CORRECTION_SHOWN else ""
        unavailable = words.lasting(one.unavailable) if one.times_unavailable else ""
        if one.times_unavailable > 1:
            unavailable += f", {one.times_unavailable} times"
        deadlocks, starts = (words.whole(n) if n else "" for n in (one.deadlocks, one.starts))
        seen = blind, drift
        rows.append((name, *lasting, unavailable, avoiding, blocked, deadlocks, fallback, *seen, starts))
    filled = [n for n in range(len(heads)) if any(row[n] for row in rows)]
    shown = [tuple(row[n] for n in filled) for row in (heads, *rows)]
    return Table("What robots did", shown[0], shown[1:], ACTIVITIES)


def events(run: Run) -> Table:
    """Return the monitor's list of events."""
    levels = {20: "", 30: "warning", 40: "error"}
    rows = [
        (words.seconds(at - run.start), robot or "formation", kind, levels.get(level, ""), text)
        for at, level, robot, kind, text in run.story.events
    ]
    return Table("Events", ("time", "robot", "what", "level", "in words"), rows, words=True)
