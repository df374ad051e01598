"""Events about the leader and its orders: snapshots in, events out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from formation.mission.model import Mission
from formation.monitor.metrics.candidates import LEADS
from formation.monitor.metrics.event import INFO, WARNING, Event, more
from formation.monitor.metrics.orders import Lead, Wish
from formation.monitor.metrics.requests import ReportedRequest
from formation.monitor.metrics.snapshot import CandidateMetrics, Snapshot
from formation.monitor.metrics.statuses import SILENT
from formation.monitor.metrics.turns import Turns
from formation.wire import Now

STANDBY = "standby"
"""State of a candidate that does not lead."""


def described(wish: Wish) -> str:
    """Return the wish in words; rotation and scale are left out if they are as drawn."""
    parts = [f"shape {wish.shape}"]
    if wish.rotation:
        parts.append(f"turned by {math.degrees(wish.rotation):.4g}°")
    if wish.scale != 1.0:
        parts.append(f"{wish.scale:.4g} times as large")
    if wish.route:
        parts.append(f"on route {wish.route}")
    return ", ".join(parts)


class Leading:
    """Events about orders, the shape and the leader."""

    def __init__(self, mission: Mission) -> None:
        self._agreed = bool(mission.standbys)
        self._order, self._formed, self._waits = Turns(), Turns("formed"), Turns("goes on")
        self._lead: Lead | None = None
        self._reported = 0  # number of the newest reported request
        self._candidates = {name: Turns() for name in mission.candidates} if self._agreed else {}

    def collect_events(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        """Yield the events since the last look."""
        yield from self._led(now, snapshot.lead)
        yield from self._requests(now, snapshot.requests)
        yield from self._ordered(now, snapshot)
        yield from self._awaited(now, snapshot)
        if snapshot.leads is not None:
            yield from self._standby(now, snapshot.candidates)

    def _led(self, now: Now, lead: Lead | None) -> Iterator[Event]:
        """Yield an event for each term, with the time without a leader before it."""
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

    def _requests(self, now: Now, requests: Sequence[ReportedRequest]) -> Iterator[Event]:
        """Yield an event for each operator request, with its answer."""
        for one in requests:
            if one.number > self._reported:
                self._reported = one.number
                answer = "obeys" if one.ok else "refuses"
                text = f"{one.what}; it {answer}{': ' if one.reason else ''}{one.reason}"
                yield Event(now.wall, INFO if one.ok else WARNING, one.name, "requested", text)

    def _ordered(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        if snapshot.mode is None or snapshot.wish is None:
            return
        gains = f", {snapshot.tuned.words}" if snapshot.tuned else ""
        before = self._order.update_state(f"{snapshot.mode}, {described(snapshot.wish)}{gains}", now.mono)
        if before is not None:
            level = INFO if snapshot.mode == "run" else WARNING
            text = f"the leader orders {self._order.state}{more(before)}"
            yield Event(now.wall, level, "", "order", text)
        before = self._formed.update_state("formed" if snapshot.formed else "on its way", now.mono)
        if before is not None and snapshot.formed:
            took = snapshot.elapsed - snapshot.wished_at
            text = f"the slots are where they are wanted, {took:.1f} s after that was ordered{more(before)}"
            yield Event(now.wall, INFO, "", "formed", text)

    def _awaited(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        before = self._waits.update_state("waits" if snapshot.waits else "goes on", now.mono)
        if before is None:
            return
        if snapshot.waits:
            text = f"the leader waits for {snapshot.waits}{more(before)}"
            yield Event(now.wall, WARNING, "", "waits", text)
        else:
            yield Event(now.wall, INFO, "", "waits", f"the leader waits no longer{more(before)}")

    def _standby(self, now: Now, candidates: Mapping[str, CandidateMetrics]) -> Iterator[Event]:
        """Yield events about the standbys, while there is a leader."""
        for name, one in candidates.items():
            if one.state not in {STANDBY, SILENT, LEADS}:
                continue
            before = self._candidates[name].update_state(one.state, now.mono)
            if before is None or one.state == LEADS:
                continue
            if one.state == STANDBY:
                yield Event(now.wall, INFO, name, "standby", f"stands by{more(before)}")
            else:
                text = f"could not take over: {one.reason}{more(before)}"
                yield Event(now.wall, WARNING, name, "lost", text)
