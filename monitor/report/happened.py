"""The tables of what happened in a run: orders, leaders, what robots did, events."""

from __future__ import annotations

import math

from monitor.figures.leading import described
from monitor.report import words
from monitor.report.doing import LOST_STATE, STATES
from monitor.report.gather import Run
from monitor.report.reigns import overlaps
from monitor.report.tables import Table

ORDERS = "With another figure or course settling begins anew: the settling time counts from the newest."
LEADERS = (
    "By the terms of the orders and the voices that gave them, as they arrived; whether two led at once is"
    " judged by the leaders' own stamps."
)
DOINGS = (
    "By their own words, as the monitor heard them. Lost: not heard for a second. Aside: it said that it did"
    " not follow, and who measures it went on without it. Out of the way: the collision filter turned or"
    " slowed it, or its protective zone slowed it. Blocked: that stopped it. Deadlocks: it was kept from"
    " moving, and went another way for a while."
)


def orders(run: Run) -> Table:
    """What the leader wanted, and since when."""
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
    heads = ("time", "mode", "figure", "who led") if several else ("time", "mode", "figure")
    return Table("The leader's orders", heads, rows, ORDERS, words=True)


def reigns(run: Run) -> Table:
    """Who led; empty where nobody could have taken the leader's place, and nobody has."""
    rows = []
    both = {id(one) for pair in overlaps(run.reigns) for one in pair[:2]}
    for number, one in enumerate(run.reigns):
        before = run.reigns[number - 1].heard.end if number else math.nan
        rows.append(
            (
                one.name or "unknown",
                words.seconds(one.heard.begin - run.start),
                words.seconds(one.heard.end - run.start),
                words.lasting(one.heard.begin - before),
                words.whole(one.positions),
                words.whole(one.ballots),
                "no: two led at once" if id(one) in both else "yes",
            )
        )
    heads = ("who led", "from", "to", "nobody before for", "positions", "ballots", "alone")
    return Table("Leaders", heads, rows if run.mission.standbys or len(rows) > 1 else [], LEADERS)


def doings(run: Run) -> Table:
    """What followers did with their time."""
    heads = (
        "robot", "ran", "held", "stopped", "waited", "lost", "aside", "out of the way",
        "blocked", "deadlocks", "with fallback neighbours", "started anew",
    )  # fmt: skip
    rows = []
    for name, one in run.doings.items():
        times = [one.seconds.get(state, 0.0) for state in (*STATES, LOST_STATE)]
        aside = words.lasting(one.aside) + (f", {one.asides} times" if one.asides > 1 else "")
        rows.append(
            (
                name,
                *(words.lasting(time) if time else "" for time in times),
                aside if one.asides else "",
                words.lasting(one.evading) if one.evading else "",
                words.lasting(one.blocked) if one.blocked else "",
                words.whole(one.deadlocks) if one.deadlocks else "",
                words.lasting(one.fallback) if one.fallback else "",
                words.whole(one.starts) if one.starts else "",
            )
        )
    told = [n for n in range(len(heads)) if any(row[n] for row in rows)]
    return Table(
        "What robots did",
        tuple(heads[n] for n in told),
        [tuple(row[n] for n in told) for row in rows],
        DOINGS,
    )


def events(run: Run) -> Table:
    """The monitor's list."""
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
    return Table("Events", ("time", "who", "what", "level", "in words"), rows, words=True)
