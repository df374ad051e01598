"""The tables of a run's history: orders, leaders, robots' activities, events."""

from __future__ import annotations

import math

from formation.monitor.metrics.leading import described
from formation.monitor.report import words
from formation.monitor.report.doing import LOST_STATE, STATES
from formation.monitor.report.gather import Run
from formation.monitor.report.leader_terms import overlaps
from formation.monitor.report.tables import Table

ORDERS = "With another shape or route settling begins anew: the settling time counts from the newest."
LEADERS = (
    "By the terms of the orders and the publisher ids, as they arrived; whether two led at once is"
    " judged by the leaders' own stamps."
)
DOINGS = (
    "By their own words, as received by the monitor. Lost: silent for a second. Unavailable: it did"
    " not follow, and the robots that measure it continued without it. Avoiding: the collision filter"
    " turned or slowed it, or its protective zone slowed it. Blocked: that stopped it. Deadlocks: it was"
    " kept from moving, and went another way for a while."
)


def orders(run: Run) -> Table:
    """Return the leader's orders, with their times."""
    several = len({order.leads for order in run.orders}) > 1
    rows = [
        (
            words.seconds(order.at - run.start),
            order.mode,
            described(order.wish),
            *([order.leads or "unknown"] if several else []),
        )
        for order in run.orders
    ]
    heads = ("time", "mode", "shape", "leader") if several else ("time", "mode", "shape")
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


def doings(run: Run) -> Table:
    """Return followers' times by activity."""
    heads = (
        "robot", "ran", "held", "stopped", "waited", "lost", "unavailable", "avoiding",
        "blocked", "deadlocks", "with fallback neighbours", "started anew",
    )  # fmt: skip
    rows = []
    for name, one in run.doings.items():
        times = [one.seconds.get(state, 0.0) for state in (*STATES, LOST_STATE)]
        unavailable = words.lasting(one.unavailable) + (
            f", {one.times_unavailable} times" if one.times_unavailable > 1 else ""
        )
        rows.append(
            (
                name,
                *(words.lasting(time) if time else "" for time in times),
                unavailable if one.times_unavailable else "",
                words.lasting(one.avoiding) if one.avoiding else "",
                words.lasting(one.blocked) if one.blocked else "",
                words.whole(one.deadlocks) if one.deadlocks else "",
                words.lasting(one.fallback) if one.fallback else "",
                words.whole(one.starts) if one.starts else "",
            )
        )
    filled = [n for n in range(len(heads)) if any(row[n] for row in rows)]
    return Table(
        "What robots did",
        tuple(heads[n] for n in filled),
        [tuple(row[n] for n in filled) for row in rows],
        DOINGS,
    )


def events(run: Run) -> Table:
    """Return the monitor's list of events."""
    levels = {20: "", 30: "warning", 40: "error"}
    rows = [
        (
            words.seconds(event.at - run.start),
            event.robot or "formation",
            event.kind,
            levels.get(event.level, ""),
            event.text,
        )
        for event in run.events
    ]
    return Table("Events", ("time", "robot", "what", "level", "in words"), rows, words=True)
