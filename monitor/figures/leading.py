"""What is told of who leads and of what the team is told: snapshots in, events out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from formation.mission import Mission
from formation.wire import Now
from monitor.figures.asked import Asked
from monitor.figures.candidates import LEADS
from monitor.figures.event import INFO, WARNING, Event, more
from monitor.figures.orders import Lead, Wish
from monitor.figures.snapshot import CandidateFigures, Snapshot
from monitor.figures.statuses import SILENT
from monitor.figures.turns import Turns

STANDBY = "standby"
"""What a process says of itself that may lead and does not."""


def described(wish: Wish) -> str:
    """What is asked of the formation, as people say it: what is as it was drawn is not mentioned."""
    parts = [f"shape {wish.shape}"]
    if wish.rotation:
        parts.append(f"turned by {math.degrees(wish.rotation):.4g}°")
    if wish.scale != 1.0:
        parts.append(f"{wish.scale:.4g} times as large")
    if wish.route:
        parts.append(f"on course {wish.route}")
    return ", ".join(parts)


class Leading:
    """Orders, the figure they form, and who gives them."""

    def __init__(self, mission: Mission) -> None:
        self._agreed = bool(mission.standbys)
        self._order, self._formed, self._waits = Turns(), Turns("formed"), Turns("goes on")
        self._lead: Lead | None = None
        self._told = 0  # number of the newest request that was told
        self._candidates = {name: Turns() for name in mission.candidates} if self._agreed else {}

    def see(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        """What has happened since the last look."""
        yield from self._led(now, snapshot.lead)
        yield from self._asked(now, snapshot.asked)
        yield from self._ordered(now, snapshot)
        yield from self._awaited(now, snapshot)
        if snapshot.leads is not None:
            yield from self._standing_by(now, snapshot.candidates)

    def _led(self, now: Now, lead: Lead | None) -> Iterator[Event]:
        """Each term, and how long nobody had led before it."""
        if lead is None or (self._lead is not None and lead.term == self._lead.term):
            return
        self._lead = lead
        who = lead.name or "a process that the mission does not know"
        if not lead.before:
            if self._agreed:
                yield Event(now.wall, INFO, who, "leader", "leads")
        elif lead.name == lead.before:
            text = f"leads anew, after {lead.silent:.1f} s without a leader"
            yield Event(now.wall, WARNING, who, "leader", text)
        else:
            text = f"leads from here on, {lead.before} was silent for {lead.silent:.1f} s"
            yield Event(now.wall, WARNING, who, "leader", text)

    def _asked(self, now: Now, asked: Sequence[Asked]) -> Iterator[Event]:
        """Each request of an operator, and what was answered."""
        for one in asked:
            if one.number > self._told:
                self._told = one.number
                answer = "obeys" if one.ok else "refuses"
                text = f"{one.what}; it {answer}{': ' if one.reason else ''}{one.reason}"
                yield Event(now.wall, INFO if one.ok else WARNING, one.name, "asked", text)

    def _ordered(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        if snapshot.mode is None or snapshot.wish is None:
            return
        gains = f", {snapshot.tuned.words}" if snapshot.tuned else ""
        before = self._order.see(f"{snapshot.mode}, {described(snapshot.wish)}{gains}", now.mono)
        if before is not None:
            level = INFO if snapshot.mode == "run" else WARNING
            text = f"the leader orders {self._order.state}{more(before)}"
            yield Event(now.wall, level, "", "order", text)
        before = self._formed.see("formed" if snapshot.formed else "on its way", now.mono)
        if before is not None and snapshot.formed:
            took = snapshot.elapsed - snapshot.wished_at
            text = f"the slots are where they are wanted, {took:.1f} s after that was ordered{more(before)}"
            yield Event(now.wall, INFO, "", "formed", text)

    def _awaited(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        before = self._waits.see("waits" if snapshot.waits else "goes on", now.mono)
        if before is None:
            return
        if snapshot.waits:
            text = f"the leader waits for {snapshot.waits}{more(before)}"
            yield Event(now.wall, WARNING, "", "waits", text)
        else:
            yield Event(now.wall, INFO, "", "waits", f"the leader waits no longer{more(before)}")

    def _standing_by(self, now: Now, candidates: Mapping[str, CandidateFigures]) -> Iterator[Event]:
        """Who could take over, while somebody leads; between two leaders there is more to tell."""
        for name, one in candidates.items():
            if one.state not in {STANDBY, SILENT, LEADS}:
                continue
            before = self._candidates[name].see(one.state, now.mono)
            if before is None or one.state == LEADS:
                continue
            if one.state == STANDBY:
                yield Event(now.wall, INFO, name, "standby", f"stands by{more(before)}")
            else:
                text = f"could not take over: {one.reason}{more(before)}"
                yield Event(now.wall, WARNING, name, "lost", text)
